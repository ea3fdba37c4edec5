//! Learning curves of several trainings of drivers in one chart, from the files that `sage train-ego` writes.

use std::collections::BTreeMap;

use super::line::{Chart, Line};
use crate::{
    Result,
    context::{Context as _, foreign},
};

/// File with the curves of a training.
pub const CURVES: &str = "curves.csv";
/// Columns that are drawn.
const DRAWN: [&str; 3] = ["completion", "contact", "reward"];

/// Charts as file names and contents: one for each column and kind of scenes, with a line for each training, the mean of its
/// seeds. `trainings` are names and contents of [`CURVES`].
///
/// *Errors*: a file without the columns of curves; those of the drawing library.
pub fn charts(trainings: &[(String, String)]) -> Result<Vec<(String, String)>> {
    let mut drawn: BTreeMap<(usize, String), Vec<Line>> = BTreeMap::new();
    for (name, text) in trainings {
        for (key, points) in curves(text).with_context(|| format!("{CURVES} of the training `{name}`"))? {
            drawn.entry(key).or_default().push((name.clone(), points));
        }
    }
    let chart = |((column, kind), lines): ((usize, String), Vec<Line>)| {
        let column = DRAWN[column];
        let label = format!("{column} in {kind} scenes, mean of seeds");
        let svg = Chart { axes: ["thousand steps", &label], lines, ..Chart::default() }.draw()?;
        Ok((format!("learning-{column}-{kind}.svg"), svg))
    };
    drawn.into_iter().map(chart).collect()
}

/// Points by the number of the column and the kind of scenes.
type Curves = BTreeMap<(usize, String), Vec<[f64; 2]>>;

/// Means over seeds at each step.
fn curves(text: &str) -> Result<Curves> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let heads = reader.headers().map_err(foreign)?.clone();
    let column = |name: &str| {
        heads.iter().position(|head| head == name).with_context(|| format!("there is no column `{name}`"))
    };
    let (step, kind) = (column("step")?, column("scenes")?);
    let mut sums: BTreeMap<(usize, String), BTreeMap<u64, [f64; 2]>> = BTreeMap::new();
    for row in reader.records() {
        let row = row.map_err(foreign)?;
        let at: u64 =
            row[step].parse().map_err(foreign).with_context(|| format!("`{}` is no step", &row[step]))?;
        for (k, name) in DRAWN.iter().enumerate() {
            // A column is empty where nothing was measured.
            let value = row[column(name)?].parse::<f64>().ok().filter(|x| x.is_finite());
            let Some(value) = value else { continue };
            let sum = sums.entry((k, row[kind].to_owned())).or_default().entry(at).or_default();
            *sum = [sum[0] + value, sum[1] + 1.0];
        }
    }
    // Where a seed ends early, a mean of the others would jump.
    let points = |sums: BTreeMap<u64, [f64; 2]>| {
        let most = sums.values().fold(0.0, |most: f64, [_, n]| most.max(*n));
        let whole = sums.into_iter().filter(|(_, [_, n])| *n == most);
        whole.map(|(at, [sum, n])| [at as f64 / 1000.0, sum / n]).collect()
    };
    Ok(sums.into_iter().map(|(key, sums)| (key, points(sums))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "seed,step,scenes,completion,contact,reward\n\
        0,1000,unchanged,0.5,0.2,10\n0,1000,attacked,0.25,,5\n1,1000,unchanged,0.75,0.4,20\n";

    #[test]
    fn seeds_are_averaged_at_each_step() {
        let curves = curves(TEXT).unwrap();
        assert_eq!(curves[&(0, "unchanged".to_owned())], [[1.0, 0.625]]);
        assert_eq!(curves[&(0, "attacked".to_owned())], [[1.0, 0.25]]);
        assert!(!curves.contains_key(&(1, "attacked".to_owned())));
        let files = charts(&[("a".to_owned(), TEXT.to_owned())]).unwrap();
        assert_eq!(files[0].0, "learning-completion-attacked.svg");
        assert_eq!(files.len(), 5);
        assert!(charts(&[("a".to_owned(), "seed,step\n".to_owned())]).is_err());
    }
}
