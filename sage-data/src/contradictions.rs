//! Values of a scene that contradict each other: velocity or heading against positions, jumps, sizes and speeds beyond
//! any road user. A file can be well-formed and mean something else than it says.
//!
//! Each is counted over pairs of valid neighbouring frames, and named with its share and the likely cause.

use sage_core::{
    geometry::{Point, distance, dot, norm, sub, wrap_angle},
    motion::DT,
    scene::{Scene, Track, TrackKind},
};

use crate::{repairs::clock::implied_step, warning::Warning};

/// Speed from which motion has a direction and a velocity can be wrong, m/s.
const MOVING: f64 = 3.0;
/// Difference of velocities that contradicts, m/s, and as a share of the speed.
const VELOCITY: f64 = 2.0;
const VELOCITY_SHARE: f64 = 0.4;
/// Angle between heading and motion that contradicts, radians. Cars drift and trailers swing by less.
const HEADING: f64 = 0.7;
/// Share of a track's moving frames from which it counts as contradictory.
const MOST_FRAMES: f64 = 0.5;
/// Least number of moving frames of a track from which contradictions are looked for.
const LEAST_FRAMES: usize = 10;
/// Fastest road user, m/s: above it a step is a jump.
const FASTEST: f64 = 100.0;
/// Largest sizes of a vehicle and of a person or cyclist, metres: length, width, height.
const VEHICLE: [f64; 3] = [60.0, 6.0, 8.0];
const PERSON: [f64; 3] = [5.0, 3.0, 4.0];
/// Difference between the time of a frame and what the motion says that names a contradiction, as a share.
const TIME: f64 = 0.25;
/// Share of a scene's moving frames, per cent, from which contradictions of bystanders matter.
const IMPORTANT_SHARE: f64 = 10.0;
/// Names of tracks in a warning.
const NAMED: usize = 3;

/// All contradictions of a scene at 10 Hz.
pub(crate) fn find(scene: &Scene) -> Vec<Warning> {
    let motions: Vec<Motion> = scene.tracks.iter().map(Motion::of).collect();
    let time = times(scene);
    let velocity = if time.is_some() { None } else { velocities(scene, &motions) };
    let found = [time, velocity, headings(scene, &motions), jumps(scene), speeds(scene), sizes(scene)];
    found.into_iter().flatten().collect()
}

/// What the moving frames of a track say.
#[derive(Default)]
struct Motion {
    moving: usize,
    /// Frames whose velocity is not that of the positions; the speeds there by the recording and by the positions.
    wrong_velocity: usize,
    recorded_speed: f64,
    true_speed: f64,
    /// Frames whose recorded velocity is along the heading, although the motion is not.
    is_turned: usize,
    /// Frames whose heading is not that of the motion: opposite ones, and those that fit in degrees.
    wrong_heading: usize,
    opposite: usize,
    degrees: usize,
}

impl Motion {
    fn of(track: &Track) -> Self {
        let mut motion = Self::default();
        for frame in 1..track.valid.len() {
            if !(track.valid[frame] && track.valid[frame - 1]) {
                continue;
            }
            let moved = sub(track.point(frame), track.point(frame - 1)).map(|d| d / DT);
            let speed = norm(moved);
            if !(MOVING..=FASTEST).contains(&speed) {
                continue;
            }
            motion.moving += 1;
            let [a, b] = [frame - 1, frame].map(|f| track.velocity[f]);
            let recorded: Point = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
            if norm(sub(recorded, moved)) > VELOCITY.max(VELOCITY_SHARE * speed) {
                motion.wrong_velocity += 1;
                motion.recorded_speed += norm(recorded);
                motion.true_speed += speed;
                let is_as_fast = (norm(recorded) / speed - 1.0).abs() < VELOCITY_SHARE;
                motion.is_turned +=
                    usize::from(is_as_fast && dot(recorded, moved) < 0.9 * speed * norm(recorded));
            }
            let direction = moved[1].atan2(moved[0]);
            let off = |heading: f64| wrap_angle(heading - direction).abs();
            let heading = track.heading[frame];
            if off(heading) > HEADING {
                motion.wrong_heading += 1;
                motion.opposite += usize::from(off(heading) > std::f64::consts::PI - HEADING);
                motion.degrees +=
                    usize::from(heading.abs() > 7.0 && off(heading.to_radians()) < 0.5 * HEADING);
            }
        }
        motion
    }

