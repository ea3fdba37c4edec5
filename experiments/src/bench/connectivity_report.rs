//! The page, tables and pictures of `sage analyse connectivity`.

use std::fmt::Write as _;

use anyhow::{Context as _, Result};
use sage_bench::curve::{self, Curve as Sweep, Point as Measure};
use sage_core::{
    seed::Rng,
    statistics::{self, Estimate},
};
use sage_merging::{ADVERSARIAL, ExpertSet, Geometry, REALISTIC};

use super::{
    bar_chart,
    connectivity::{Path, VALUES, Value, best_lambda},
    expert_path::Points,
    heat_map::{self, Grid},
    line_chart::{self, Chart, Line},
    principal_components::Components,
    weight_and_output::{COMPARED, Comparison},
};
use crate::output::Folder;

/// The page as Markdown.
pub(crate) const PAGE: &str = "connectivity.md";
/// All files.
pub(crate) const FILES: [&str; 13] = [
    PAGE,
    "path.csv",
    "path.svg",
    "geometry.svg",
    "layers.csv",
    "layers.svg",
    "landscape.csv",
    "landscape-reward.svg",
    "landscape-penalty.svg",
    "extrapolation.csv",
    "extrapolation.svg",
    "components.csv",
    "components.svg",
];
/// Resamples of an interval.
const RESAMPLES: usize = 2000;
/// μ whose best λ is reported.
const PREFERENCES: [f64; 7] = [0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0];
/// Tensors in the picture of layers, those that moved most.
const LAYERS: usize = 20;
/// The two kinds of extrapolation.
const BEYOND: [&str; 2] = ["vector", "direct"];

/// What was measured.
pub(crate) struct Connectivity<'e> {
    /// All experts of the weights, for the principal components.
    pub(crate) all: &'e ExpertSet,
    /// Of the realistic and the adversarial expert, in this order.
    pub(crate) geometry: Geometry,
    pub(crate) path: Sweep,
    /// Means on the plane, row by row of the realistic share.
    pub(crate) landscape: Vec<Measure>,
    /// Beyond the adversarial expert along its vector, and along the line through both.
    pub(crate) beyond: [Sweep; 2],
    /// Weight against output mixing, by scene.
    pub(crate) mixing: Vec<[Comparison; 3]>,
    pub(crate) points: Points,
}

