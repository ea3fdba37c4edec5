//! Values of two samples in a scene, pooled over scenes before their distance is taken.

use std::fmt::Write as _;

use super::{Aggregate, Metric};
use crate::statistics::wasserstein;

/// Two samples of a scene: values in ascending order, each with how often it occurs. Values are rounded to 32 bits, as they are
/// stored.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TwoSamples(pub [Vec<(f32, u32)>; 2]);

impl TwoSamples {
    /// Two samples in any order; values that are not finite are left out.
    pub fn new(samples: [&[f64]; 2]) -> Self {
        Self(samples.map(|values| {
            let mut sorted: Vec<f32> = values.iter().map(|x| *x as f32).filter(|x| x.is_finite()).collect();
            sorted.sort_unstable_by(f32::total_cmp);
            sorted.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as u32)).collect()
        }))
    }

    /// Adds the values of others.
    pub fn append(&mut self, others: Self) {
        for (own, other) in self.0.iter_mut().zip(others.0) {
            own.extend(other);
            own.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
    }

    /// As text: values in ascending order, `*n` behind those that occur n times, the samples apart by `|`.
    pub fn text(&self) -> String {
        let sample = |values: &Vec<(f32, u32)>| {
            let mut text = String::new();
            for (k, (x, n)) in values.iter().enumerate() {
                let space = if k == 0 { "" } else { " " };
                // Writing to a string cannot fail.
                let _ = if *n == 1 { write!(text, "{space}{x}") } else { write!(text, "{space}{x}*{n}") };
            }
            text
        };
        self.0.each_ref().map(sample).join("|")
    }

    /// The samples of a text; `None` if it holds none.
    pub fn parse(text: &str) -> Option<Self> {
        let sample = |text: &str| -> Option<Vec<(f32, u32)>> {
            let one = |word: &str| match word.split_once('*') {
                Some((x, n)) => Some((x.parse().ok()?, n.parse().ok()?)),
                None => Some((word.parse().ok()?, 1)),
            };
            text.split_whitespace().map(one).collect()
        };
        let (a, b) = text.split_once('|')?;
        Some(Self([sample(a)?, sample(b)?]))
    }
}

impl<S: ?Sized> Metric<S> {
    /// The 1-Wasserstein distance of two samples that are pooled over scenes. Its value in a scene is the distance of the
    /// samples of this scene.
    pub fn pooled(
        name: &'static str,
        samples: impl Fn(&S) -> Option<[Vec<f64>; 2]> + Clone + Send + Sync + 'static,
    ) -> Self {
        let of_note = samples.clone();
        let distance = move |of: &S| samples(of).map(|[a, b]| wasserstein(&a, &b));
        let note = move |of: &S| of_note(of).map(|[a, b]| TwoSamples::new([&a, &b]).text());
        Self::new(Aggregate::Pooled, name, distance).with_note(note)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_survive_as_text() {
        let samples = TwoSamples::new([&[2.0, -1.5, 2.0, f64::NAN], &[]]);
        assert_eq!(samples.text(), "-1.5 2*2|");
        assert_eq!(TwoSamples::parse(&samples.text()), Some(samples));
        assert_eq!(TwoSamples::parse("1 x|"), None);
        assert_eq!(TwoSamples::parse(""), None);
    }
}
