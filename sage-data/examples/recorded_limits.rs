//! How recorded vehicles drive: the distributions from which the limits of feasible and believable plans are taken.
//!
//! Every vehicle that is valid at *now* and for two seconds more, and moves by at least 2 m, is measured over its recording
//! after *now* as if it were a plan.
//!
//! ```sh
//! cargo run --release -p sage-data --example recorded_limits -- scenes/*.pkl
//! ```

#![allow(clippy::print_stdout, clippy::print_stderr)] // A program.

use std::{path::Path, sync::Arc};

use sage_core::{
    geometry::{distance, norm},
    motion::{HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions, against_lanes, dynamics, turning},
    scene::{Scene, SceneIndex, Track, TrackKind},
};
use sage_data::{ReadOptions, Recording};

/// Frames after *now* that a vehicle needs.
const FEWEST: usize = 20;
/// Least distance that it moves, metres.
const MOVES: f64 = 2.0;

/// A limit that everything exceeds.
const ANY: f64 = 1e-9;

/// What is measured of a recorded vehicle.
struct Vehicle {
    name: String,
    length: f64,
    /// Speed *now*, m/s.
    speed: f64,
    /// Largest turn per metre relative to the limit of its length, and lateral acceleration, m/s².
    turn: f64,
    lateral: f64,
    /// Time across the lanes, seconds.
    across: f64,
    /// Whether it is on a lane *now*.
    on_lane: bool,
    has_turned: bool,
    u_turn: bool,
    wrong_lane: bool,
    /// Acceleration, braking, m/s², and speed relative to the limit of the lane.
    dynamics: [f64; 3],
}

/// Whether a vehicle is in a group.
type IsIn = fn(&Vehicle) -> bool;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut all = Vec::new();
    let mut scenes = 0;
    for file in std::env::args().skip(1) {
        let scene = Recording::read_as(Path::new(&file), &ReadOptions::default())?.scene;
        let index = SceneIndex::new(scene.map.clone());
        scenes += 1;
        for track in &scene.tracks {
            if let Some(vehicle) = measured(&scene, &index, track)? {
                all.push(vehicle);
            }
        }
    }
    println!("{} moving vehicles of {scenes} scenes", all.len());
    let groups: [(&str, IsIn); 9] = [
        ("all", |_| true),
        ("up to 6 m long", |v| v.length <= 6.0),
        ("longer", |v| v.length > 6.0),
        ("now below 0.5 m/s", |v| v.speed < 0.5),
        ("0.5 to 2 m/s", |v| (0.5..2.0).contains(&v.speed)),
        ("2 to 5 m/s", |v| (2.0..5.0).contains(&v.speed)),
        ("5 to 10 m/s", |v| (5.0..10.0).contains(&v.speed)),
        ("faster", |v| v.speed >= 10.0),
        ("now along a lane", |v| v.on_lane),
    ];
    println!("share beyond a limit, % [95 % interval]");
    println!(
        "{:20} {:>5} {:>18} {:>18} {:>18} {:>18} {:>18}",
        "", "N", "turn", "lateral", "across > 2.5 s", "U-turn, no lane", "wrong lane"
    );
    for (name, is_in) in groups {
        let group: Vec<&Vehicle> = all.iter().filter(|vehicle| is_in(vehicle)).collect();
        let share =
            |of: &dyn Fn(&Vehicle) -> bool| wilson(group.iter().filter(|v| of(v)).count(), group.len());
        println!(
            "{name:20} {:5} {:>18} {:>18} {:>18} {:>18} {:>18}",
            group.len(),
            share(&|v| v.turn > turning::TURN),
            share(&|v| v.lateral > turning::LATERAL),
            share(&|v| v.across > 2.5),
            share(&|v| v.u_turn),
            share(&|v| v.wrong_lane)
        );
    }
    let quantiles = |name: &str, of: fn(&Vehicle) -> f64| {
        let mut values: Vec<f64> = all.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values.get(((values.len() as f64 * share) as usize).min(values.len() - 1));
        let shown: Vec<String> = [0.5, 0.9, 0.95, 0.98, 0.99, 1.0]
            .iter()
            .filter_map(|share| Some(format!("{:.0} %: {:.2}", 100.0 * share, at(*share)?)))
            .collect();
        println!("{name}: {}", shown.join(", "));
    };
    quantiles("turn per metre, of a car of 6 m, rad/m", |v| v.turn);
    quantiles("lateral acceleration, m/s²", |v| v.lateral);
    quantiles("acceleration over half a second, m/s²", |v| v.dynamics[0]);
    quantiles("braking over half a second, m/s²", |v| v.dynamics[1]);
    quantiles("speed relative to the limit of the lane", |v| v.dynamics[2]);
    let limits = [dynamics::ACCELERATION, dynamics::BRAKING, dynamics::SPEEDING];
    for (k, name) in ["acceleration", "braking", "speeding"].into_iter().enumerate() {
        let count = all.iter().filter(|v| v.dynamics[k] > limits[k]).count();
        println!("{name}, beyond {}: {} %", limits[k], wilson(count, all.len()));
    }
    let breaks = |v: &&Vehicle| v.lateral > turning::LATERAL || (0..3).any(|k| v.dynamics[k] > limits[k]);
    println!("any of these, or lateral: {} %", wilson(all.iter().filter(breaks).count(), all.len()));
    quantiles("time across the lanes, s", |v| v.across);
    println!("turned by more than 135°: {}", all.iter().filter(|v| v.has_turned).count());
    let mut odd: Vec<&Vehicle> =
        all.iter().filter(|v| v.turn > turning::TURN || v.u_turn || v.wrong_lane).collect();
    odd.sort_by(|a, b| b.turn.total_cmp(&a.turn));
    for v in odd {
        println!(
            "{}: turn {:.3}, lateral {:.1}, across {:.1}, U-turn {}, wrong lane {}",
            v.name, v.turn, v.lateral, v.across, v.u_turn, v.wrong_lane
        );
    }
    Ok(())
}

