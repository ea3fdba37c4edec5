//! A metric: a column of the tables of benchmarks.

use sage_core::metric::{MeasuredTrajectory, Metric};

/// The largest speed of the adversary, averaged over scenes.
pub fn top_speed() -> Metric<MeasuredTrajectory> {
    let top_speed = Metric::mean("top speed", |t: &MeasuredTrajectory| {
        t.candidate.profile().speed.iter().copied().reduce(f64::max)
    });
    top_speed.unit("m/s").about("largest speed of the trajectory")
}