    fn is_mostly(&self, count: usize) -> bool {
        self.moving >= LEAST_FRAMES && count as f64 > MOST_FRAMES * self.moving as f64
    }
}

/// Whether the displacements fit the velocities at another duration of a frame.
fn times(scene: &Scene) -> Option<Warning> {
    let implied = implied_step(&scene.tracks)?;
    let detail = || {
        format!(
            "positions move as far in a frame as the velocities do in {implied:.3} s, but a frame lasts {DT} s; likely \
             cause: the times or `sample_rate` of the file are wrong, or velocities are not in m/s; a file without times, \
             such as JSON of GPUDrive, is read at that rate with --rate {:.0}",
            1.0 / implied
        )
    };
    // Velocities of 0 say nothing.
    ((implied / DT - 1.0).abs() > TIME && implied > 0.0)
        .then(|| Warning::new("times-against-motion", detail()))
}

fn velocities(scene: &Scene, motions: &[Motion]) -> Option<Warning> {
    let wrong = contradictory(scene, motions, |motion| motion.wrong_velocity)?;
    let sum = |of: fn(&Motion) -> f64| wrong.motions().map(of).sum::<f64>();
    let (recorded, real) = (sum(|m| m.recorded_speed), sum(|m| m.true_speed));
    let turned = wrong.motions().map(|m| m.is_turned).sum::<usize>();
    let cause = match recorded / real.max(1e-9) {
        ratio if ratio < 0.05 => "they are 0".to_owned(),
        _ if 2 * turned > wrong.frames => "they point elsewhere, such as in the frame of the car".to_owned(),
        ratio => format!("they are {ratio:.2} times the motion"),
    };
    let trust = "`--trust positions` recomputes them";
    Some(wrong.warning("velocity-against-positions", "velocities", &format!("{cause}; {trust}")))
}

fn headings(scene: &Scene, motions: &[Motion]) -> Option<Warning> {
    // Bicycles and people may face anywhere.
    let of_vehicles: Vec<Motion> = motions
        .iter()
        .zip(&scene.tracks)
        .map(|(motion, track)| match track.kind {
            TrackKind::Vehicle => Motion { ..*motion },
            _ => Motion::default(),
        })
        .collect();
    let wrong = contradictory(scene, &of_vehicles, |motion| motion.wrong_heading)?;
    let count = |of: fn(&Motion) -> usize| wrong.motions().map(of).sum::<usize>();
    let cause = match wrong.frames {
        frames if 2 * count(|m| m.degrees) > frames => "they are in degrees",
        frames if 2 * count(|m| m.opposite) > frames => "they point backwards",
        _ => "another zero or direction of turning",
    };
    let trust = "`--trust positions` recomputes them";
    Some(wrong.warning("heading-against-positions", "headings", &format!("{cause}; {trust}")))
}

/// Tracks most of whose moving frames are wrong.
struct Contradictory<'m> {
    tracks: Vec<(&'m str, &'m Motion)>,
    frames: usize,
    /// Moving frames of all tracks.
    all: usize,
    /// Whether one of them is the ego or the adversary.
    has_role: bool,
}

impl<'m> Contradictory<'m> {
    fn motions(&self) -> impl Iterator<Item = &'m Motion> {
        self.tracks.iter().map(|(_, motion)| *motion)
    }

    fn warning(&self, kind: &'static str, what: &str, cause: &str) -> Warning {
        let names: Vec<String> =
            self.tracks.iter().take(NAMED).map(|(id, _)| format!("`{}`", id.escape_debug())).collect();
        let more = self.tracks.len().saturating_sub(NAMED);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        let share = 100.0 * self.frames as f64 / self.all.max(1) as f64;
        let detail = format!(
            "{what} contradict positions in {share:.0} % of the moving frames (tracks {}{more}); likely cause: {cause}",
            names.join(", ")
        );
        // One of many bystanders may well drive backwards, or be a false track.
        let is_important = self.has_role || share >= IMPORTANT_SHARE;
        Warning { is_important, ..Warning::new(kind, detail) }
    }
}

