//! Arguments that name formats: of scenes, of attacks, and versions of OpenSCENARIO.

use std::str::FromStr;

use advsage::attacked_files::AttackFormats;
use clap::{
    Args,
    builder::{PossibleValue, PossibleValuesParser, TypedValueParser},
};
use sage_data::{
    Format,
    openscenario::{EgoMode, Standard, UnknownName},
};

use super::help::OUTPUT;

/// Parses a format that scenes are written in: one of some, or any.
pub(super) fn scene_formats(some: &'static [Format]) -> impl TypedValueParser<Value = Format> {
    let offered = Format::all_written().filter(|format| some.is_empty() || some.contains(format));
    let offered = offered.map(|format| PossibleValue::new(format.name()).help(format.about()));
    PossibleValuesParser::new(offered).try_map(|name| Format::named(&name).ok_or("no such format"))
}

/// Parses which scene files are written of attacks.
pub(super) fn attack_formats() -> impl TypedValueParser<Value = AttackFormats> {
    let offered = AttackFormats::all().into_iter().map(|choice| {
        let value = PossibleValue::new(choice.name()).help(choice.about());
        if choice == AttackFormats::Rows { value.alias("none") } else { value }
    });
    PossibleValuesParser::new(offered).try_map(|name| name.parse::<AttackFormats>())
}

/// Parses a version of OpenSCENARIO.
pub(super) fn standards() -> impl TypedValueParser<Value = Standard> {
    names(Standard::ALL.map(Standard::name))
}

/// Parses who drives the ego of a scenario.
pub(super) fn ego_modes() -> impl TypedValueParser<Value = EgoMode> {
    names(EgoMode::ALL.map(EgoMode::name))
}

/// Parses one of some names.
fn names<T, const N: usize>(all: [&'static str; N]) -> impl TypedValueParser<Value = T>
where
    T: FromStr<Err = UnknownName> + Clone + Send + Sync + 'static,
{
    PossibleValuesParser::new(all).try_map(|name| name.parse())
}

/// Options of scenarios.
#[derive(Clone, Copy, Debug, Args)]
pub(crate) struct ScenarioArgs {
    /// Version of OpenSCENARIO with --format openscenario (default: 1.2).
    #[arg(long, help_heading = OUTPUT, value_name = "VERSION", value_parser = standards())]
    pub standard: Option<Standard>,
    /// Who drives the ego with --format openscenario: the recording, or an external controller that gets a start
    /// speed and a route (default: replay).
    #[arg(long, help_heading = OUTPUT, value_name = "WHO", value_parser = ego_modes())]
    pub scenario_ego: Option<EgoMode>,
}
