//! Pictures of the attacks of a study, and an HTML page that shows them with its tables.

use std::collections::BTreeMap;

use anyhow::{Context as _, Result};
use rayon::prelude::*;
use sage_bench::{
    prepared_study::PreparedStudy,
    report::Report,
    rows::{Results, Subject},
    runner::SceneSource as _,
};
use sage_core::{
    objective::{Context, ContextOptions, Scorer, verdict},
    scene::SceneData,
    text::table::Table,
};
use sage_run::{
    output::{self, Folder},
    terminal::escaped_html as escaped,
};
use sage_view::drawing::{self, Picture, drawn_path};

use super::measured::ChosenScenes;

/// Pictures of believable attacks, and of failed ones.
const SHOWN: usize = 3;
const STYLE: &str = "body{font:15px sans-serif;margin:min(2em,3vw)}code,p,h1,h2{overflow-wrap:anywhere}table{max-width:100%;border-collapse:collapse;font-size:12px;display:block;overflow-x:auto}td,th{border:1px solid #ccc;padding:2px 6px;white-space:nowrap}.row{display:flex;flex-wrap:wrap;gap:1em}figure{margin:0}img{width:560px;max-width:100%;border:1px solid #ddd}";

/// A picture of an attack on the page.
struct Card {
    /// Number of the method's heading.
    heading: usize,
    method: usize,
    which: String,
    scene: usize,
}

/// Writes the strongest believable attacks of each method as SVG, some that failed, and `index.html` with the tables and
/// the pictures. The page opens from disk. Pictures are of the recorded ego.
///
/// *Errors*: the folder cannot be written to; a scene can no longer be read.
pub(super) fn write(
    folder: &Folder,
    prepared: &PreparedStudy,
    scenes: &ChosenScenes,
    results: &Results,
    report: &Report,
) -> Result<()> {
    let methods = results.methods(Subject::Trajectory);
    let shown_together = together(results, &methods, prepared.study.report.cases)?;
    let mut cards = Vec::new();
    for (k, method) in methods.iter().enumerate() {
        let together = shown_together.iter().enumerate();
        let together = together.map(|(number, scene)| (format!("case-{}", number + 1), *scene));
        let named = cases(results, *method, prepared.study.report.cases)?.into_iter().chain(together);
        cards.extend(named.map(|(which, scene)| Card { heading: k, method: *method, which, scene }));
    }
    let mut by_scene: BTreeMap<usize, Vec<&Card>> = BTreeMap::new();
    cards.iter().for_each(|card| by_scene.entry(card.scene).or_default().push(card));
    let names = scenes.names();
    let figures = |(scene, cards): (usize, Vec<&Card>)| -> Result<Vec<((usize, String), String)>> {
        let name = &results.scenes[scene];
        let number = names.iter().position(|known| known == name).context("the scene was measured")?;
        let Some(data) = scenes.load(number)? else { return Ok(Vec::new()) };
        let figures = cards.into_iter().map(|card| {
            let figure = figure(folder, prepared, results, card, &data)?;
            Ok(figure.map(|figure| ((card.heading, card.which.clone()), figure)))
        });
        figures.filter_map(Result::transpose).collect()
    };
    let figures = by_scene.into_par_iter().map(figures).collect::<Result<Vec<_>>>()?;
    let figures: BTreeMap<(usize, String), String> = figures.into_iter().flatten().collect();
    let row = |(k, method): (usize, &usize)| {
        let is_alone = |card: &&Card| card.heading == k && !card.which.starts_with("case-");
        let of_method = cards.iter().filter(is_alone);
        let figures: String =
            of_method.filter_map(|card| figures.get(&(k, card.which.clone())).map(|f| &**f)).collect();
        let label = escaped(&results.keys[*method].attack_label());
        format!("<h2>{label}</h2><div class=row>\n{figures}</div>\n")
    };
    let case = |(number, scene): (usize, &usize)| {
        let which = format!("case-{}", number + 1);
        let of_case = (0..methods.len()).filter_map(|k| {
            let figure = figures.get(&(k, which.clone()))?;
            Some(figure.replace(
                &format!("{which}: "),
                &format!("{}: ", escaped(&results.keys[methods[k]].attack_label())),
            ))
        });
        let figures: String = of_case.collect();
        format!(
            "<h2>All methods in {}</h2><div class=row>\n{figures}</div>\n",
            escaped(&results.scenes[*scene])
        )
    };
    let together: String = shown_together.iter().enumerate().map(case).collect();
    let cards: String = together + &methods.iter().enumerate().map(row).collect::<String>();
    let title = escaped(&format!("sage bench {}", prepared.study.study));
    let tables: String = report.tables.iter().map(html).collect();
    let page = format!(
        "<!doctype html><meta charset=utf-8><meta name=viewport content=\"width=device-width\"><title>{title}</title>\n<style>{STYLE}</style>\n<h1>{title}</h1>\n<p><code>{}</code></p>\n{tables}<p>{}</p>{cards}",
        escaped(&output::command()),
        escaped(&(report.words.iter().map(|(_, words)| &**words).collect::<String>() + &report.notes)),
    );
    Ok(folder.write("index.html", page.as_bytes())?)
}

