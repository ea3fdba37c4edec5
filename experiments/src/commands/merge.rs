//! `sage merge`: merges experts by a recipe into one network.

mod recipe;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};
use sage_backbones::{Parameters, parameters::Header, training::Tunes, weights::PRIOR_FILE};
use sage_core::generator::Mixture;
use sage_merging::{ExpertFile, ExpertSet, Range, merged_weights};
use serde_json::json;

use crate::{
    Outcome, Registries,
    cli::MergeArgs,
    networks,
    output::{self, Folder},
    progress,
};

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
    let prior = networks::load(&registries.backbones, &base.to_string_lossy())?;
    let mut files = Vec::new();
    for (model, _) in &recipe.models {
        files.push(expert(&args.recipe, model)?);
    }
    let names: Vec<String> = files.iter().map(|(name, _)| name.clone()).collect();
    let experts = ExpertSet::of_files(prior.network.into(), files)?;
    ensure!(
        experts.tunes() == Tunes::Scores,
        "these experts have their own encoders, and their trajectories are the prior's: one network cannot hold both; mix them with --mix or --lambda"
    );
    let mixture = Mixture::new(recipe.models.iter().map(|(_, weight)| *weight).collect());
    ensure!(
        mixture.is_on_simplex() || merger.range() != Range::Simplex && merger.range() != Range::Edge,
        "the weights are {:?}; `{}` needs weights of 0 or more that sum to 1",
        mixture.weights(),
        recipe.merger.name
    );
    let merged = merged_weights(tensors, &experts, &mixture, args.seed)?;
    // Everything is checked, so the folder is made only now.
    let folder = Folder::make(&args.folder.out, args.folder.force)?;
    let mut header = Header {
        backbone: experts.prior().name().to_owned(),
        options: experts.prior().options().clone(),
        seed: args.seed,
        data: prior.header.data.clone(),
        command: output::command(),
        license: prior.header.license.clone(),
        ..Header::default()
    };
    let models: Vec<_> =
        names.iter().zip(mixture.weights()).map(|(name, weight)| json!([name, weight])).collect();
    header.notes.insert("merged".to_owned(), json!([recipe.merger.to_string(), models]).to_string());
    folder.write(RECIPE_FILE, text.as_bytes())?;
    folder.write(CARD_FILE, card(recipe, &experts, &header)?.as_bytes())?;
    merged.save(&header, &folder.path().join(PRIOR_FILE))?;
    progress::say(&format!(
        "merged {} experts by `{}`; use them with --weights {} --method prior",
        names.len(),
        recipe.merger,
        args.folder.out.display()
    ));
    Ok(Outcome::Done)
}

/// A path of a recipe: relative to the recipe if it is there, else to the current folder.
fn beside(recipe: &Path, path: &str) -> PathBuf {
    let beside = recipe.parent().map(|folder| folder.join(path));
    beside.filter(|beside| beside.exists()).unwrap_or_else(|| PathBuf::from(path))
}

/// An expert's file with the name that its header gives.
fn expert(recipe: &Path, model: &str) -> Result<(String, ExpertFile)> {
    let path = beside(recipe, model);
    let (parameters, header): (Parameters, Header) = Parameters::load(&path)?;
    let name = header.notes.get(ExpertFile::EXPERT).cloned();
    let name = name.with_context(|| {
        format!("`{}` does not say which expert it is; name files that `sage finetune` wrote", path.display())
    })?;
    ensure!(!name.is_empty(), "`{}` names no expert in its header", path.display());
    Ok((name, ExpertFile { path, parameters, header }))
}

/// The model card.
fn card(recipe: &Recipe, experts: &ExpertSet, header: &Header) -> Result<String> {
    let mut rows = String::new();
    for ((name, parameters), (model, weight)) in experts.experts().iter().zip(&recipe.models) {
        rows += &format!("| {name} | {weight} | `{model}` | `{}` |\n", &parameters.hash()?[..16]);
    }
    let license = if header.license.is_empty() { "none stated" } else { &header.license };
    Ok(format!(
        "# Merged weights\n\n`{PRIOR_FILE}` holds experts of one prior merged into one network. `{RECIPE_FILE}` is the recipe.\n\n\
         | | |\n| --- | --- |\n| merger | `{}` |\n| backbone | {} |\n| prior | `{}` (`{}`) |\n| trained on | {} |\n| command | `{}` |\n| version | sage {} |\n| licence | {license} |\n\n\
         | expert | weight | file | hash |\n| --- | --- | --- | --- |\n{rows}\n\
         Use it: `sage generate SCENES --weights DIR --method prior --out OUT`, with this folder as DIR.\n",
        recipe.merger,
        header.backbone,
        recipe.base,
        &experts.prior().parameters().hash()?[..16],
        if header.data.is_empty() { "not stated" } else { &header.data },
        header.command,
        env!("CARGO_PKG_VERSION"),
    ))
}
