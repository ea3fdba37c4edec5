//! `sage analyse connectivity`: the geometry of experts. `sage bench connectivity` measures rewards between them.

mod components;

use advsage::Registries;
use anyhow::{Context as _, Result};
use sage_bench::{
    chart::{
        bar,
        line::{self, Chart, Line},
    },
    csv_text::{csv, of_table},
};
use sage_core::text::table::Table;
use sage_merging::{ADVERSARIAL, ExpertSet, Geometry, REALISTIC};
use sage_run::{
    Outcome, networks,
    output::{self, Folder},
    progress,
};

use self::components::Components;
use crate::cli::ConnectivityArgs;

/// The page as Markdown.
const PAGE: &str = "connectivity.md";
/// Steps of λ along the path between the experts.
const STEPS: usize = 20;
/// Longest extrapolation in the picture of components, as a share of the distance between the experts.
const BEYOND: f64 = 1.5;
/// Tensors in the picture of layers, those that moved most.
const LAYERS: usize = 20;

pub(crate) fn run(args: &ConnectivityArgs, registries: &Registries) -> Result<Outcome> {
    let all = networks::load_experts(&registries.backbones, &args.weights)?;
    let geometry = Geometry::of(&all.only(&[REALISTIC, ADVERSARIAL])?)?;
    let folder = Folder::make(&args.folder.out, args.folder.force)?;
    let path = path(&geometry);
    let files = [
        ("path.csv", of_table(&path)),
        ("geometry.svg", line::draw(["lambda", "value"], along(&geometry))?),
        ("layers.csv", of_table(&layers(&geometry))),
        ("layers.svg", largest_layers(&geometry)),
    ];
    for (name, text) in files.into_iter().chain(components(&all, &geometry)?) {
        folder.write(name, text.as_bytes())?;
    }
    let page = format!("Geometry of two experts.\n\n{}", summary(&geometry).markdown());
    folder.write(PAGE, page.as_bytes())?;
    folder.finish()?;
    output::print(&page)?;
    progress::say(&format!("{PAGE}, CSV files and pictures are in `{}`", args.folder.out.display()));
    Ok(Outcome::Done)
}

/// Norms and angle of both preference vectors.
fn summary(geometry: &Geometry) -> Table {
    let cosine = geometry.cosine(&[1.0, 0.0], &[0.0, 1.0]);
    let [real, adversarial] = [geometry.norm(&[1.0, 0.0]), geometry.norm(&[0.0, 1.0])];
    let values: usize = geometry.tensors().iter().map(|tensor| tensor.size).sum();
    let mut table = Table::new("", &["geometry", "value"]);
    table.row("tuned values", [format!("{values} in {} tensors", geometry.tensors().len())]);
    table.row("norm of the realistic vector", [format!("{real:.3}")]);
    table.row("norm of the adversarial vector", [format!("{adversarial:.3}")]);
    table.row("norm of their difference", [format!("{:.3}", geometry.norm(&[-1.0, 1.0]))]);
    table.row("angle", [format!("{:.2}°", cosine.acos().to_degrees())]);
    let ratio = adversarial.max(real) / adversarial.min(real);
    table.row("ratio of the norms; 1 / cos", [format!("{ratio:.3}; {:.3}", 1.0 / cosine)]);
    table
}

/// λ along the path.
fn lambdas() -> impl Iterator<Item = f64> {
    (0..=STEPS).map(|k| k as f64 / STEPS as f64)
}

/// Norm and cosine to the adversarial vector at a λ.
fn at(geometry: &Geometry, lambda: f64) -> [f64; 2] {
    let at = [1.0 - lambda, lambda];
    [geometry.norm(&at), geometry.cosine(&at, &[0.0, 1.0])]
}

fn path(geometry: &Geometry) -> Table {
    let mut table = Table::new("", &["lambda", "norm", "cosine_to_adversarial"]);
    lambdas().for_each(|lambda| table.row(lambda.to_string(), at(geometry, lambda).map(|x| x.to_string())));
    table
}

