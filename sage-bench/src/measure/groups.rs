//! Generators with one set of weights and one merger, at their operating points.

use std::sync::Arc;

use advsage::{
    generators::{BuiltGenerator, Generators, refuse_duplicates},
    operating_point::{Mix, OperatingPointSpec, OperatingPoints, Values},
    part::Part,
    selection::Selection,
};
use sage_backbones::Backbone;
use sage_generators::{Aggression, GeneratorInputs};
use sage_merging::{ExpertSet, Merger};

use crate::{
    Error, Registries, Result,
    chart::triangle::mixtures,
    context::{Context as _, require},
    rows::Subject,
    study::Study,
};

/// Where a study gets its experts from.
pub trait ExpertSource {
    /// A prior by name, or a network without weights.
    ///
    /// *Errors*: there is none.
    fn network(&self, name: &str) -> Result<Arc<dyn Backbone>>;

    /// Experts by name or folder.
    ///
    /// *Errors*: there are none, or they do not match their network.
    fn experts(&self, name: &str) -> Result<ExpertSet>;

    /// The aggression dial of experts.
    ///
    /// *Errors*: there is none for the selection and the merger.
    fn dial(
        &self,
        name: &str,
        experts: &ExpertSet,
        selection: &Selection,
        merger: &str,
    ) -> Result<Aggression>;
}

/// Generators that share weights and merger.
pub struct Group {
    /// What distinguishes it from the other groups; empty if there is only one.
    pub arm: String,
    /// Number of the folder among those of its arm.
    pub training_seed: Option<u64>,
    /// Prior and experts.
    pub experts: ExpertSet,
    /// Merger of the experts.
    pub merger: Arc<dyn Merger>,
    /// All operating points.
    pub points: Vec<OperatingPointSpec>,
    /// The generators with their operating points.
    pub built: Vec<BuiltGenerator>,
}

impl Group {
    /// The same weights, merger and operating points, for what is measured without generators.
    pub fn without_generators(&self) -> Self {
        Self {
            arm: self.arm.clone(),
            training_seed: self.training_seed,
            experts: self.experts.clone(),
            merger: self.merger.clone(),
            points: self.points.clone(),
            built: Vec::new(),
        }
    }

    /// Generators with these weights and this merger.
    pub fn generators<'r>(
        &self,
        registries: &'r Registries,
        selection: &Selection,
        seed: u64,
    ) -> Generators<'r> {
        let inputs = GeneratorInputs {
            experts: Some(self.experts.clone()),
            merger: self.merger.clone(),
            seed,
            selection: Arc::new(selection.objective.clone()),
        };
        Generators::with_inputs(&registries.parts, inputs)
    }

    /// All groups of a study: every weights with every merger.
    ///
    /// *Errors*: a name is not registered, weights cannot be used, or an operating point is out of range.
    pub fn all(
        study: &Study,
        registries: &Registries,
        source: &dyn ExpertSource,
        selection: &Selection,
    ) -> Result<Vec<Self>> {
        let named: Vec<(&str, &str)> =
            study.weights.iter().map(|entry| entry.split_once('=').unwrap_or(("", entry))).collect();
        let arms: Vec<&str> =
            named.iter().map(|(arm, folder)| if arm.is_empty() { folder } else { arm }).copied().collect();
        let has_several = arms.iter().any(|arm| *arm != arms[0]);
        let mergers: Vec<Part> =
            study.merger.iter().map(|text| text.parse().map_err(Error::Value)).collect::<Result<_>>()?;
        require(
            !mergers.is_empty(),
            || "`merger` of the study is empty; expected a name, such as `merger: linear`",
        )?;
        require(
            !named.is_empty(),
            || "`weights` of the study is empty; expected a name, such as `weights: procedural`",
        )?;
        let mut groups = Vec::new();
        for (k, (arm, folder)) in named.iter().enumerate() {
            let experts = source.experts(folder)?;
            let earlier = arms[..k].iter().filter(|known| **known == arms[k]).count();
            let training_seed = (!arm.is_empty()).then_some(earlier as u64);
            for part in &mergers {
                let generators =
                    Generators::new(&registries.parts, part, selection, study.seed)?.with_experts(&experts);
                let merger = generators.merger().clone();
                let points =
                    points(study, &*merger, || source.dial(folder, &experts, selection, &part.to_string()))?;
                let built = built(study, &generators, &points)?;
                let labels = [(has_several, arms[k].to_owned()), (mergers.len() > 1, part.to_string())];
                let labels: Vec<String> =
                    labels.into_iter().filter(|(varies, _)| *varies).map(|(_, label)| label).collect();
                let arm = labels.join(", ");
                groups.push(Self { arm, training_seed, experts: experts.clone(), merger, points, built });
            }
        }
        Ok(groups)
    }
}

