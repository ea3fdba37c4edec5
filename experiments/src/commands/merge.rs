//! `sage merge`: merges experts by a recipe into one network.

mod greedy_soup;
mod recipe;

use std::path::{Path, PathBuf};

use advsage::{
    Registries,
    weights::{self, NamedNetwork},
};
use anyhow::{Context as _, Result, ensure};
use sage_backbones::{Parameters, parameters::Header, training::Tunes, weights::PRIOR_FILE};
use sage_core::{generator::Mixture, text::table::Table};
use sage_merging::{ExpertFile, ExpertSet, Range, merged_weights};
use sage_run::{
    Outcome,
    output::{self, Folder, Inputs},
    progress, scenes,
    terminal::{escaped_markdown, escaped_markdown_code},
};
use serde_json::json;

use crate::cli::MergeArgs;
use greedy_soup::{Search, Step};
use recipe::Recipe;

/// Copy of the recipe in the output folder.
const RECIPE_FILE: &str = "recipe.yaml";
/// The model card.
const CARD_FILE: &str = "README.md";

pub(crate) fn run(args: &MergeArgs, registries: &Registries) -> Result<Outcome> {
    let (recipe, text) = Recipe::read(&args.recipe)?;
    merge(args, registries, &recipe, &text).with_context(|| format!("`{}`", args.recipe.display()))
}

fn merge(args: &MergeArgs, registries: &Registries, recipe: &Recipe, text: &str) -> Result<Outcome> {
    let merger = recipe.merger.build(&registries.mergers)?;
    let tensors = merger.tensors().with_context(|| {
        format!("`{}` mixes outputs of the experts; a recipe needs a merger of weights", recipe.merger.name)
    })?;
    let base = beside(&args.recipe, &recipe.base);
    let prior = NamedNetwork::load(&registries.backbones, &base.to_string_lossy())?;
    let mut files: Vec<(String, ExpertFile)> = Vec::new();
    for (model, _) in &recipe.models {
        let file = expert(&args.recipe, model)?;
        let others = files.iter().filter(|(_, other)| other.named == file.named).count();
        // Several tunings of one expert are told apart by number.
        let label = if others == 0 { file.named.clone() } else { format!("{} {}", file.named, others + 1) };
        files.push((label, file));
    }
    let sources: Vec<Source> = files.iter().map(|(name, file)| Source::of(name, file)).collect();
    let experts = ExpertSet::of_files(prior.network.into(), files)?;
    ensure!(
        experts.tunes() == Tunes::Scores,
        "these experts have their own encoders, and their trajectories are the prior's: one network cannot hold both; mix them with --mix or --lambda"
    );
    let given = Mixture::new(recipe.models.iter().map(|(_, weight)| *weight).collect());
    let (mixture, steps, failed) = match &recipe.search {
        None => (given, Vec::new(), 0),
        Some(search) => {
            let paths: Vec<PathBuf> = search.scenes.iter().map(|path| beside(&args.recipe, path)).collect();
            search.run(&paths, &experts, registries, args.seed)?
        }
    };
    ensure!(
        mixture.is_on_simplex() || merger.range() != Range::Simplex && merger.range() != Range::Edge,
        "the weights are {:?}; `{}` needs weights of 0 or more that sum to 1",
        mixture.weights(),
        recipe.merger.name
    );
    let merged = merged_weights(tensors, &experts, &mixture, args.seed)?;
    // Everything is checked, so the folder is made only now.
    let models = recipe.models.iter().map(|(model, _)| beside(&args.recipe, model));
    let scenes =
        recipe.search.iter().flat_map(|search| &search.scenes).map(|path| beside(&args.recipe, path));
    let inputs = Inputs::of_command_line().and(models).and(scenes).and([base]);
    let inputs = inputs.and(weights::folder_of(&recipe.base));
    let folder = Folder::make_beside(&inputs, &args.folder.out, args.folder.force)?;
    let mut header = Header {
        backbone: experts.prior().name().to_owned(),
        options: experts.prior().options().clone(),
        seed: args.seed,
        data: prior.header.data.clone(),
        command: output::command(),
        license: licenses(&prior.header, &sources),
        ..Header::default()
    };
    let models: Vec<_> =
        sources.iter().zip(mixture.weights()).map(|(source, weight)| json!([source.name, weight])).collect();
    header.notes.insert("merged".to_owned(), json!([recipe.merger.to_string(), models]).to_string());
    folder.write(RECIPE_FILE, text.as_bytes())?;
    folder.write(CARD_FILE, card(recipe, &experts, &mixture, &sources, &steps, &header)?.as_bytes())?;
    merged.save(&header, &folder.path().join(PRIOR_FILE))?;
    folder.finish()?;
    progress::say(&format!(
        "merged {} experts by `{}`; use them with --weights {} --method prior",
        sources.len(),
        recipe.merger,
        args.folder.out.display()
    ));
    Ok(scenes::outcome_without(failed))
}

