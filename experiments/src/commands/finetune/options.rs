//! The options of a run of fine-tuning: a configuration of the user's or a shipped one, on top of the defaults of each expert.

use std::path::{Path, PathBuf};

use advsage::Registries;
use anyhow::{Context as _, Result, bail};
use sage_backbones::{
    features::EdgeKinds,
    training::{FinetuneOptions, Measures},
};
use sage_core::objective::{Objective, ObjectiveSpec};
use sage_merging::{ADVERSARIAL, LAWFUL, REALISTIC};
use sage_run::input;
use serde_json::{Map, Value, json};

use crate::cli::FinetuneArgs;

/// Shipped configurations by name: the paper's own set-up, and variants that are compared.
const SHIPPED: [(&str, &str); 5] = [
    ("paper", include_str!("paper.json")),
    ("ablation", include_str!("ablation.json")),
    ("paper-ablation", include_str!("paper-ablation.json")),
    ("paper-parts", include_str!("paper-parts.json")),
    ("paper-reuse", include_str!("paper-reuse.json")),
];
/// Option of networks whose features hold edges.
pub(super) const EDGES: &str = "edges";
const ROLES: &str = "roles";
/// Further role assignments of each scene unless a configuration or the command line says otherwise.
const DEFAULT_ROLES: usize = 3;

/// What a run tunes.
pub(super) struct RunOptions {
    /// The experts: realistic, adversarial, then the others by name.
    pub experts: Vec<Expert>,
    /// Edges in the features of the network, if they are given.
    pub edges: Option<EdgeKinds>,
    /// Whether the edges are those of a shipped configuration, so that networks without this option keep their features.
    pub edges_are_shipped: bool,
    /// Maximum number of further role assignments of each scene.
    pub roles: usize,
}

/// An expert to be tuned.
pub(super) struct Expert {
    pub name: String,
    pub options: FinetuneOptions,
    pub objective: Objective,
}

impl RunOptions {
    /// Options of a configuration count for all experts; options under `experts` count for one expert by name. Without
    /// `experts` there are a realistic, an adversarial and a lawful one.
    ///
    /// *Errors*: a file that cannot be read, an unknown option or name, or a value out of range.
    pub fn of(args: &FinetuneArgs, registries: &Registries) -> Result<Self> {
        let (mut shared, is_shipped) = configuration(args)?;
        let edges = shared.remove(EDGES).map(serde_json::from_value).transpose();
        let edges: Option<EdgeKinds> = edges.context("`edges`: expected boundaries or all")?;
        let roles = shared.remove(ROLES).map(|value| match value.as_u64() {
            Some(roles) if roles <= crate::cli::MOST_ROLES as u64 => Ok(roles as usize),
            _ => bail!("`roles` is `{value}`; expected 0 to {}", crate::cli::MOST_ROLES),
        });
        let roles = roles.transpose()?.unwrap_or(DEFAULT_ROLES);
        let all = || [REALISTIC, ADVERSARIAL, LAWFUL].map(|name| (name.to_owned(), json!({})));
        let own: Map<String, Value> = match shared.remove("experts") {
            None => all().into_iter().collect(),
            Some(Value::Object(experts)) if !experts.is_empty() => experts,
            Some(other) => bail!("`experts` is `{other}`; expected an object of options by name"),
        };
        let file = args.config.clone().or_else(|| args.variants.as_ref().map(PathBuf::from));
        let prefix = file.map_or(String::new(), |path| format!("`{}`: ", path.display()));
        let expert = |(name, own)| expert(name, &own, &shared, args.seed, &prefix, registries);
        let mut experts = own.into_iter().map(expert).collect::<Result<Vec<_>>>()?;
        experts.sort_by_key(|expert| {
            (expert.name != REALISTIC, expert.name != ADVERSARIAL, expert.name.clone())
        });
        Ok(Self {
            experts,
            edges: args.edges.map(EdgeKinds::from).or(edges),
            edges_are_shipped: args.edges.is_none() && is_shipped,
            roles: args.roles.unwrap_or(roles),
        })
    }
}

/// The configuration of a run, and whether it is a shipped one.
fn configuration(args: &FinetuneArgs) -> Result<(Map<String, Value>, bool)> {
    if let Some(path) = &args.config {
        return Ok((read(path)?, false));
    }
    let Some(name) = args.preset.as_deref().or(args.variants.as_deref()) else {
        return Ok((Map::new(), false));
    };
    if let Some((_, text)) = SHIPPED.iter().find(|(known, _)| *known == name) {
        return Ok((serde_json::from_str(text)?, true));
    }
    let known = SHIPPED.map(|(name, _)| name).join(", ");
    match &args.preset {
        Some(_) => bail!("--preset: `{name}` is none of {known}"),
        None => Ok((
            read(name.as_ref()).with_context(|| format!("--variants: expected a file or one of {known}"))?,
            false,
        )),
    }
}