/// Norm, relative to that of the adversarial vector, and cosine to it, along the path.
fn along(geometry: &Geometry) -> Vec<Line> {
    let whole = geometry.norm(&[0.0, 1.0]);
    let line = |name: &str, value: &dyn Fn([f64; 2]) -> f64| {
        (name.to_owned(), lambdas().map(|lambda| [lambda, value(at(geometry, lambda))]).collect())
    };
    vec![
        line("norm / norm of the adversarial vector", &|[norm, _]| norm / whole),
        line("cosine to the adversarial vector", &|[_, cosine]| cosine),
    ]
}

/// Share of a tensor in the squared length of each vector.
fn shares(geometry: &Geometry) -> impl Iterator<Item = (&str, [f64; 2])> {
    let whole = [0, 1].map(|k| geometry.product(k, k));
    let share = move |products: &[Vec<f64>]| [0, 1].map(|k| products[k][k] / whole[k]);
    geometry.tensors().iter().map(move |tensor| (&*tensor.name, share(&tensor.products)))
}

fn layers(geometry: &Geometry) -> Table {
    let heads = ["tensor", "values", "share_of_realistic", "share_of_adversarial", "cosine"];
    let mut table = Table::new("", &heads);
    for (tensor, (name, [realistic, adversarial])) in geometry.tensors().iter().zip(shares(geometry)) {
        let p = &tensor.products;
        let cosine = p[0][1] / (p[0][0] * p[1][1]).sqrt();
        let numbers = [realistic, adversarial, cosine].map(|x| x.to_string());
        table.row(name, std::iter::once(tensor.size.to_string()).chain(numbers));
    }
    table
}

fn largest_layers(geometry: &Geometry) -> String {
    let mut rows: Vec<_> = shares(geometry).collect();
    rows.sort_by(|a, b| b.1[1].total_cmp(&a.1[1]));
    rows.truncate(LAYERS);
    bar::draw(["realistic vector", "adversarial vector"], &rows)
}

/// Principal components of the prior and all experts, with the path and two extrapolations, as CSV and as a picture.
fn components(all: &ExpertSet, geometry: &Geometry) -> Result<[(&'static str, String); 2]> {
    let names = all.names();
    let found = Components::of(&Geometry::of(all)?, names.len()).context("the differences of the experts from the prior have fewer than two directions, so there is no plane to draw")?;
    let place = |[realistic, adversarial]: [f64; 2]| -> Result<[f64; 2]> {
        let at = all.mixture(&[(REALISTIC, realistic), (ADVERSARIAL, adversarial)])?;
        Ok(found.coordinates(at.weights()))
    };
    // Both extrapolations are equally long.
    let of_vector = geometry.norm(&[-1.0, 1.0]) / geometry.norm(&[0.0, 1.0]);
    let line = |name: &str, at: &dyn Fn(f64) -> [f64; 2]| -> Result<Line> {
        Ok((name.to_owned(), lambdas().map(|x| place(at(x))).collect::<Result<_>>()?))
    };
    let lines = vec![
        line("interpolation", &|x| [1.0 - x, x])?,
        line("vector extrapolation", &|x| [0.0, 1.0 + BEYOND * x * of_vector])?,
        line("direct extrapolation", &|x| [-BEYOND * x, 1.0 + BEYOND * x])?,
    ];
    let mut marks = vec![("prior".to_owned(), place([0.0, 0.0])?)];
    for name in names {
        marks.push((name.to_owned(), found.coordinates(all.mixture(&[(name, 1.0)])?.weights())));
    }
    let points = lines.iter().flat_map(|(name, points)| points.iter().map(move |point| (name, point)));
    let points = marks.iter().map(|(name, point)| (name, point)).chain(points);
    let rows = points.map(|(name, [x, y])| [name.clone(), x.to_string(), y.to_string()]);
    let rows = std::iter::once(["kind", "x", "y"].map(str::to_owned)).chain(rows);
    let text = csv(rows);
    let [first, second] = found.shares.map(|share| 100.0 * share);
    let axes = [format!("first component ({first:.0} %)"), format!("second component ({second:.0} %)")];
    let [x, y] = &axes;
    let chart = Chart { axes: [x, y], lines, marks, is_isometric: true, ..Chart::default() };
    Ok([("components.csv", text), ("components.svg", chart.draw()?)])
}
