//! Goals: possible positions of the target after 8 s, and their features.
//!
//! Distance along the road is a feature, with lane changes and lights on the route. With these features 340 scenes are enough
//! to learn a prior.

use sage_core::{
    geometry::Point,
    motion::{DT, HORIZON, NOW},
    scene::{Scene, TrackKind},
};

use super::{
    Frame, Routes, Table,
    grid::{CELL, Grid, OnLane},
    wrap,
};

/// Number of features of a goal.
pub const GOAL_COLUMNS: usize = 28;
/// Time to a goal, seconds.
const T: f32 = HORIZON as f32 * DT as f32;
/// Maximum number of goals, those of the least effort first.
const MOST: usize = 4096;
/// Speed limit for the extent of the goals, m/s.
const FASTEST: f64 = 32.0;

/// Indices of the goal columns that other modules read.
#[derive(Clone, Copy, Debug)]
#[repr(usize)]
pub enum GoalColumn {
    /// Constant acceleration to the goal on a straight line, units of 2 m/s².
    StraightAcceleration = 5,
    /// Lateral acceleration on the circle to the goal, units of 4 m/s².
    LateralAcceleration = 10,
    /// 1 on a motor lane.
    OnLane = 11,
    /// Direction of the lane, x.
    LaneCos = 12,
    /// Direction of the lane, y.
    LaneSin = 13,
    /// 1 on a lane that the target can reach.
    Reachable = 16,
    /// Constant acceleration to the goal along the road, units of 2 m/s².
    RouteAcceleration = 18,
    /// Lane changes on the route, units of 2.
    Changes = 19,
    /// Distance left of the lane's middle, units of 2 m.
    LaneOffset = 20,
    /// 1 if a red or yellow light lies on the route.
    RedLight = 21,
    /// Distance beyond its stop line, units of 10 m.
    BeyondStop = 22,
}

/// Columns whose sign changes in the mirrored scene.
pub(super) const SIGNED: &[usize] = &[1, 6, 7, 8, 10, 13, 14, 20];

/// The goals of a target.
pub(super) struct Goals {
    pub(super) points: Vec<[f32; 2]>,
    pub(super) features: Table,
    pub(super) on_lanes: usize,
    pub(super) label: Option<([f32; 2], [f32; GOAL_COLUMNS])>,
}

impl Goals {
    /// Lattice points within reach on motor lanes, and a coarser lattice around the target and straight
    /// ahead. `label` is the recorded end point, if requested; it gets a row too.
    pub(super) fn around(
        scene: &Scene,
        routes: &Routes,
        frame: &Frame,
        velocity: [f32; 2],
        label: Option<[f32; 2]>,
    ) -> Self {
        let speed = f64::from(velocity[0].hypot(velocity[1])).min(FASTEST);
        let reach = Reach::of(speed);
        let mut grid = Grid::new([reach.back, -reach.side], [reach.front, reach.side]);
        grid.mark_lanes(scene, routes, frame);
        let mut cells: Vec<u32> = grid.marked().to_vec();
        cells.retain(|&cell| reach.holds(grid.point(cell as usize)));
        let on_lanes = cells.len();
        cells.extend(reach.off_lanes(&grid, on_lanes == 0));
        cells.sort_unstable();
        cells.dedup();
        let mut lattice: Vec<[i32; 2]> = cells.into_iter().map(|cell| grid.point(cell as usize)).collect();
        if lattice.len() > MOST {
            lattice.sort_by(|a, b| effort(*a, speed).total_cmp(&effort(*b, speed)));
            lattice.truncate(MOST);
            lattice.sort_unstable();
        }
        let describe = Describe {
            scene,
            routes,
            grid: &grid,
            speed: speed as f32,
            leader: leader(scene, routes, &grid, frame),
        };
        let mut features =
            Table { columns: GOAL_COLUMNS, values: Vec::with_capacity(lattice.len() * GOAL_COLUMNS) };
        for point in &lattice {
            let position = point.map(|k| k as f32 * CELL as f32);
            features.values.extend_from_slice(&describe.row(position, grid.index(*point)));
        }
        let label = label.map(|end| {
            let [i, j] = end.map(|x| (f64::from(x) / CELL).round() as i32);
            (end, describe.row(end, grid.index([i, j])))
        });
        let points = lattice.iter().map(|p| p.map(|x| x as f32 * CELL as f32)).collect();
        Self { points, features, on_lanes, label }
    }
}

/// Region that a vehicle can reach in 8 s, target frame, metres.
struct Reach {
    back: f64,
    front: f64,
    side: f64,
    /// Distance at the present speed.
    straight: f64,
}

impl Reach {
    fn of(speed: f64) -> Self {
        let straight = 8.0 * speed;
        // The future of slow vehicles varies more. These bounds contain 99 % of recorded vehicles.
        let slow = (1.0 - speed / 6.0).max(0.0);
        Self {
            back: -16.0 - 20.0 * slow,
            front: straight + 64.0 + 14.0 * slow,
            side: (straight + 60.0).min(96.0 - 7.0 * (speed - 10.0).clamp(0.0, 8.0)),
            straight,
        }
    }

    fn holds(&self, [i, j]: [i32; 2]) -> bool {
        let [x, y] = [f64::from(i) * CELL, f64::from(j) * CELL];
        x.hypot(y) <= self.front && x >= self.back && y.abs() <= self.side
    }

