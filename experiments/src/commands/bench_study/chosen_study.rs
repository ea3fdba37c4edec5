//! The study that the command line names, with what its options replace.

use std::path::Path;

use anyhow::{Context as _, Result, bail};
use sage_bench::{
    rows::Subject,
    study::{MAX_STUDY_FILE, Study},
};
use sage_core::files;

use crate::{Registries, cli::StudyArgs};

/// Metrics of attacks on drivers in a study that lists none.
const ATTACKED: [&str; 9] = [
    "attack",
    "at-fault attack",
    "solid attack",
    "any vehicle",
    "progress",
    "R_adv",
    "R_adv, path cut",
    "impact",
    "*",
];

/// The study of a name or a file.
pub(super) fn study(name: &str, registries: &Registries) -> Result<Study> {
    if let Some((name, text)) = registries.studies.iter().find(|(known, _)| *known == name) {
        return Ok(Study::parse(text, name)?);
    }
    let path = Path::new(name);
    if !path.is_file() {
        let known: Vec<&str> = registries.studies.iter().map(|(name, _)| *name).collect();
        let known = known.join(", ");
        bail!("there is no study `{name}`; known: {known}; or the file of a study (YAML)");
    }
    let text =
        files::read_argument_text(path, MAX_STUDY_FILE).with_context(|| format!("cannot read `{name}`"))?;
    Ok(Study::parse(&text, name)?)
}

/// The study with what the command line replaces.
pub(super) fn adapted(args: &StudyArgs, registries: &Registries) -> Result<Study> {
    let name = args.study.as_deref().context("no study is named")?;
    args.axes.check()?;
    let mut study = study(name, registries)?;
    for assignment in args.axes.assignments().iter().chain(&args.set) {
        study.set(assignment)?;
    }
    if let Some(drivers) = args.axes.drivers() {
        study.ego = drivers;
    }
    study.check()?;
    if let Some(search) = args.avoidable.options() {
        study.avoidable = Some(search);
    }
    if let Some(run) = &args.axes.tested {
        test_run(&mut study, run)?;
    }
    if args.axes.unattacked {
        if study.measures(Subject::Episode) {
            study.method.clear();
        }
        let has_unattacked = |subject: &Subject| matches!(subject, Subject::Drive | Subject::Episode);
        study.measure.retain(has_unattacked);
        study.metrics.retain(|subject, _| has_unattacked(subject));
        if study.measure.is_empty() {
            bail!(
                "--unattacked: study `{}` measures no drive without an attack; `drivers` does",
                study.study
            );
        }
    }
    // Against drivers, the drives under attack are what is asked for.
    let of_drives = [
        Subject::Drive,
        Subject::Episode,
        Subject::AttackedDrive,
        Subject::Search,
        Subject::Threshold,
        Subject::Transfer,
        Subject::Rate,
    ];
    let is_driven = of_drives.iter().any(|subject| study.measures(*subject));
    if !study.ego.is_empty() && !is_driven {
        study.measure.push(Subject::AttackedDrive);
        study.metrics.insert(Subject::AttackedDrive, ATTACKED.map(str::to_owned).to_vec());
    }
    Ok(study)
}

/// Tests another run than the one of the study. The paper's orderings are about its own run, so the same differences are
/// only said to be better or worse.
fn test_run(study: &mut Study, run: &str) -> Result<()> {
    let named: Vec<&str> = study.runs.iter().filter_map(|entry| Some(entry.split_once('=')?.0)).collect();
    if !named.contains(&run) {
        bail!("--tested names `{run}`, which is none of --runs: {}", named.join(", "));
    }
    for family in &mut study.report.tests {
        if family.tested != run {
            family.tested = run.to_owned();
            if !family.against.is_empty() {
                family.against.clear();
                family.title = "Other measures".to_owned();
                family.verdicts = ["better", "worse"].map(str::to_owned);
            }
        }
    }
    Ok(())
}