/// A path of a recipe: relative to the recipe if it is there, else to the current folder.
fn beside(recipe: &Path, path: &str) -> PathBuf {
    let beside = recipe.parent().map(|folder| folder.join(path));
    beside.filter(|beside| beside.exists()).unwrap_or_else(|| PathBuf::from(path))
}

/// An expert's file with the name that its header gives.
fn expert(recipe: &Path, model: &str) -> Result<ExpertFile> {
    let path = beside(recipe, model);
    let (parameters, header): (Parameters, Header) = Parameters::load(&path)?;
    let named = header.notes.get(ExpertFile::EXPERT).cloned();
    let named = named.with_context(|| {
        format!("`{}` does not say which expert it is; name files that `sage finetune` wrote", path.display())
    })?;
    ensure!(!named.is_empty(), "`{}` names no expert in its header", path.display());
    Ok(ExpertFile { path, named, parameters, header })
}

/// The different licences of the prior and the experts.
fn licenses(prior: &Header, sources: &[Source]) -> String {
    let mut all: Vec<&str> = Vec::new();
    for license in std::iter::once(&prior.license).chain(sources.iter().map(|source| &source.license)) {
        if !license.is_empty() && !all.contains(&&**license) {
            all.push(license);
        }
    }
    all.join(" ")
}

/// Where an expert comes from, for the model card.
struct Source {
    name: String,
    data: String,
    license: String,
}

impl Source {
    fn of(name: &str, file: &ExpertFile) -> Self {
        let Header { data, license, .. } = &file.header;
        Self { name: name.to_owned(), data: data.clone(), license: license.clone() }
    }
}

/// The model card.
fn card(
    recipe: &Recipe,
    experts: &ExpertSet,
    mixture: &Mixture,
    sources: &[Source],
    steps: &[Step],
    header: &Header,
) -> Result<String> {
    let code = |text: &str| format!("`{}`", escaped_markdown_code(text));
    let heads = ["expert", "weight", "file", "hash", "tuned on", "licence"];
    let mut sources_of = Table::new("", &heads);
    let experts_of = experts.experts().iter().zip(&recipe.models).zip(sources).zip(mixture.weights());
    for ((((name, parameters), (model, _)), source), weight) in experts_of {
        let hash = code(&parameters.hash()?[..16]);
        let cells = [weight.to_string(), code(model), hash, stated(&source.data), stated(&source.license)];
        sources_of.row(escaped_markdown(name), cells);
    }
    let mut search = String::new();
    if let Some(Search { scenes, selection, mu }) = &recipe.search {
        let scenes = scenes.iter().map(|path| code(path)).collect::<Vec<_>>().join(", ");
        let title = format!(
            "The weights are those of a greedy soup on {scenes}, by the mean value of the selected attacks under `{selection}` at mu {mu}:"
        );
        let heads = ["expert", "own value", "value of the soup with it", "in the soup"];
        let mut table = Table::new(title, &heads);
        for step in steps {
            let kept = if step.is_kept { "yes" } else { "no" };
            let [own, with_it] = [step.own, step.with_it].map(|value| format!("{value:.4}"));
            table.row(escaped_markdown(&step.expert), [own, with_it, kept.to_owned()]);
        }
        search = format!("\n{}", table.markdown());
    }
    let mut facts = Table::new("", &["", ""]);
    facts.row("merger", [code(&recipe.merger.to_string())]);
    facts.row("backbone", [escaped_markdown(&header.backbone)]);
    let hash = code(&experts.prior().parameters().hash()?[..16]);
    facts.row("prior", [format!("{} ({hash})", code(&recipe.base))]);
    facts.row("prior trained on", [stated(&header.data)]);
    facts.row("licence", [stated(&header.license)]);
    facts.row("command", [code(&header.command)]);
    facts.row("version", [format!("sage {}", env!("CARGO_PKG_VERSION"))]);
    Ok(format!(
        "# Merged weights\n\n`{PRIOR_FILE}` holds experts of one prior merged into one network. `{RECIPE_FILE}` is the recipe.\n\n\
         {}\n{}{search}\n\
         Use it: `sage generate SCENES --weights DIR --method prior --out OUT`, with this folder as DIR.\n",
        facts.markdown(),
        sources_of.markdown(),
    ))
}

/// What a file says of itself, for a page.
fn stated(text: &str) -> String {
    if text.is_empty() { "not stated".to_owned() } else { escaped_markdown(text) }
}
