//! Numbers of the paper, beside which a study shows its own.

use std::collections::BTreeMap;

use serde::{Deserialize, Deserializer};

use crate::{
    Result,
    context::{Context as _, foreign},
    rows::Key,
    study::Claim,
};

/// The file of all numbers.
const FILE: &str = include_str!("../published.yaml");

/// A row of a published table.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Published {
    /// Generators, with their operating points, that are compared with it; one empty name for unchanged scenes.
    #[serde(default, deserialize_with = "one_or_more")]
    pub attack: Vec<String>,
    /// Method; empty where the attack is the method.
    #[serde(default)]
    pub arm: String,
    /// Number of scenes, where it is known.
    #[serde(default)]
    pub n: Option<usize>,
    /// Value, and its deviation over seeds if it is published, by metric.
    pub values: BTreeMap<String, Vec<f64>>,
}

/// The published rows of a study.
///
/// *Errors*: there are none of this name.
pub fn published(name: &str) -> Result<Vec<Published>> {
    let mut all: BTreeMap<String, Vec<Published>> =
        serde_saphyr::from_str(FILE).map_err(foreign).with_context(|| "published.yaml cannot be read")?;
    all.remove(name).with_context(|| format!("there are no published numbers `{name}`"))
}

/// What the published numbers say of an arm less another: the sign of each difference.
pub fn orderings(rows: &[Published], tested: &str, other: &str) -> Vec<Claim> {
    let mut claims = Vec::new();
    for ours in rows.iter().filter(|row| row.arm == tested) {
        let Some(theirs) = rows.iter().find(|row| row.arm == other && row.attack == ours.attack) else {
            continue;
        };
        for (metric, value) in &ours.values {
            let pair = value.first().zip(theirs.values.get(metric).and_then(|value| value.first()));
            if let Some((ours_is, theirs_is)) = pair.filter(|(a, b)| a != b) {
                claims.push(Claim {
                    attack: ours.attack[0].clone(),
                    metric: metric.clone(),
                    larger: ours_is > theirs_is,
                });
            }
        }
    }
    claims
}

fn one_or_more<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum OneOrMore {
        One(String),
        More(Vec<String>),
    }
    Ok(match OneOrMore::deserialize(deserializer)? {
        OneOrMore::One(name) => vec![name],
        OneOrMore::More(names) => names,
    })
}

impl Published {
    /// Whether it is compared with a method.
    pub fn is_of(&self, key: &Key) -> bool {
        (self.arm.is_empty() || self.arm == key.arm) && self.attack.contains(&key.generator_label())
    }

    /// A value as it is shown, in units of the metric; `scale` is that of shares in percent.
    pub fn cell(&self, metric: &str, scale: f64) -> String {
        let text = |x: f64| {
            let scaled = (scale * x * 1e6).round() / 1e6;
            scaled.to_string()
        };
        match self.values.get(metric).map(|value| &value[..]) {
            Some([value]) => format!("*{}*", text(*value)),
            Some([value, deviation, ..]) => format!("*{} ± {}*", text(*value), text(*deviation)),
            _ => String::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_holds_rows_with_values() {
        let rows = published("closed-loop").unwrap();
        assert_eq!(rows.len(), 16);
        let row = rows.iter().find(|row| row.attack == [""] && row.arm == "sage").unwrap();
        assert_eq!(row.cell("completion", 1.0), "*0.77 ± 0.03*".replace("0.03", "0.02"));
        assert_eq!(row.cell("contact", 100.0), "*16 ± 5*");
        assert_eq!(row.cell("at fault", 100.0), "");
        assert!(published("nothing").is_err());
    }

    #[test]
    fn orderings_have_the_sign_of_the_published_numbers() {
        let rows = published("closed-loop").unwrap();
        let all: Vec<(&str, Claim)> = ["none", "cat", "rule"]
            .into_iter()
            .flat_map(|other| orderings(&rows, "sage", other).into_iter().map(move |claim| (other, claim)))
            .collect();
        assert_eq!(all.len(), 48);
        let is_larger = |other: &str, attack: &str, metric: &str| {
            let found = all.iter().find(|(arm, c)| *arm == other && c.attack == attack && c.metric == metric);
            found.unwrap().1.larger
        };
        // The paper's policies that are trained against Rule collide least in unchanged scenes: 0.13, with SAGE 0.16.
        assert!(is_larger("rule", "", "contact") && !is_larger("none", "", "contact"));
        assert!(is_larger("cat", "cat", "contact") && is_larger("rule", "", "completion"));
        assert!(orderings(&rows, "sage", "nobody").is_empty());
    }
}
