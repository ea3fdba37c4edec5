//! `sage explain`: why a scene is attacked as it is, or why not.

mod explanation;

use anyhow::Result;
use sage_bench::table::Table;
use sage_core::{
    objective::{Context, ContextOptions},
    scene::SceneIndex,
};
use sage_data::{Recording, checks};

use crate::{
    Outcome as Status, Registries,
    cli::{ExplainArgs, Values},
    output, progress,
    run_generator::RunGenerator,
    terminal,
};
use explanation::{Explanation, Outcome, ValuedCandidate};

/// λ at which a scene is explained by default.
const LAMBDAS: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

pub(crate) fn run(args: &ExplainArgs, registries: &Registries) -> Result<Status> {
    let mut attack = args.attack.clone();
    let points = &mut attack.points;
    if points.lambda.is_none() && points.aggression.is_none() && points.mix.is_none() {
        points.lambda = Some(Values(LAMBDAS.to_vec()));
    }
    let generator = RunGenerator::new(&args.method, &attack, registries)?;
    let recording = Recording::read_as(&args.scene, &args.reading.options())?;
    for warning in checks::important(&recording.scene) {
        progress::say(&format!("warning: {warning}"));
    }
    let scene = recording.scene.with_roles(None, attack.adversary.as_deref())?;
    scene.attackable_horizon()?;
    scene.check_apart_now()?;
    let index = SceneIndex::new(scene.map.clone());
    let ctx = Context::new(&scene.into(), &index, &ContextOptions::default())?;
    let attacks = generator.built.attacks(&ctx, attack.seed)?;
    let objective = &generator.selection.objective;
    let uses_point = generator.built.facts.uses_operating_point();
    let explained = attacks.iter().zip(&generator.points).map(|(attack, point)| {
        attack.check(ctx.scene())?;
        let label = if uses_point { point.long_label() } else { generator.method.to_string() };
        Ok(Explanation::of(attack, &ctx, objective, point.mu, label))
    });
    let explained: Vec<Explanation> = explained.collect::<Result<_>>()?;
    if args.json {
        let mut out = Vec::new();
        for one in &explained {
            terminal::write_json_line(&mut out, &serde_json::to_string(one)?)?;
        }
        output::print(&String::from_utf8(out)?)?;
    } else {
        let title = format!(
            "`{}` with the adversary `{}`, generator `{}`, selection `{}`:",
            terminal::escaped_name(&args.scene.display().to_string()),
            terminal::escaped_name(&ctx.adversary().id),
            generator.method,
            attack.selection
        );
        let texts: Vec<String> = explained.iter().map(text).collect();
        output::print(&format!("{title}\n\n{}", texts.join("\n")))?;
    }
    Ok(Status::Done)
}

/// An explanation in words, with the values of the best candidates.
fn text(one: &Explanation) -> String {
    let counted = |counts: &std::collections::BTreeMap<String, usize>| {
        let words = counts.iter().map(|(what, count)| format!("{} ({count})", terminal::escaped_name(what)));
        words.collect::<Vec<_>>().join(", ")
    };
    let mut out = format!("{}: {}\n", one.attack, words(one));
    let touching = match (one.hits, one.feasible_hits) {
        (0, _) => "none touches the ego".to_owned(),
        (hits, 0) => format!("{hits} touch the ego, none of them is feasible"),
        (hits, feasible) => {
            format!("{hits} touch the ego, {feasible} of them feasible, {} believable", one.believable_hits)
        }
    };
    out += &format!(
        "  {}, {} feasible; {touching}\n",
        progress::count(one.candidates, "candidate"),
        one.feasible
    );
    if !one.violations.is_empty() {
        out += &format!("  infeasible: {}\n", counted(&one.violations));
    }
    if !one.unbelievable.is_empty() {
        out += &format!("  not believable: {}\n", counted(&one.unbelievable));
    }
    out + &values(one)
}

/// What came of the selection, in words.
fn words(one: &Explanation) -> String {
    match one.outcome {
        Outcome::Attack => "a believable attack".to_owned(),
        Outcome::NoFeasiblePlan => "no attack: no candidate keeps to the road and clear of others".to_owned(),
        Outcome::NeverHit => "no attack: no candidate touches the ego".to_owned(),
        Outcome::NoFeasibleHit => "no attack: no candidate that touches the ego is feasible".to_owned(),
        Outcome::NotPreferred => {
            let hit = one.best.iter().find(|candidate| candidate.feasible && candidate.contact.is_some());
            let loss = hit.zip(one.best.first()).and_then(|(hit, chosen)| hit.largest_loss(chosen));
            let loss =
                loss.map_or(String::new(), |(name, loss)| format!(", above all for `{name}` ({loss:.2})"));
            format!("no attack: the selection prefers one without contact{loss}")
        }
        Outcome::NotBelievable => {
            format!("an attack that is not believable: {}", one.selected_unbelievable.join(", "))
        }
    }
}

/// A value with two digits, and no minus before a zero.
fn hundredths(value: f64) -> String {
    let text = format!("{value:.2}");
    if text == "-0.00" { "0.00".to_owned() } else { text }
}

/// The values of the best candidates, and what they consist of.
fn values(one: &Explanation) -> String {
    let names = one.best.first().map_or(&[][..], |candidate| &candidate.terms);
    let heads = ["candidate", "contact", "value"].map(str::to_owned).into_iter();
    let row = |candidate: &ValuedCandidate| {
        let mut name = candidate.number.to_string();
        if candidate.is_chosen {
            name += ", selected";
        }
        if !candidate.feasible {
            name += ", infeasible";
        }
        let contact = candidate.contact.map_or("-".to_owned(), |step| format!("{:.1} s", step as f64 / 10.0));
        let terms = candidate.terms.iter().map(|(_, value)| hundredths(*value));
        [name, contact, hundredths(candidate.value)].into_iter().chain(terms).collect()
    };
    let table = Table {
        title: String::new(),
        heads: heads.chain(names.iter().map(|(name, _)| name.clone())).collect(),
        rows: one.best.iter().map(row).collect(),
        names: 1,
    };
    format!("\n{}", table.narrow().markdown())
}