impl Connectivity<'_> {
    /// Writes all files.
    ///
    /// *Errors*: the folder cannot be written to.
    pub(crate) fn write(&self, folder: &Folder) -> Result<()> {
        folder.write("path.csv", self.path_csv()?.as_bytes())?;
        folder.write(
            "path.svg",
            line_chart::draw(["lambda", "height above the chord"], self.heights())?.as_bytes(),
        )?;
        folder.write("geometry.svg", line_chart::draw(["lambda", "value"], self.norms())?.as_bytes())?;
        folder.write("layers.csv", self.layers_csv()?.as_bytes())?;
        folder.write("layers.svg", self.layers().as_bytes())?;
        folder.write("landscape.csv", self.landscape_csv()?.as_bytes())?;
        let pictures: [(&str, &str, Value); 2] = [
            ("landscape-reward.svg", "R_adv", |m| m.reward),
            ("landscape-penalty.svg", "P_real", |m| m.penalty),
        ];
        for (file, title, value) in pictures {
            folder.write(file, self.landscape(title, value)?.as_bytes())?;
        }
        folder.write("extrapolation.csv", self.extrapolation_csv()?.as_bytes())?;
        let beyond = Chart {
            axes: ["length of the step / distance between the experts", "R_adv"],
            lines: self.extrapolation(),
            is_legend_high: true,
            ..Chart::default()
        };
        folder.write("extrapolation.svg", beyond.draw()?.as_bytes())?;
        let (csv, svg) = self.components()?;
        folder.write("components.csv", csv.as_bytes())?;
        folder.write("components.svg", svg.as_bytes())?;
        folder.write(PAGE, self.page()?.as_bytes())
    }

    /// The page.
    ///
    /// *Errors*: no scene was evaluated.
    pub(crate) fn page(&self) -> Result<String> {
        let norm = |at: &[f64]| self.geometry.norm(at);
        let cosine = self.geometry.cosine(&[1.0, 0.0], &[0.0, 1.0]);
        let [real, adversarial] = [norm(&[1.0, 0.0]), norm(&[0.0, 1.0])];
        let values: usize = self.geometry.tensors().iter().map(|tensor| tensor.size).sum();
        let mut out = format!(
            "Linear mode connectivity of two experts.\n\n| geometry | value |\n| --- | --- |\n\
            | tuned values | {values} in {} tensors |\n| norm of the realistic vector | {real:.3} |\n\
            | norm of the adversarial vector | {adversarial:.3} |\n| norm of their difference | {:.3} |\n\
            | angle | {:.2}° |\n| ratio of the norms; 1 / cos | {:.3}; {:.3} |\n",
            self.geometry.tensors().len(),
            norm(&[-1.0, 1.0]),
            cosine.acos().to_degrees(),
            adversarial.max(real) / adversarial.min(real),
            1.0 / cosine,
        );
        out += "\nExpectations under the interpolated policy, above the chord between the experts:\n\n\
            | value | least height | mean height | concave at % of lambda |\n| --- | --- | --- | --- |\n";
        for (name, value) in VALUES {
            let path = Path::of(&self.path, value).context("no scene could be evaluated")?;
            let cells = [&path.least, &path.mean, &path.concave].map(cell);
            writeln!(out, "| {name} | {} |", cells.join(" | "))?;
        }
        out += "\nLambda at which mu R_adv - (1 - mu) P_real is largest along the path:\n\n| mu | lambda |\n| --- | --- |\n";
        for mu in PREFERENCES {
            let best = best_lambda(&self.path, mu).context("no scene could be evaluated")?;
            writeln!(out, "| {mu} | {:.2} [{:.2}, {:.2}] |", best.value, best.low, best.high)?;
        }
        out += &self.extrapolation_table()?;
        out += &self.mixing_table()?;
        out += "\nIntervals: 95 %, bootstrap over scenes; differences are paired. The chord is what probability mixing \
            attains. A least height below 0 is a barrier. Selection among candidates is outside all of this.\n";
        Ok(out)
    }

    fn extrapolation_table(&self) -> Result<String> {
        let mut out = "\nBeyond the adversarial expert, at equal step lengths (shares of the distance between the experts), \
            along its preference vector and directly along the line through both experts:\n\n\
            | step | vector: R_adv | direct: R_adv | vector minus direct: R_adv | P_real |\n| --- | --- | --- | --- | --- |\n"
            .to_owned();
        let [vector, direct] = &self.beyond;
        for (k, step) in self.points.steps.iter().enumerate().step_by(2) {
            let reward = |front: &[Measure]| front[k].reward;
            let cells = [
                vector.estimate(reward),
                direct.estimate(reward),
                vector.difference(direct, reward),
                vector.difference(direct, |front| front[k].penalty),
            ];
            let cells = cells.map(|e| e.as_ref().map_or("-".to_owned(), cell));
            writeln!(out, "| {step} | {} |", cells.join(" | "))?;
        }
        Ok(out)
    }

    fn mixing_table(&self) -> Result<String> {
        let mut out = "\nWeight mixing against output mixing, by the mean trajectory of the policy and the log: loss of \
            output mixing minus that of weight mixing, m² (positive: weight mixing is better).\n\n\
            | lambda | N | difference |\n| --- | --- | --- |\n"
            .to_owned();
        for (k, lambda) in COMPARED.iter().enumerate() {
            let differences: Vec<f64> = self.mixing.iter().map(|scene| scene[k].gain()).collect();
            let mut rng = Rng::new(0, "mixing", "connectivity");
            let estimate = statistics::bootstrap_mean(&differences, RESAMPLES, &mut rng);
            let shown = estimate.as_ref().map_or("-".to_owned(), cell);
            writeln!(out, "| {lambda} | {} | {shown} |", differences.len())?;
        }
        Ok(out)
    }

    /// Heights of each value above its chord.
    fn heights(&self) -> Vec<Line> {
        let front = self.path.front();
        let line = |(name, value): &(&str, fn(&Measure) -> f64)| {
            let heights = curve::heights(&front.iter().map(value).collect::<Vec<_>>());
            let points =
                heights.iter().zip(&self.points.lambdas[1..]).map(|(height, lambda)| [*lambda, *height]);
            ((*name).to_owned(), points.collect())
        };
        VALUES.iter().map(line).collect()
    }

    /// Norm, relative to that of the adversarial vector, and cosine to it, along the path.
    fn norms(&self) -> Vec<Line> {
        let whole = self.geometry.norm(&[0.0, 1.0]);
        let line = |name: &str, value: &dyn Fn(&[f64; 2]) -> f64| {
            let points = self.points.lambdas.iter().map(|lambda| [*lambda, value(&[1.0 - lambda, *lambda])]);
            (name.to_owned(), points.collect())
        };
        vec![
            line("norm / norm of the adversarial vector", &|at| self.geometry.norm(at) / whole),
            line("cosine to the adversarial vector", &|at| self.geometry.cosine(at, &[0.0, 1.0])),
        ]
    }

    fn path_csv(&self) -> Result<String> {
        let mut out = "lambda,norm,cosine_to_adversarial,reward,penalty,attack,believable\n".to_owned();
        for (lambda, m) in self.points.lambdas.iter().zip(self.path.front()) {
            let at = [1.0 - lambda, *lambda];
            let (norm, cosine) = (self.geometry.norm(&at), self.geometry.cosine(&at, &[0.0, 1.0]));
            writeln!(
                out,
                "{lambda},{norm},{cosine},{},{},{},{}",
                m.reward, m.penalty, m.attack, m.believable
            )?;
        }
        Ok(out)
    }

    /// Share of a tensor in the squared length of each vector.
    fn shares(&self) -> impl Iterator<Item = (&str, [f64; 2])> {
        let whole = [0, 1].map(|k| self.geometry.product(k, k));
        let tensors = self.geometry.tensors().iter();
        tensors.map(move |tensor| (&*tensor.name, [0, 1].map(|k| tensor.products[k][k] / whole[k])))
    }

    fn layers_csv(&self) -> Result<String> {
        let mut out = "tensor,values,share_of_realistic,share_of_adversarial,cosine\n".to_owned();
        for (tensor, (name, shares)) in self.geometry.tensors().iter().zip(self.shares()) {
            let p = &tensor.products;
            let cosine = p[0][1] / (p[0][0] * p[1][1]).sqrt();
            writeln!(out, "{name},{},{},{},{cosine}", tensor.size, shares[0], shares[1])?;
        }
        Ok(out)
    }

    fn layers(&self) -> String {
        let mut rows: Vec<_> = self.shares().collect();
        rows.sort_by(|a, b| b.1[1].total_cmp(&a.1[1]));
        rows.truncate(LAYERS);
        bar_chart::draw(["realistic vector", "adversarial vector"], &rows)
    }

    fn landscape(&self, title: &str, value: fn(&Measure) -> f64) -> Result<String> {
        let marks = [("prior", [0.0, 0.0]), (ADVERSARIAL, [1.0, 0.0]), (REALISTIC, [0.0, 1.0])];
        heat_map::draw(&Grid {
            title,
            axes: ["share of the adversarial vector", "share of the realistic vector"],
            at: &self.points.plane,
            values: self.landscape.iter().map(value).collect(),
            marks: &marks,
        })
    }

    fn landscape_csv(&self) -> Result<String> {
        let mut out = "adversarial,realistic,reward,penalty,attack,believable\n".to_owned();
        for (k, m) in self.landscape.iter().enumerate() {
            let (a, b) = (
                self.points.plane[k % self.points.plane.len()],
                self.points.plane[k / self.points.plane.len()],
            );
            writeln!(out, "{a},{b},{},{},{},{}", m.reward, m.penalty, m.attack, m.believable)?;
        }
        Ok(out)
    }

    fn extrapolation(&self) -> Vec<Line> {
        let line = |(name, sweep): (&str, &Sweep)| {
            let points = self.points.steps.iter().zip(sweep.front()).map(|(step, m)| [*step, m.reward]);
            (name.to_owned(), points.collect())
        };
        BEYOND.into_iter().zip(&self.beyond).map(line).collect()
    }

    fn extrapolation_csv(&self) -> Result<String> {
        let mut out = "extrapolation,step,length,reward,penalty,attack,believable\n".to_owned();
        let distance = self.geometry.norm(&[-1.0, 1.0]);
        for (name, sweep) in BEYOND.into_iter().zip(&self.beyond) {
            for (step, m) in self.points.steps.iter().zip(sweep.front()) {
                let length = step * distance;
                writeln!(
                    out,
                    "{name},{step},{length},{},{},{},{}",
                    m.reward, m.penalty, m.attack, m.believable
                )?;
            }
        }
        Ok(out)
    }

    /// Principal components of the prior and all experts, with the path and the extrapolations, as CSV and SVG.
    fn components(&self) -> Result<(String, String)> {
        let geometry = Geometry::of(self.all)?;
        let names = self.all.names();
        let found = Components::of(&geometry, names.len()).context("the experts are the prior")?;
        // The mean is that of the points; the prior is at weights 0.
        let place = |real: f64, adversarial: f64| -> Result<[f64; 2]> {
            let at = self.all.mixture(&[(REALISTIC, real), (ADVERSARIAL, adversarial)])?;
            Ok(found.coordinates(at.weights()))
        };
        let of_vector = self.geometry.norm(&[-1.0, 1.0]) / self.geometry.norm(&[0.0, 1.0]);
        let line = |name: &str, of: &[f64], at: &dyn Fn(f64) -> [f64; 2]| -> Result<Line> {
            let points = of.iter().map(|x| at(*x)).map(|[real, adversarial]| place(real, adversarial));
            Ok((name.to_owned(), points.collect::<Result<_>>()?))
        };
        let lines = vec![
            line("interpolation", &self.points.lambdas, &|x| [1.0 - x, x])?,
            line("vector extrapolation", &self.points.steps, &|x| [0.0, 1.0 + x * of_vector])?,
            line("direct extrapolation", &self.points.steps, &|x| [-x, 1.0 + x])?,
        ];
        let mut marks = vec![("prior".to_owned(), place(0.0, 0.0)?)];
        for name in names {
            marks.push((name.to_owned(), found.coordinates(self.all.mixture(&[(name, 1.0)])?.weights())));
        }
        let mut csv = "kind,x,y\n".to_owned();
        let points = lines.iter().flat_map(|(name, points)| points.iter().map(move |point| (name, point)));
        for (name, [x, y]) in marks.iter().map(|(name, point)| (name, point)).chain(points) {
            writeln!(csv, "{name},{x},{y}")?;
        }
        let [first, second] = found.shares.map(|share| 100.0 * share);
        let axes = [format!("first component ({first:.0} %)"), format!("second component ({second:.0} %)")];
        let [x, y] = &axes;
        let chart = Chart { axes: [x, y], lines, marks, is_isometric: true, ..Chart::default() };
        Ok((csv, chart.draw()?))
    }
}

fn cell(e: &Estimate) -> String {
    format!("{:.3} [{:.3}, {:.3}]", e.value, e.low, e.high)
}
