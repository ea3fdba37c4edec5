//! What the times of a file say about its frame rate.
//!
//! A file is at 10 Hz, and left as it is, if the median step of its times is within 5 % of 0.1 s; recorders stray by
//! tens of milliseconds. Rates from 5 to 100 Hz are resampled; slower ones only if the user asks for it. Times in
//! milli-, micro- or nanoseconds are recognised, because no traffic is recorded at such rates.

use std::path::Path;

use sage_core::{
    geometry::{norm, sub},
    motion::{DT, HISTORY},
    scene::{Scene, Track},
};

use super::Repair;
use crate::{Error, ReadOptions};

/// Largest deviation of the median step from 0.1 s at 10 Hz, seconds.
const TEN_HERTZ: f64 = 0.05 * DT;
/// Steps of 100 Hz and 5 Hz, seconds, with a tolerance of 2 %.
const RATES: [f64; 2] = [0.0098, 0.204];
/// Longest step that is resampled on demand, seconds: beyond it nothing is known of the motion between frames.
const LONGEST: f64 = 2.0;
/// A `sample_rate` below this is a period in seconds.
const LEAST_RATE: f64 = 2.0;
/// Fewest different times that say something of the rate.
const FEW_TIMES: usize = 3;
/// Units of times other than seconds.
const UNITS: [(&str, f64); 3] = [("milliseconds", 1e-3), ("microseconds", 1e-6), ("nanoseconds", 1e-9)];
/// Difference between two steps that contradict each other, as a share.
const CONTRADICTION: f64 = 0.05;

/// The frame rate of a recording.
#[derive(Debug, PartialEq)]
pub enum Clock {
    /// 10 Hz, or no word of another rate.
    Ten,
    /// Another rate.
    Other {
        /// Time of each frame, seconds, increasing.
        times: Vec<f64>,
        /// Median step, seconds.
        step: f64,
    },
}

impl Clock {
    /// Median time between two frames, seconds.
    pub(super) fn step(&self) -> f64 {
        match self {
            Self::Ten => DT,
            Self::Other { step, .. } => *step,
        }
    }

    /// Time from one frame to a later one, seconds.
    pub fn between(&self, first: usize, last: usize) -> f64 {
        match self {
            Self::Ten => DT * (last - first) as f64,
            Self::Other { times, .. } => times[last] - times[first],
        }
    }

    /// The rate of a scene from its times, or from `sample_rate` if it has none that say anything. Times in another unit
    /// become seconds. Notes what is odd.
    ///
    /// *Errors*: [`Error::Field`] for times that run backwards, and for rates that are not resampled.
    pub(super) fn of(
        scene: &mut Scene,
        sample_rate: Option<f64>,
        options: &ReadOptions,
        path: &Path,
    ) -> Result<Self, Error> {
        let may_be_slow = options.resample;
        let sample_rate = options.rate.or(sample_rate);
        let period = sample_rate.filter(|rate| rate.is_finite() && *rate > 0.0);
        let period = period.map(|rate| if rate < LEAST_RATE { rate } else { 1.0 / rate });
        let wrong = |field: &str, found: String, expected: String| Error::Field {
            path: path.to_owned(),
            field: format!("metadata/{field}"),
            found,
            expected,
        };
        let mut field = "ts";
        if have_stood_still(scene) {
            let first = scene.timestamps[0];
            scene.timestamps.fill(first);
        }
        let mut step = match median_step(&scene.timestamps) {
            Some(step) if step < 0.0 => {
                let times = &scene.timestamps;
                let k = times.windows(2).position(|w| w[1] < w[0]).map_or(0, |k| k + 1);
                let found = format!("{} at frame {k}, after {}", times[k], times[k.saturating_sub(1)]);
                return Err(wrong("ts", found, "times that increase; these run backwards".to_owned()));
            }
            Some(step) if step > 0.0 => step,
            constant => {
                field = if options.rate.is_some() { "--rate" } else { "sample_rate" };
                let step = period.unwrap_or(DT);
                if constant.is_some() {
                    let text = format!("the times are constant; a frame every {step} s is assumed");
                    scene.notes.push(Repair::FrameRate.note(text));
                    // As files and records hold times: in 32 bits.
                    scene.timestamps =
                        (0..scene.frames).map(|frame| f64::from((frame as f64 * step) as f32)).collect();
                }
                step
            }
        };
        let is_known = |step: f64| (RATES[0]..=RATES[1]).contains(&step);
        if step >= LEAST_RATE
            && field == "ts"
            && let Some((unit, scale)) =
                UNITS.iter().find(|(_, scale)| (RATES[0]..=LONGEST).contains(&(step * scale)))
        {
            let first = scene.timestamps[0];
            scene.timestamps.iter_mut().for_each(|time| *time = (*time - first) * scale);
            step *= scale;
            scene
                .notes
                .push(Repair::FrameRate.note(format!("the times are in {unit}; they are read as such")));
        }
        let contradicts = |period: &f64| (step / period - 1.0).abs() > CONTRADICTION;
        if let Some(rate) = options.rate.filter(|rate| contradicts(&(1.0 / rate))) {
            let found =
                format!("{} Hz, but the file has times, a frame every {} s", rounded(rate), rounded(step));
            let expected = "no --rate: it is for files without times".to_owned();
            return Err(wrong("--rate", found, expected));
        }
        if let Some(period) = period.filter(contradicts) {
            let text = format!(
                "the times have a frame every {step:.4} s, `sample_rate` says {period:.4} s; the times are used"
            );
            scene.notes.push(Repair::FrameRate.note(text));
        }
        if (step - DT).abs() <= TEN_HERTZ || field == "ts" && is_coarse_ten_hertz(&scene.timestamps) {
            return Ok(Self::Ten);
        }
        let is_slow = step > RATES[1] && step <= LONGEST;
        if !(is_known(step) || may_be_slow && is_slow) {
            let hint = implied_step(&scene.tracks)
                .filter(|implied| (implied / step - 1.0).abs() > 0.25)
                .map_or(String::new(), |implied| {
                    format!("; its velocities fit a frame every {implied:.2} s, so its times may be wrong")
                });
            let found = format!("a frame every {} s ({} Hz){hint}", rounded(step), rounded(1.0 / step));
            let expected = if is_slow {
                "5 to 100 Hz; --resample also reads slower recordings, whose motion between frames is a guess"
            } else {
                "5 to 100 Hz"
            };
            return Err(wrong(field, found, expected.to_owned()));
        }
        let times: Vec<f64> = if field == "ts" {
            scene.timestamps.clone()
        } else {
            (0..scene.frames).map(|frame| frame as f64 * step).collect()
        };
        if let Some(k) = times.windows(2).position(|w| w[1] <= w[0]) {
            let found = format!("{} at frame {}, after {}", times[k + 1], k + 1, times[k]);
            return Err(wrong(
                "ts",
                found,
                "times that increase, since they are resampled to 10 Hz".to_owned(),
            ));
        }
        Ok(Self::Other { times, step })
    }
}