/// The operating points of a study: those that it lists, then its grid and its plane.
fn points(
    study: &Study,
    merger: &dyn Merger,
    dial: impl FnOnce() -> Result<Aggression>,
) -> Result<Vec<OperatingPointSpec>> {
    let on_triangle = study.triangle.iter().flat_map(|axis| {
        let named = |weights: [f64; 3]| axis.experts.iter().cloned().zip(weights).collect();
        mixtures(axis.steps).into_iter().map(named)
    });
    let listed = study.mix.iter().map(|mix| mix.clone().into_iter().collect());
    let range = merger.range();
    let some = |values: &Vec<f64>| (!values.is_empty()).then(|| Values(values.clone()));
    let listed = OperatingPoints {
        aggression: some(&study.aggression),
        mix: on_triangle.chain(listed).map(Mix).collect(),
        lambda: some(&study.lambda),
        mu: study.mu,
    };
    let mut points = listed.specs(range, dial)?;
    for lambda in study.grid.iter().flat_map(|[lambdas, _]| lambdas) {
        for mu in study.grid.iter().flat_map(|[_, mus]| mus) {
            let point = OperatingPointSpec::at(*lambda, Some(*mu), range)?;
            if !points.contains(&point) {
                points.push(point);
            }
        }
    }
    if let Some(axis) = &study.plane {
        let [a, b] = &axis.experts;
        let named = |y: &f64, x: &f64| vec![(a.clone(), *x), (b.clone(), *y)];
        let mix =
            axis.shares.iter().flat_map(|y| axis.shares.iter().map(move |x| Mix(named(y, x)))).collect();
        let plane = OperatingPoints { mix, mu: study.mu, ..OperatingPoints::default() };
        points.extend(plane.specs(range, || Err(Error::Value("a plane has no aggression".to_owned())))?);
    }
    Ok(points)
}

/// The generators of a study in their order. An upper bound gets only the operating point with the largest μ.
fn built(
    study: &Study,
    generators: &Generators,
    points: &[OperatingPointSpec],
) -> Result<Vec<BuiltGenerator>> {
    let subjects = [Subject::Trajectory, Subject::AttackedDrive, Subject::Episode];
    if !subjects.into_iter().any(|subject| study.measures(subject)) {
        return Ok(Vec::new());
    }
    let largest_mu: Vec<OperatingPointSpec> =
        points.iter().max_by(|a, b| a.mu.total_cmp(&b.mu)).into_iter().cloned().collect();
    let build = |text: &String| {
        let part: Part = text.parse().map_err(Error::Value)?;
        let facts = generators.facts(&part)?;
        require(!points.is_empty() || !facts.uses_operating_point(), || {
            format!(
                "generator `{text}`: the study has no operating point; give `lambda`, `aggression` or `mix`"
            )
        })?;
        generators
            .build(&part, if facts.is_upper_bound { &largest_mu } else { points })
            .with_context(|| format!("generator `{text}`"))
    };
    let built = study.method.iter().map(build).collect::<Result<Vec<_>>>()?;
    refuse_duplicates(&built.iter().flat_map(|built| built.keys.clone()).collect::<Vec<_>>())?;
    Ok(built)
}