    /// Lattice points off the lanes that are goals too, because a vehicle may leave the mapped road.
    fn off_lanes(&self, grid: &Grid, without_lanes: bool) -> Vec<u32> {
        let mut cells = Vec::new();
        let [cols, rows] = [self.front, self.side].map(|x| (x / CELL) as i32);
        for i in (self.back / CELL) as i32..=cols {
            for j in -rows..=rows {
                let [x, y] = [f64::from(i) * CELL, f64::from(j) * CELL];
                let squared = x * x + y * y;
                let coarse = i % 2 == 0 && j % 2 == 0;
                let around = squared <= 6.0 * 6.0 || (coarse && squared <= 28.0 * 28.0 && x >= -8.0);
                let along = coarse && y.abs() <= 4.0 && x > 0.0 && x <= 1.25 * self.straight + 8.0;
                let wedge = without_lanes && coarse && x >= 0.0 && y.abs() <= 0.5 * x + 4.0;
                if (around || along || wedge) && self.holds([i, j]) {
                    cells.extend(grid.index([i, j]).map(|cell| cell as u32));
                }
            }
        }
        cells
    }
}

/// Effort to reach a goal: a measure for comparison only.
fn effort([i, j]: [i32; 2], speed: f64) -> f64 {
    let [x, y] = [f64::from(i) * CELL, f64::from(j) * CELL];
    (x.hypot(y) - 8.0 * speed).abs() + 2.0 * y.abs()
}

/// The nearest vehicle ahead on the target's route: distance along the road and speed.
fn leader(scene: &Scene, routes: &Routes, grid: &Grid, frame: &Frame) -> Option<[f32; 2]> {
    let vehicles = scene.tracks.iter().filter(|t| t.kind == TrackKind::Vehicle && t.is_valid(NOW));
    let ahead = vehicles.filter_map(|track| {
        let position: Point = frame.frame_from_world(track.point(NOW));
        let on = grid.at(position)?;
        let route = routes.reach(on.lane as usize)?;
        let distance = route.distance as f32 + on.along;
        let along = frame.direction_from_world(track.velocity[NOW]).map(|v| v as f32);
        let speed = along[0] * on.direction[0] + along[1] * on.direction[1];
        (route.changes == 0 && distance > 2.0).then_some([distance, speed])
    });
    ahead.min_by(|a, b| a[0].total_cmp(&b[0]))
}

/// Computes the rows of goals.
struct Describe<'a> {
    scene: &'a Scene,
    routes: &'a Routes,
    grid: &'a Grid,
    speed: f32,
    leader: Option<[f32; 2]>,
}

impl Describe<'_> {
    fn row(&self, [x, y]: [f32; 2], cell: Option<usize>) -> [f32; GOAL_COLUMNS] {
        let v = self.speed;
        let straight = v * T;
        let r = x.hypot(y);
        let bearing = y.atan2(x);
        // Curvature of the circle that starts along x and passes through the goal.
        let curvature = 2.0 * y / (r * r + 25.0);
        let mut f = [0.0; GOAL_COLUMNS];
        f[0] = x / 40.0;
        f[1] = y / 40.0;
        f[2] = (x - straight) / 40.0;
        f[3] = r / 40.0;
        f[4] = (r / T - v) / 10.0;
        f[5] = acceleration(r - straight);
        f[6] = bearing;
        f[7] = y / (r + 5.0);
        f[8] = 10.0 * curvature;
        f[9] = v / 10.0;
        f[10] = (v * v * curvature / 4.0).clamp(-4.0, 4.0);
        if let Some(on) = cell.and_then(|cell| self.grid.cell(cell)) {
            self.lane(&mut f, on, bearing);
        }
        // 1 at the present position, for standing vehicles.
        f[27] = (-r / 4.0).exp();
        f
    }

    /// Columns that depend on the goal's lane.
    fn lane(&self, f: &mut [f32; GOAL_COLUMNS], on: &OnLane, bearing: f32) {
        let v = self.speed;
        f[GoalColumn::OnLane as usize] = 1.0;
        f[GoalColumn::LaneCos as usize] = on.direction[0];
        f[GoalColumn::LaneSin as usize] = on.direction[1];
        let turn = wrap(on.direction[1].atan2(on.direction[0]) - 2.0 * bearing);
        f[14] = turn.sin();
        f[15] = turn.cos();
        f[20] = on.offset / 2.0;
        let feature = &self.scene.map.features[on.lane as usize];
        let Some(route) = self.routes.reach(on.lane as usize) else { return };
        let s = route.distance as f32 + on.along;
        if s < -2.0 {
            return;
        }
        f[GoalColumn::Reachable as usize] = 1.0;
        f[17] = ((s - v * T) / 40.0).clamp(-6.0, 6.0);
        f[GoalColumn::RouteAcceleration as usize] = acceleration(s - v * T);
        f[GoalColumn::Changes as usize] = f32::from(route.changes) / 2.0;
        if let Some(stop) = route.stop {
            let stop = stop as f32;
            f[21] = 1.0;
            f[22] = ((s - stop) / 10.0).clamp(-3.0, 3.0);
            f[23] = (v * v / (2.0 * stop.max(1.0)) / 4.0).min(3.0);
        }
        if let Some([distance, speed]) = self.leader {
            f[24] = 1.0;
            f[25] = ((s - distance - speed.max(0.0) * T) / 20.0).clamp(-4.0, 4.0);
        }
        if let Some(limit) = feature.lane.as_ref().and_then(|lane| lane.speed_limit) {
            f[26] = ((s / T - limit as f32) / 10.0).clamp(-3.0, 3.0);
        }
    }
}

/// Constant acceleration that adds a distance in 8 s, units of 2 m/s², within ±4.
fn acceleration(gained: f32) -> f32 {
    (gained / (T * T)).clamp(-4.0, 4.0)
}