/// Whether a clock has only two or three values, none of which is a rate, as seconds since 1970 have in 32 bits, while the
/// motion is that of 10 Hz: it says nothing.
fn have_stood_still(scene: &Scene) -> bool {
    let times = &scene.timestamps;
    let changes = times.windows(2).filter(|w| w[1] != w[0]).count();
    if changes == 0 || changes >= FEW_TIMES || times.len() < HISTORY {
        return false;
    }
    let step = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    let fits = implied_step(&scene.tracks).is_none_or(|implied| (implied / DT - 1.0).abs() <= 0.25);
    fits && !(step - DT).abs().le(&TEN_HERTZ)
}

/// Whether coarse digits hide 10 Hz: the steps are 0.1 s on average, and none is far from it.
fn is_coarse_ten_hertz(times: &[f64]) -> bool {
    let mean = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    (mean / DT - 1.0).abs() < 0.01 && times.windows(2).all(|w| (w[1] - w[0] - DT).abs() < 0.5 * DT)
}

/// A number for a message, without digits that say nothing.
fn rounded(x: f64) -> String {
    let text = format!("{x:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Median of the steps between times; negative if more of them fall than rise; `None` without two times.
fn median_step(times: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    steps.sort_by(f64::total_cmp);
    let falling = steps.iter().filter(|step| **step < 0.0).count();
    let rising = steps.iter().filter(|step| **step > 0.0).count();
    if falling > rising {
        return Some(steps[0]);
    }
    // A clock that stands still now and then has a median of 0, and still says something.
    if rising > 0 && steps[steps.len() / 2] <= 0.0 {
        return Some((times[times.len() - 1] - times[0]) / steps.len() as f64);
    }
    steps.get(steps.len() / 2).copied()
}

/// Speed from which a displacement says how long a frame lasts, m/s.
const FAST: f64 = 2.0;
/// Largest number of pairs of frames that are looked at.
const MOST: usize = 20_000;

/// Median time between frames that the displacements of moving road users have at their velocities, seconds; `None`
/// if nobody moves.
pub fn implied_step(tracks: &[Track]) -> Option<f64> {
    let mut steps = Vec::new();
    for track in tracks {
        for frame in 1..track.valid.len() {
            if !(track.valid[frame] && track.valid[frame - 1]) {
                continue;
            }
            let [a, b] = [frame - 1, frame].map(|f| track.velocity[f]);
            let speed = norm([0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]);
            if speed > FAST {
                steps.push(norm(sub(track.point(frame), track.point(frame - 1))) / speed);
            }
        }
        if steps.len() > MOST {
            break;
        }
    }
    let middle = steps.len() / 2;
    (!steps.is_empty()).then(|| *steps.select_nth_unstable_by(middle, f64::total_cmp).1)
}
