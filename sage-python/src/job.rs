//! A run of `sage generate` in this process, for `advsage.jobs`.

use std::{fmt::Display, path::PathBuf, str::FromStr};

use advsage::{
    AdversarySpec,
    driver_spec::Timeouts,
    in_one_line, latest_start,
    named_generator::GeneratorSpec,
    operating_point::{OperatingPoints, number},
    selection::ends_near,
};
use pyo3::{prelude::*, types::PyDict};
use sage_data::ReadOptions;
use sage_run::{
    generate::{self, GenerateOptions},
    outcome,
    output::{self, Extent},
    progress, signals, threads,
};

use crate::{errors::detached, loading::checked_rate, parts::registries};

/// Exit code of wrong usage.
const USAGE: u8 = 2;

/// Options as words: text for each that has a value, true for each flag.
struct Words<'a, 'py>(&'a Bound<'py, PyDict>);

impl Words<'_, '_> {
    fn text(&self, name: &str) -> Result<Option<String>, String> {
        let value = self.0.get_item(name).map_err(|error| error.to_string())?;
        let text = value.map(|value| value.extract::<String>());
        text.transpose().map_err(|_| format!("{name} is no text"))
    }

    fn is_given(&self, name: &str) -> bool {
        self.0.contains(name).unwrap_or(false)
    }

    fn read<T>(&self, name: &str, read: impl Fn(&str) -> Result<T, String>) -> Result<Option<T>, String> {
        let wrong = |problem| format!("--{}: {problem}", name.replace('_', "-"));
        self.text(name)?.map(|text| read(&text).map_err(wrong)).transpose()
    }

    fn parsed<T: FromStr<Err: Display>>(&self, name: &str) -> Result<Option<T>, String> {
        self.read(name, |text| text.parse().map_err(|error: T::Err| error.to_string()))
    }

    fn required<T: FromStr<Err: Display>>(&self, name: &str) -> Result<T, String> {
        self.parsed(name)?.ok_or_else(|| format!("{name} is missing"))
    }

    fn options(&self) -> Result<GenerateOptions, String> {
        let points = OperatingPoints {
            lambda: self.parsed("lambda")?,
            mu: self.read("mu", number)?,
            aggression: self.parsed("aggression")?,
            mix: self.parsed("mix")?.into_iter().collect(),
        };
        points.check()?;
        let rate =
            self.read("rate", |text| checked_rate(Some(number(text)?)).map_err(|error| error.to_string()))?;
        let json = |text: &str| serde_json::from_str(text).map_err(|error| error.to_string());
        let kind = self.read("adversary_type", |text| {
            serde_json::from_value(text.into())
                .map_err(|_| format!("`{text}` is none; known: pedestrian, cyclist"))
        })?;
        let adversary = AdversarySpec { id: self.text("adversary")?, kind, place: self.read("place", json)? };
        adversary.check().map_err(|error| error.to_string())?;
        let generator = GeneratorSpec {
            method: self.parsed("method")?,
            options: self.parsed("options")?,
            points,
            merger: self.required("merger")?,
            selection: match self.read("goal", ends_near)? {
                Some(selection) => selection,
                None => self.required("selection")?,
            },
            weights: self.text("weights")?,
            seed: self.required("seed")?,
            feasibility: self.parsed("feasibility")?,
        };
        Ok(GenerateOptions {
            scene: self.required("scene")?,
            generator: adversary.generator(generator, None).map_err(|error| error.to_string())?,
            adversary,
            ego: self.required("ego")?,
            ego_timeout: self.parsed("ego_timeout")?.map(|Timeouts(times)| times),
            latest_start: self.read("latest_start", latest_start::seconds)?,
            avoidable: self.parsed("avoidable")?,
            format: self.required("format")?,
            standard: self.parsed("standard")?,
            scenario_ego: self.parsed("scenario_ego")?,
            reading: ReadOptions {
                now: self.parsed("now")?,
                resample: self.is_given("resample"),
                rate: rate.flatten(),
                trust_positions: self.is_given("trust"),
                ego_track: self.text("ego_track")?,
                without: self
                    .read("without", |text| Ok(text.split(',').map(str::to_owned).collect()))?
                    .unwrap_or_default(),
                strict: self.is_given("strict"),
            },
            out: self.required("out")?,
            force: self.is_given("force"),
            json: self.is_given("json"),
            quiet: self.is_given("quiet"),
            no_pages: self.is_given("no_pages"),
            no_candidates: self.is_given("no_candidates"),
        })
    }
}

/// Runs `sage generate` with options as `advsage.jobs` reads them, and returns its exit code. `words` are those of the command line, as
/// the run records them. Messages go to the standard error, results to the standard output.
#[pyfunction]
pub(crate) fn run_generate(py: Python<'_>, options: &Bound<'_, PyDict>, words: Vec<String>) -> PyResult<u8> {
    // The module is the program: a run is resumed by the same one.
    let module: PathBuf = py.import("advsage._advsage")?.getattr("__file__")?.extract()?;
    let given = Words(options);
    let read = || -> Result<_, String> {
        let extent = if given.is_given("join") { Extent::Join } else { Extent::of(given.parsed("shard")?) };
        Ok((given.options()?, extent, given.parsed("threads")?))
    };
    let (options, extent, cores) = match read() {
        Ok(read) => read,
        Err(problem) => {
            progress::say(&format!("error: {problem}"));
            return Ok(USAGE);
        }
    };
    output::identify_by(&module);
    let own = words.into_iter().filter(|word| word != "--join");
    output::stand_for(std::iter::once("generate".to_owned()).chain(own).collect());
    signals::clean_up_when_stopped();
    detached(py, || {
        let registries = registries()?;
        let done = threads::build_pool(cores).and_then(|()| generate::run(&options, extent, registries));
        Ok(match done {
            Ok(outcome) => outcome.code(),
            Err(error) => {
                progress::say(&format!("error: {}", in_one_line(&error)));
                outcome::code_of(&error)
            }
        })
    })
}
