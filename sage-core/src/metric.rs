//! Metrics: named values of a result, which benchmarks report as columns.
//!
//! A metric has a name, a unit and a function that gives its value, or `None` where it is not measured. What it is of
//! is its type parameter: a trajectory ([`MeasuredTrajectory`]), and in other crates a drive, an attack on a driver, an
//! episode, a policy without selection, or a prediction.

mod pooled;
mod trajectory;

use std::{borrow::Cow, sync::Arc};

pub use pooled::TwoSamples;
pub use trajectory::{LogMeasures, MeasuredTrajectory, feasible_hit, trajectory_metrics};

use crate::Error;

/// How the values of many scenes become one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Aggregate {
    /// Share of the scenes with value 1; the others have value 0.
    Share,
    /// Mean.
    Mean,
    /// Median.
    Median,
    /// Distance of two samples that are pooled over scenes; see [`Metric::pooled`].
    Pooled,
}

/// Which values of a metric are better for who reads the table: more adverse attacks, or better drivers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Better {
    /// Larger values.
    More,
    /// Smaller values.
    Less,
    /// Neither.
    Neither,
}

/// What a metric is, without its function.
#[derive(Clone, Debug, PartialEq)]
pub struct MetricInfo {
    /// Name, unique among the metrics of the same kind of results.
    pub name: Cow<'static, str>,
    /// Unit; empty for a share or a number without one.
    pub unit: Cow<'static, str>,
    /// One-line description.
    pub summary: Cow<'static, str>,
    /// How scenes are averaged.
    pub aggregate: Aggregate,
    /// Which values are better.
    pub better: Better,
    /// Whether it takes a search, so that `*` does not stand for it.
    pub is_costly: bool,
    /// Whether it differs from run to run, as times do; `*` does not stand for it either.
    pub varies: bool,
    /// Name of the metric that weighs the scenes in a mean, such as the number of steps.
    pub weight: Option<Cow<'static, str>>,
}

type Value<S> = Arc<dyn Fn(&S) -> Option<f64> + Send + Sync>;
type Note<S> = Arc<dyn Fn(&S) -> Option<String> + Send + Sync>;

/// A named value of a result `S`.
///
/// ```
/// use sage_core::metric::{Metric, Metrics};
///
/// /// A result, of which metrics are columns of a table.
/// struct Drive {
///     metres: f64,
///     contact: Option<f64>,
/// }
///
/// let metrics = Metrics::default()
///     .with(Metric::mean("distance", |drive: &Drive| Some(drive.metres)).unit("m").more_is_better())?
///     .with(Metric::median("contact after", |drive: &Drive| drive.contact).unit("s"))?;
/// let drive = Drive { metres: 61.5, contact: None };
/// // Without a contact there is no time of it: not measured, not 0.
/// assert_eq!(metrics.all().iter().map(|metric| metric.value(&drive)).collect::<Vec<_>>(), [Some(61.5), None]);
/// # Ok::<(), sage_core::Error>(())
/// ```
pub struct Metric<S: ?Sized> {
    /// What it is.
    pub info: MetricInfo,
    value: Value<S>,
    note: Option<Note<S>>,
}

impl<S: ?Sized> Metric<S> {
    fn new(
        aggregate: Aggregate,
        name: impl Into<Cow<'static, str>>,
        value: impl Fn(&S) -> Option<f64> + Send + Sync + 'static,
    ) -> Self {
        let info = MetricInfo {
            name: name.into(),
            unit: Cow::default(),
            summary: Cow::default(),
            aggregate,
            better: Better::Neither,
            is_costly: false,
            varies: false,
            weight: None,
        };
        Self { info, value: Arc::new(value), note: None }
    }

    /// A mean over scenes.
    pub fn mean(
        name: impl Into<Cow<'static, str>>,
        value: impl Fn(&S) -> Option<f64> + Send + Sync + 'static,
    ) -> Self {
        Self::new(Aggregate::Mean, name, value)
    }

    /// A median over scenes.
    pub fn median(
        name: impl Into<Cow<'static, str>>,
        value: impl Fn(&S) -> Option<f64> + Send + Sync + 'static,
    ) -> Self {
        Self::new(Aggregate::Median, name, value)
    }

    /// A share of scenes.
    pub fn share(
        name: impl Into<Cow<'static, str>>,
        holds: impl Fn(&S) -> Option<bool> + Send + Sync + 'static,
    ) -> Self {
        Self::new(Aggregate::Share, name, move |of| holds(of).map(|holds| f64::from(u8::from(holds))))
    }

    /// The same with a unit.
    pub fn unit(mut self, unit: impl Into<Cow<'static, str>>) -> Self {
        self.info.unit = unit.into();
        self
    }

    /// The same with a one-line description.
    pub fn about(mut self, summary: impl Into<Cow<'static, str>>) -> Self {
        self.info.summary = summary.into();
        self
    }

    /// The same, where larger values are better.
    pub fn more_is_better(mut self) -> Self {
        self.info.better = Better::More;
        self
    }

    /// The same, where smaller values are better.
    pub fn less_is_better(mut self) -> Self {
        self.info.better = Better::Less;
        self
    }

    /// The same as a mean that weighs each scene by another metric.
    pub fn weighted_by(mut self, metric: impl Into<Cow<'static, str>>) -> Self {
        self.info.weight = Some(metric.into());
        self
    }

    /// The same, for a metric that takes a search.
    pub fn costly(mut self) -> Self {
        self.info.is_costly = true;
        self
    }

