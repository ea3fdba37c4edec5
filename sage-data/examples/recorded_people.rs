//! How recorded pedestrians and cyclists move: the distributions from which limits of feasible and believable motion are taken.
//!
//! Each is measured over its longest run of valid frames, if that lasts 2 s. Velocities are differences of positions, since the
//! recorded ones of people are noisier.
//!
//! ```sh
//! cargo run --release -p sage-data --example recorded_people -- scenes/
//! ```

#![allow(clippy::print_stdout)] // A program.

use std::{ops::Range, path::Path};

use sage_core::{
    geometry::{Point, norm, sub, wrap_angle},
    motion::DT,
    scene::{Track, TrackKind},
};
use sage_data::{ReadOptions, Recording, folder};

/// Frame intervals that a run needs.
const FEWEST: usize = 20;
/// Frame intervals of a speed: half a second averages most of the noise of positions.
const HALF: usize = 5;
/// Frame intervals between speeds or directions that are compared: a second, so their difference is the change per second.
const SECOND: usize = 10;
/// Speed below which a person stands, beyond which it has started, and beyond which its direction of motion is known, m/s.
const STANDS: f64 = 0.3;
const STARTED: f64 = 0.8;
const DIRECTED: f64 = 0.5;
/// Change of the step from frame to frame that only an error of the tracker makes, metres: 50 m/s².
const JUMP: f64 = 0.5;

/// What is measured of a recorded pedestrian or cyclist.
struct Person {
    kind: TrackKind,
    /// Length, width and height, metres.
    size: [f64; 3],
    /// Whether the recording has a jump of the tracker.
    jumps: bool,
    /// Speed, m/s, and direction, radians, of the half second after each frame.
    speeds: Vec<f64>,
    directions: Vec<f64>,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut people, mut scenes) = (Vec::new(), 0);
    for argument in std::env::args().skip(1) {
        for file in folder::scene_files(Path::new(&argument))? {
            let scene = Recording::read_as(&file, &ReadOptions::default())?.scene;
            let is_person = |t: &&Track| matches!(t.kind, TrackKind::Pedestrian | TrackKind::Cyclist);
            people.extend(scene.tracks.iter().filter(is_person).filter_map(Person::of));
            scenes += 1;
        }
    }
    println!("{} pedestrians and cyclists of {scenes} scenes, valid for 2 s", people.len());
    for (name, kind) in [("pedestrians", TrackKind::Pedestrian), ("cyclists", TrackKind::Cyclist)] {
        let mut group: Vec<&Person> = people.iter().filter(|person| person.kind == kind).collect();
        print_group(name, &group);
        // A few jumps make up the highest quantiles.
        group.retain(|person| !person.jumps);
        print_group(&format!("{name} without jumps"), &group);
    }
    Ok(())
}

impl Person {
    fn of(track: &Track) -> Option<Self> {
        let run = Some(longest_run(&track.valid)).filter(|run| run.len() > FEWEST)?;
        let size = track.size[run.start];
        let points: Vec<Point> = run.map(|frame| track.point(frame)).collect();
        let motions: Vec<Point> = points.windows(HALF + 1).map(|w| sub(w[HALF], w[0])).collect();
        Some(Self {
            kind: track.kind.clone(),
            size,
            jumps: points.windows(3).any(|w| norm(sub(sub(w[2], w[1]), sub(w[1], w[0]))) > JUMP),
            speeds: motions.iter().map(|motion| norm(*motion) / (HALF as f64 * DT)).collect(),
            directions: motions.iter().map(|[x, y]| y.atan2(*x)).collect(),
        })
    }

    fn largest_speed(&self) -> f64 {
        self.speeds.iter().copied().fold(0.0, f64::max)
    }

    /// Acceleration over the first second of each start: from the last time that it stands.
    fn starts(&self) -> Vec<f64> {
        let (mut starts, mut stood) = (Vec::new(), None);
        for (frame, &speed) in self.speeds.iter().enumerate() {
            if speed < STANDS {
                stood = Some((frame, speed));
            } else if let Some((start, slow)) = stood.take_if(|_| speed > STARTED) {
                starts.extend(self.speeds.get(start + SECOND).map(|fast| fast - slow));
            }
        }
        starts
    }

    /// Turn rate, rad/s, and lateral acceleration, m/s², of each second in which it always moves.
    fn turns(&self) -> Vec<[f64; 2]> {
        let pairs = self.speeds.windows(SECOND + 1).zip(self.directions.windows(SECOND + 1));
        let moving = pairs.filter(|(v, _)| v.iter().all(|speed| *speed > DIRECTED));
        let rates = moving.map(|(v, angle)| (v, wrap_angle(angle[SECOND] - angle[0]).abs()));
        rates.map(|(v, rate)| [rate, rate * 0.5 * (v[0] + v[SECOND])]).collect()
    }
}

fn print_group(name: &str, group: &[&Person]) {
    let moving: Vec<&Person> = group.iter().copied().filter(|p| p.largest_speed() >= STANDS).collect();
    let stand = 100.0 * (group.len() - moving.len()) as f64 / group.len().max(1) as f64;
    let [length, width] = [0, 1].map(|k| quantiles(group.iter().map(|p| p.size[k]).collect())[0]);
    println!("\n{name}: {}, {stand:.1} % stand, median {length:.2} m × {width:.2} m", group.len());
    println!("{:32} {:>7} {:>7} {:>7} {:>7} {:>7}", "moving", "N", "50 %", "95 %", "99 %", "99.9 %");
    let row = |name: &str, of: &dyn Fn(&Person) -> Vec<f64>| {
        let values: Vec<f64> = moving.iter().flat_map(|p| of(p)).collect();
        let (n, [q50, q95, q99, q999]) = (values.len(), quantiles(values));
        println!("{name:32} {n:7} {q50:7.2} {q95:7.2} {q99:7.2} {q999:7.2}");
    };
    let changes = |p: &Person, sign: f64| -> Vec<f64> {
        p.speeds.windows(SECOND + 1).map(|w| sign * (w[SECOND] - w[0])).filter(|a| *a > 0.0).collect()
    };
    row("speed, m/s", &|p| p.speeds.clone());
    row("speed while not standing, m/s", &|p| p.speeds.iter().copied().filter(|v| *v >= STANDS).collect());
    row("largest speed of each, m/s", &|p| vec![p.largest_speed()]);
    row("acceleration, m/s²", &|p| changes(p, 1.0));
    row("deceleration, m/s²", &|p| changes(p, -1.0));
    row("acceleration of a start, m/s²", &|p| p.starts());
    row("turn rate, rad/s", &|p| p.turns().iter().map(|turn| turn[0]).collect());
    row("lateral acceleration, m/s²", &|p| p.turns().iter().map(|turn| turn[1]).collect());
}

/// The first of the longest runs of valid frames.
fn longest_run(valid: &[bool]) -> Range<usize> {
    let (mut longest, mut start) = (0..0, 0);
    for run in valid.split(|valid| !valid) {
        if run.len() > longest.len() {
            longest = start..start + run.len();
        }
        start += run.len() + 1;
    }
    longest
}

/// The values at 50, 95, 99 and 99.9 % of the sorted ones; NaN if there are none.
fn quantiles(mut values: Vec<f64>) -> [f64; 4] {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get((values.len() as f64 * share) as usize).copied();
    [0.5, 0.95, 0.99, 0.999].map(|share| at(share).unwrap_or(f64::NAN))
}