fn measured(
    scene: &Scene,
    index: &Arc<SceneIndex>,
    track: &Track,
) -> Result<Option<Vehicle>, Box<dyn std::error::Error>> {
    let last = (NOW..scene.frames.min(NOW + HORIZON + 1)).take_while(|frame| track.is_valid(*frame)).last();
    let Some(last) = last.filter(|last| track.kind == TrackKind::Vehicle && last - NOW >= FEWEST) else {
        return Ok(None);
    };
    let moved = (NOW..=last).map(|frame| distance(track.point(frame), track.point(NOW))).fold(0.0, f64::max);
    if moved < MOVES {
        return Ok(None);
    }
    // After the last valid frame it stands.
    let points = (1..=HORIZON).map(|step| track.point((NOW + step).min(last))).collect();
    let ego = scene.tracks.iter().find(|other| other.id != track.id && other.is_valid(NOW));
    let Some(ego) = ego else { return Ok(None) };
    let scene = Arc::new(scene.clone().with_roles(Some(&ego.id), Some(&track.id))?);
    let Ok(ctx) = Context::new(&scene, index, &ContextOptions::default()) else { return Ok(None) };
    let candidate = ctx.candidate(Trajectory::new("recording", points)?);
    // For the dynamics it goes on as in its last half second: standing would be braking.
    let [end, before] = [last, last - 5].map(|frame| track.point(frame));
    let on = |step: usize| {
        let more = (NOW + step).saturating_sub(last) as f64 / 5.0;
        let p = track.point((NOW + step).min(last));
        [p[0] + more * (end[0] - before[0]), p[1] + more * (end[1] - before[1])]
    };
    let goes_on = ctx.candidate(Trajectory::new("recording", (1..=HORIZON).map(on).collect())?);
    let beyond = |turn: Option<turning::Excess>| turn.map_or(0.0, |turn| turn.value);
    let tight = turning::tight_turn(&candidate, ANY);
    let start = candidate.box_now().axis;
    let turned = candidate
        .profile()
        .axis
        .iter()
        .any(|axis| axis[0] * start[0] + axis[1] * start[1] < -std::f64::consts::FRAC_1_SQRT_2);
    Ok(Some(Vehicle {
        name: format!("{} {}", scene.id, track.id),
        length: track.size[NOW][0],
        speed: norm(track.velocity[NOW]),
        // Relative to its own limit, as that of a car of 6 m.
        turn: tight.map_or(0.0, |turn| turn.value / turn.limit * ANY),
        lateral: beyond(turning::fast_turn(&candidate, ANY)),
        across: against_lanes::across_lanes(&candidate, &ctx, candidate.steps()),
        on_lane: against_lanes::across_lanes(&candidate, &ctx, 1..=1) == 0.0,
        has_turned: turned,
        u_turn: against_lanes::u_turn(&candidate, &ctx, candidate.steps()).is_some(),
        wrong_lane: against_lanes::turn_from_wrong_lane(&candidate, &ctx).is_some(),
        dynamics: [
            beyond(dynamics::hard_acceleration(&goes_on, &ctx, ANY)),
            beyond(dynamics::hard_braking(&goes_on, &ctx, ANY)),
            beyond(dynamics::speeding(&candidate, &ctx, ANY)),
        ],
    }))
}

/// A share with its Wilson interval, percent.
fn wilson(count: usize, of: usize) -> String {
    let (n, z) = (of.max(1) as f64, 1.96);
    let p = count as f64 / n;
    let center = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    format!("{:.1} [{:.1}, {:.1}]", 100.0 * p, 100.0 * (center - half).max(0.0), 100.0 * (center + half))
}