fn expert(
    name: String,
    own: &Value,
    shared: &Map<String, Value>,
    seed: u64,
    prefix: &str,
    registries: &Registries,
) -> Result<Expert> {
    check_name(&name)?;
    let base = match &*name {
        REALISTIC => FinetuneOptions::realistic(),
        LAWFUL => FinetuneOptions::lawful(),
        _ => FinetuneOptions::default(),
    };
    let rule = serde_json::to_value(&base.objective.feasibility)?;
    let mut all = serde_json::to_value(base)?;
    if let Some(all) = all.as_object_mut() {
        all.extend(shared.clone());
        let own = own.as_object().with_context(|| format!("{prefix}expert `{name}`: expected an object"))?;
        all.extend(own.clone());
        if let Some(Value::String(preset)) = all.get("objective") {
            let spec = ObjectiveSpec::preset(preset);
            let spec = spec.with_context(|| {
                format!("{prefix}unknown objective `{preset}`; `sage list` shows the known ones")
            })?;
            all.insert("objective".to_owned(), serde_json::to_value(spec)?);
        }
        // The experts of a run share their rule; an objective that names none has that of the defaults.
        if let Some(Value::Object(objective)) = all.get_mut("objective") {
            objective.entry("feasibility").or_insert(rule);
        }
    }
    let fail = || format!("{prefix}expert `{name}`");
    let options: FinetuneOptions = serde_json::from_value(all).with_context(fail)?;
    options.check().with_context(fail)?;
    let objective = Objective::new(&options.objective, &registries.rewards, &registries.feasibilities);
    let objective = objective.with_context(fail)?;
    Measures::check(&objective).with_context(fail)?;
    Ok(Expert { name, options: FinetuneOptions { seed, ..options }, objective })
}

/// Refuses names that are not plain file names, or that other files of the folder have.
fn check_name(name: &str) -> Result<()> {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || letter == '-' || letter == '_';
    if name.is_empty() || name.len() > 40 || !name.chars().all(is_plain) || ["prior", "last"].contains(&name)
    {
        bail!("an expert cannot be named `{}`: expected letters, digits, - and _", name.escape_debug());
    }
    Ok(())
}

fn read(path: &Path) -> Result<Map<String, Value>> {
    let text = input::read_config(path)?;
    let config: Map<String, Value> =
        serde_json::from_str(&text).with_context(|| format!("`{}`", path.display()))?;
    if config.contains_key("seed") {
        bail!("`{}`: `seed` is given by --seed", path.display());
    }
    Ok(config)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)] // A failed unwrap is a failed test.
mod tests {
    use super::*;
    use clap::Parser;
    use sage_backbones::{
        candidates::Sampling,
        training::{Schedule, Tunes},
    };
    use sage_core::preference_pairs::Pairing;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        args: FinetuneArgs,
    }

    fn options(args: &[&str]) -> RunOptions {
        let args = [&["finetune", "--out", "x"], args].concat();
        let args = Command::try_parse_from(args).unwrap().args;
        RunOptions::of(&args, &Registries::shipped().unwrap()).unwrap()
    }

    #[test]
    fn the_preset_is_the_papers_table() {
        let run = options(&["--preset", "paper", "--seed", "2"]);
        assert_eq!((run.roles, run.edges, run.edges_are_shipped), (0, Some(EdgeKinds::Boundaries), true));
        let names: Vec<&str> = run.experts.iter().map(|expert| &*expert.name).collect();
        assert_eq!(names, [REALISTIC, ADVERSARIAL]);
        for (expert, weights) in run.experts.iter().zip([[0.1, -0.9], [0.9, -0.1]]) {
            let o = &expert.options;
            assert_eq!((o.candidates, o.selection, o.max_pairs), (32, Sampling::TopK, 8));
            assert_eq!((o.pairing, o.margin, o.kl_beta), (Pairing::Hierarchical, 0.2, 0.05));
            assert_eq!((o.epochs, o.batch, o.rate, o.weight_decay), (200, 1, 1e-5, 0.01));
            assert_eq!(
                (o.schedule, o.warm_up, o.tunes, o.mirror),
                (Schedule::Constant, 0, Tunes::All, false)
            );
            assert_eq!((o.interaction_head, o.seed), (false, 2), "a part of this project");
            let terms: Vec<f64> = o
                .objective
                .terms
                .iter()
                .map(|term| serde_json::to_value(term).unwrap()["weight"].as_f64().unwrap())
                .collect();
            assert_eq!(terms, weights, "{}", expert.name);
        }
    }

    #[test]
    fn shipped_configurations_are_read_and_flags_replace_them() {
        for (name, _) in SHIPPED {
            assert!(!options(&["--variants", name]).experts.is_empty(), "{name}");
        }
        let run = options(&["--preset", "paper", "--roles", "2", "--edges", "all"]);
        assert_eq!((run.roles, run.edges, run.edges_are_shipped), (2, Some(EdgeKinds::All), false));
        assert_eq!(options(&[]).roles, DEFAULT_ROLES);
        // Each variant of the paper's ablations differs from its tuning in what its name says.
        let ablation = options(&["--variants", "paper-ablation"]);
        // They were measured with the interaction head.
        let paper = &options(&["--preset", "paper"]).experts[1].options;
        let paper = &FinetuneOptions { interaction_head: true, ..paper.clone() };
        let hgpo = &ablation.experts.iter().find(|expert| expert.name == "hgpo").unwrap().options;
        assert_eq!(hgpo, paper);
        assert!(ablation.experts.iter().all(|expert| expert.name == "hgpo" || expert.options != *paper));
    }
}