/// Number of a metric that pictures need.
fn metric(results: &Results, name: &str) -> Result<usize> {
    let number = results.metric(Subject::Trajectory, name);
    number.with_context(|| format!("pictures need the metric `{name}`"))
}

fn value(results: &Results, method: usize, scene: usize, metric: usize) -> Option<f64> {
    let cell = results.cells[scene].iter().find(|cell| cell.key == method);
    cell.and_then(|cell| *cell.values.get(metric)?)
}

/// The scenes in which the most methods have a contact, the first of equals first; at most `count`.
fn together(results: &Results, methods: &[usize], count: usize) -> Result<Vec<usize>> {
    if count == 0 {
        return Ok(Vec::new());
    }
    let contact = metric(results, "attack, feasible or not")?;
    let hits = |scene: usize| {
        methods.iter().filter(|method| value(results, **method, scene, contact) == Some(1.0)).count()
    };
    let mut scenes: Vec<usize> = (0..results.scenes.len()).collect();
    scenes.sort_by_cached_key(|scene| std::cmp::Reverse(hits(*scene)));
    scenes.truncate(count);
    Ok(scenes)
}

/// The strongest believable attacks, and of the other scenes those closest to one: first attacks that are not
/// believable, then trajectories without contact; and some of the least realistic trajectories.
fn cases(results: &Results, method: usize, unrealistic: usize) -> Result<Vec<(String, usize)>> {
    let [believable, contact, strength] =
        ["believable", "attack, feasible or not", "R_adv"].map(|name| metric(results, name));
    let [believable, contact, strength] = [believable?, contact?, strength?];
    let value = |scene: usize, metric: usize| value(results, method, scene, metric);
    let measured = (0..results.scenes.len()).filter(|scene| value(*scene, strength).is_some());
    let (mut attacks, mut failed): (Vec<usize>, Vec<usize>) =
        measured.partition(|scene| value(*scene, believable) == Some(1.0));
    let number = |scene: usize, metric: usize| value(scene, metric).unwrap_or(f64::NEG_INFINITY);
    attacks.sort_by(|a, b| number(*b, strength).total_cmp(&number(*a, strength)));
    failed.sort_by(|a, b| {
        let by = |metric| number(*b, metric).total_cmp(&number(*a, metric));
        by(contact).then(by(strength))
    });
    let first = |name: &str, count: usize, scenes: Vec<usize>| {
        let named = scenes.into_iter().take(count).enumerate();
        named.map(|(k, scene)| (format!("{name}-{}", k + 1), scene)).collect::<Vec<_>>()
    };
    let mut all =
        [first("strongest", SHOWN, attacks.clone()), first("failed", SHOWN, failed.clone())].concat();
    if unrealistic > 0 {
        let penalty = metric(results, "P_real")?;
        let mut scenes = [attacks, failed].concat();
        scenes.sort_by(|a, b| number(*b, penalty).total_cmp(&number(*a, penalty)));
        all.extend(first("least-realistic", unrealistic, scenes));
    }
    Ok(all)
}

/// Draws an attack, and returns its picture with its verdict and the reasons as HTML.
fn figure(
    folder: &Folder,
    prepared: &PreparedStudy,
    results: &Results,
    card: &Card,
    data: &SceneData,
) -> Result<Option<String>> {
    let Some(attack) = prepared.attack(card.method, data)? else { return Ok(None) };
    let (name, label) = (&results.scenes[card.scene], results.keys[card.method].attack_label());
    let ctx = Context::new(&data.scene, &data.index, &ContextOptions::default())?;
    let trajectory = attack.trajectory().clone();
    let scores = Scorer::new(&ctx).scores(&ctx.candidate(trajectory.clone()));
    let words = verdict(scores.believable, &scores.unbelievable).unwrap_or_else(|| "no contact".to_owned());
    let note = attack.note.as_ref().map_or(String::new(), |note| format!("; {note}"));
    let mut caption = format!("{words}, R_adv {:.2}{note}", scores.adversarial_reward);
    if prepared.study.report.cases > 0 {
        caption += &format!(", P_beh {:.2}, P_kin {:.2}", scores.behavior_penalty, scores.kinematic_penalty);
    }
    let drawn = drawn_path(label, &ctx, trajectory);
    let picture = Picture { title: name.clone(), candidates: vec![drawn], ..Picture::default() };
    let Card { heading, which, .. } = card;
    let file = format!("{heading:02}-{which}.svg");
    folder.write(&file, drawing::draw(&data.scene, &picture).as_bytes())?;
    Ok(Some(format!(
        "<figure><a href=\"{file}\"><img src=\"{file}\" loading=lazy></a><figcaption>{which}: {}, {}</figcaption></figure>\n",
        escaped(name),
        escaped(&caption),
    )))
}

/// A table as HTML.
fn html(table: &Table) -> String {
    let row = |cells: &[String], tag: &str| {
        let cells: String = cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell))).collect();
        format!("<tr>{cells}</tr>\n")
    };
    let rows: String = table.rows.iter().map(|cells| row(cells, "td")).collect();
    format!("<p>{}</p>\n<table>\n{}{rows}</table>\n", escaped(&table.title), row(&table.heads, "th"))
}