fn contradictory<'m>(
    scene: &'m Scene,
    motions: &'m [Motion],
    wrong: fn(&Motion) -> usize,
) -> Option<Contradictory<'m>> {
    let pairs = scene.tracks.iter().zip(motions);
    let found: Vec<(usize, (&Track, &Motion))> =
        pairs.enumerate().filter(|(_, (_, motion))| motion.is_mostly(wrong(motion))).collect();
    let has_role = found.iter().any(|(k, _)| *k == scene.ego || Some(*k) == scene.adversary);
    let tracks: Vec<(&str, &Motion)> =
        found.into_iter().map(|(_, (track, motion))| (&track.id[..], motion)).collect();
    let frames = tracks.iter().map(|(_, motion)| wrong(motion)).sum();
    let all = motions.iter().map(|motion| motion.moving).sum();
    (!tracks.is_empty()).then_some(Contradictory { tracks, frames, all, has_role })
}

/// Steps between neighbouring valid frames that no road user makes.
fn jumps(scene: &Scene) -> Option<Warning> {
    let (mut count, mut tracks, mut first) = (0, 0, None);
    for track in &scene.tracks {
        let is_jump = |frame: &usize| {
            track.valid[*frame]
                && track.valid[frame - 1]
                && distance(track.point(*frame), track.point(frame - 1)) > FASTEST * DT
        };
        let jumps = (1..track.valid.len()).filter(is_jump).count();
        if jumps > 0 {
            let frame = (1..track.valid.len()).find(is_jump).unwrap_or_default();
            first.get_or_insert_with(|| (track.id.clone(), frame));
            tracks += 1;
            count += jumps;
        }
    }
    let (id, frame) = first?;
    let detail = format!(
        "{count} steps of {tracks} tracks are longer than {:.0} m, the first of `{}` at frame {frame}; likely cause: an id \
         that was given to another road user, or padding that counts as valid",
        FASTEST * DT,
        id.escape_debug()
    );
    Some(Warning::new("jumps", detail))
}

fn speeds(scene: &Scene) -> Option<Warning> {
    let is_too_fast = |track: &&Track| {
        (0..track.valid.len()).any(|frame| track.valid[frame] && norm(track.velocity[frame]) > FASTEST)
    };
    let count = scene.tracks.iter().filter(is_too_fast).count();
    let detail = || format!("{count} tracks have velocities above {FASTEST:.0} m/s");
    (count > 0).then(|| Warning::new("speed-beyond-vehicles", detail()))
}

fn sizes(scene: &Scene) -> Option<Warning> {
    let is_too_large = |track: &Track| {
        let most = match track.kind {
            TrackKind::Vehicle => VEHICLE,
            TrackKind::Pedestrian | TrackKind::Cyclist => PERSON,
            TrackKind::Other(_) => return None,
        };
        let is_larger = |size: &[f64; 3]| size.iter().zip(most).any(|(x, most)| *x > most);
        (0..track.valid.len()).find(|frame| track.valid[*frame] && is_larger(&track.size[*frame]))
    };
    let large: Vec<(&Track, usize)> =
        scene.tracks.iter().filter_map(|track| Some((track, is_too_large(track)?))).collect();
    let (first, frame) = *large.first()?;
    let [length, width, height] = first.size[frame];
    let detail = format!(
        "{} tracks are larger than any {}, the first `{}` with {length:.1} × {width:.1} × {height:.1} m",
        large.len(),
        if first.kind == TrackKind::Vehicle { "vehicle" } else { "person" },
        first.id.escape_debug()
    );
    Some(Warning::new("size-beyond-vehicles", detail))
}