    /// The same, for a metric that differs from run to run.
    pub fn varying(mut self) -> Self {
        self.info.varies = true;
        self
    }

    /// The metric of a part of a larger result; not measured where the result does not have the part.
    pub fn of_part<P: ?Sized>(
        &self,
        part: impl Fn(&P) -> Option<&S> + Copy + Send + Sync + 'static,
    ) -> Metric<P>
    where
        S: 'static,
    {
        let (value, note) = (self.value.clone(), self.note.clone());
        let note = note.map(|note| -> Note<P> { Arc::new(move |of| note(part(of)?)) });
        Metric { info: self.info.clone(), value: Arc::new(move |of| value(part(of)?)), note }
    }

    /// The same with words about its value, such as whom a contact is with.
    pub fn with_note(mut self, note: impl Fn(&S) -> Option<String> + Send + Sync + 'static) -> Self {
        self.note = Some(Arc::new(note));
        self
    }

    /// Words about the value of a result, if there are any.
    pub fn note(&self, of: &S) -> Option<String> {
        self.note.as_ref()?(of)
    }

    /// Value of a result; `None` where it is not measured.
    pub fn value(&self, of: &S) -> Option<f64> {
        (self.value)(of)
    }
}

impl<S: ?Sized> Clone for Metric<S> {
    fn clone(&self) -> Self {
        Self { info: self.info.clone(), value: self.value.clone(), note: self.note.clone() }
    }
}

/// The registered metrics of one kind of results.
pub struct Metrics<S: ?Sized>(Vec<Metric<S>>);

impl<S: ?Sized> Default for Metrics<S> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<S: ?Sized> Clone for Metrics<S> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<S: ?Sized> Metrics<S> {
    /// Adds a metric.
    ///
    /// *Errors*: [`Error::Duplicate`] if its name is taken.
    pub fn with(mut self, metric: Metric<S>) -> Result<Self, Error> {
        if self.0.iter().any(|known| known.info.name == metric.info.name) {
            return Err(Error::Duplicate { kind: KIND, name: metric.info.name.into_owned() });
        }
        self.0.push(metric);
        Ok(self)
    }

    /// Adds several metrics.
    ///
    /// *Errors*: as [`Metrics::with`].
    pub fn with_all(self, metrics: impl IntoIterator<Item = Metric<S>>) -> Result<Self, Error> {
        metrics.into_iter().try_fold(self, Self::with)
    }

    /// All metrics in their order.
    pub fn all(&self) -> &[Metric<S>] {
        &self.0
    }

    /// The metrics that a list names, in its order. `*` stands for all that the list does not name, that take no search, and
    /// that are not pooled: the rows of pooled metrics hold all samples.
    ///
    /// *Errors*: [`Error::Unknown`] for a name that is not registered.
    pub fn by_names(&self, names: &[String]) -> Result<Vec<Metric<S>>, Error> {
        let mut chosen: Vec<Metric<S>> = Vec::new();
        for name in names {
            if name == EVERY {
                let rest = self.0.iter().filter(|metric| {
                    !metric.info.is_costly
                        && !metric.info.varies
                        && metric.info.aggregate != Aggregate::Pooled
                        && !names.iter().any(|n| *n == metric.info.name)
                });
                chosen.extend(rest.cloned());
                continue;
            }
            let found = self.0.iter().find(|metric| metric.info.name == *name);
            chosen.push(found.cloned().ok_or_else(|| Error::Unknown {
                kind: KIND,
                name: name.clone(),
                known: self.0.iter().map(|metric| metric.info.name.to_string()).collect(),
            })?);
        }
        Ok(chosen)
    }
}

/// Kind of this registry in messages.
const KIND: &str = "metric";
/// Stands for all other metrics in a list of names.
const EVERY: &str = "*";

#[cfg(test)]
mod tests {
    use super::*;

    fn metrics() -> Metrics<f64> {
        Metrics::default()
            .with_all([
                Metric::share("positive", |x: &f64| Some(*x > 0.0)),
                Metric::mean("size", |x: &f64| Some(x.abs())).unit("m"),
                Metric::median("root", |x: &f64| (*x >= 0.0).then(|| x.sqrt())),
            ])
            .unwrap()
    }

    #[test]
    fn a_metric_has_a_value_or_is_not_measured() {
        let metrics = metrics();
        let values = |x: f64| metrics.all().iter().map(|metric| metric.value(&x)).collect::<Vec<_>>();
        assert_eq!(values(4.0), [Some(1.0), Some(4.0), Some(2.0)]);
        assert_eq!(values(-4.0), [Some(0.0), Some(4.0), None]);
    }

    #[test]
    fn a_star_stands_for_what_a_list_does_not_name() {
        let names = |list: &[&str]| {
            let list: Vec<String> = list.iter().map(|name| (*name).to_owned()).collect();
            let chosen = metrics().by_names(&list).map_err(|error| error.to_string())?;
            Ok::<_, String>(chosen.into_iter().map(|metric| metric.info.name).collect::<Vec<_>>())
        };
        assert_eq!(names(&["root", "*"]).unwrap(), ["root", "positive", "size"]);
        let error = names(&["roof"]).unwrap_err();
        assert!(error.contains("`roof`") && error.contains("positive, size, root"), "{error}");
        assert!(metrics().with(Metric::mean("size", |x: &f64| Some(*x))).is_err());
    }
}
