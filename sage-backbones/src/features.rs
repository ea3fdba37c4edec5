//! Input of the networks: the surroundings of one target agent, and its goals.
//!
//! Everything is in the target's frame: origin at its centre *now*, x along its heading. Lengths are scaled
//! so that most numbers lie within ±3.

mod acceleration_profile;
mod agent_forecasts;
mod agents;
pub mod cat;
mod edges;
mod frame;
mod goals;
mod grid;
mod map;
mod routes;

use std::{f32::consts::PI, sync::Arc};

use sage_core::{generator::Observation, geometry::Point, motion::NOW, scene::Scene};

use crate::{Error, nn::Groups};

pub use agent_forecasts::{AgentForecasts, EgoForecast, FORECAST_STEPS, ForecastMode, STRIDE};
pub use edges::{EdgeGrid, EdgeKinds};
pub use frame::Frame;
pub use goals::{GOAL_COLUMNS, GoalColumn};
pub use grid::{CELL, LANE_REACH};
pub use routes::Routes;

/// Speeds in files are clipped to this value, m/s. No road vehicle is faster.
const FASTEST: f64 = 80.0;

/// Columns of a row that describes one segment of an agent's history or of a map polyline.
pub const VECTOR_COLUMNS: usize = 32;

/// A table of numbers with rows of equal width.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Numbers per row.
    pub columns: usize,
    /// All rows, one after the other.
    pub values: Vec<f32>,
}

impl Table {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.values.len().checked_div(self.columns).unwrap_or(0)
    }

    /// One row.
    pub fn row(&self, row: usize) -> &[f32] {
        &self.values[row * self.columns..(row + 1) * self.columns]
    }
}

/// Format of the feature rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Our format: goals on a lattice along the lanes, described by [`GOAL_COLUMNS`] numbers.
    Lattice,
    /// The format of the published network.
    Published,
}

/// Network inputs for one target agent.
///
/// ```
/// use sage_backbones::features::{EdgeKinds, Features};
/// use sage_core::{generator::Observation, motion::NOW, scene::SceneIndex};
/// use sage_data::procedural::{Kind, generate};
///
/// let scene = generate(Kind::FourWay, 1, 0).ok_or("no scene for this seed")?;
/// let now = Observation::of(&scene, &SceneIndex::new(scene.map.clone()))?;
/// let features = Features::of(&now, scene.adversary_index()?, None, EdgeKinds::default())?;
/// // Everything is relative to the target: its own position is the origin.
/// let own = features.frame.frame_from_world(scene.adversary()?.point(NOW));
/// assert!(own[0].abs() < 1e-9 && own[1].abs() < 1e-9);
/// // A row of numbers for each goal that it could reach in 8 s.
/// assert_eq!(features.goal_features.rows(), features.modes());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Features {
    /// Format of the rows.
    pub layout: Layout,
    /// The target's frame.
    pub frame: Frame,
    /// The target's velocity *now* in its frame, m/s.
    pub velocity: [f32; 2],
    /// Rows of [`VECTOR_COLUMNS`] (or the published 128): segments of the agents' histories, then of the map.
    pub vectors: Table,
    /// Rows of each agent and of each map polyline: the target, the other agents, then the map.
    pub groups: Groups,
    /// Number of groups that are agents.
    pub agents: usize,
    /// Goals: possible positions of the target after 8 s, metres, target frame.
    pub goals: Vec<[f32; 2]>,
    /// One row per goal: [`GOAL_COLUMNS`] numbers, or its two coordinates for the published network.
    pub goal_features: Table,
    /// Half of the target's length and width, metres.
    pub half: [f32; 2],
    /// Forecasts of all other agents.
    pub agent_forecasts: AgentForecasts,
    /// Edges around the target.
    pub edges: Arc<EdgeGrid>,
    /// The kinds of these edges.
    pub edge_kinds: EdgeKinds,
    /// Whether there are goals on lanes. Without them, all goals lie on a grid.
    pub has_lanes: bool,
    /// Recorded end point of the target after 8 s with its goal row, if requested. Only the training loss
    /// uses it.
    pub label: Option<([f32; 2], Table)>,
}

impl Features {
    /// Features of one agent. `ego` replaces the forecast of the ego along its lane.
    ///
    /// *Errors*: [`Error::Core`] if the agent does not exist or is not valid *now*.
    pub fn of(
        now: &Observation,
        target: usize,
        ego: Option<&EgoForecast>,
        edges: EdgeKinds,
    ) -> Result<Self, Error> {
        Self::new(now, target, ego, edges, None)
    }

    /// As [`Features::of`], with a goal row for the agent's recorded end point after 8 s (world frame).
    ///
    /// *Errors*: as [`Features::of`].
    pub fn with_label(now: &Observation, target: usize, edges: EdgeKinds, end: Point) -> Result<Self, Error> {
        Self::new(now, target, None, edges, Some(end))
    }

    fn new(
        now: &Observation,
        target: usize,
        ego: Option<&EgoForecast>,
        edge_kinds: EdgeKinds,
        end: Option<Point>,
    ) -> Result<Self, Error> {
        let (scene, index) = (&**now.scene(), &**now.index());
        let (frame, velocity) = target_frame(scene, target)?;
        let routes = Routes::from(scene, index, scene.tracks[target].point(NOW), frame.heading());
        let mut vectors =
            Table { columns: VECTOR_COLUMNS, values: Vec::with_capacity(1024 * VECTOR_COLUMNS) };
        let mut lengths = Vec::with_capacity(160);
        agents::append(scene, target, &frame, &mut vectors, &mut lengths);
        let agents = lengths.len();
        map::append(scene, index, &routes, &frame, velocity[0], &mut vectors, &mut lengths);
        let end = end.map(|end| frame.frame_from_world(end).map(|x| x as f32));
        let goals = goals::Goals::around(scene, &routes, &frame, velocity, end);
        let [length, width, _] = scene.tracks[target].size[NOW];
        let half = [length, width].map(|size| (0.5 * size) as f32);
        Ok(Self {
            layout: Layout::Lattice,
            frame,
            velocity,
            vectors,
            groups: Groups::of_lengths(lengths),
            agents,
            goals: goals.points,
            goal_features: goals.features,
            half,
            agent_forecasts: AgentForecasts::of(scene, index, target, &frame, ego),
            // Only the interaction head reads edges. It has no inputs if the target is the ego.
            edges: Arc::new(if target == scene.ego {
                EdgeGrid::empty()
            } else {
                EdgeGrid::around(edge_kinds.of(index), &frame, half[0].hypot(half[1]))
            }),
            edge_kinds,
            has_lanes: goals.on_lanes > 0,
            label: goals.label.map(|(end, row)| (end, Table { columns: GOAL_COLUMNS, values: row.to_vec() })),
        })
    }

    /// Number of goals.
    pub fn modes(&self) -> usize {
        self.goals.len()
    }

    /// Speed *now*, m/s.
    pub fn speed(&self) -> f32 {
        self.velocity[0].hypot(self.velocity[1])
    }

    /// Features of the mirrored scene: left and right swapped.
    pub fn mirrored(&self) -> Self {
        let mut mirror = self.clone();
        mirror.velocity[1] = -mirror.velocity[1];
        flip(&mut mirror.vectors, &map::SIGNED);
        flip(&mut mirror.goal_features, goals::SIGNED);
        for goal in &mut mirror.goals {
            goal[1] = -goal[1];
        }
        mirror.agent_forecasts = self.agent_forecasts.mirrored();
        mirror.edges = Arc::new(self.edges.mirrored());
        if let Some((end, row)) = &mut mirror.label {
            end[1] = -end[1];
            flip(row, goals::SIGNED);
        }
        mirror
    }

    /// Keeps the first `most` map polylines. In our format they are sorted by distance.
    pub fn with_polylines(mut self, most: usize) -> Self {
        self.groups = self.groups.first(self.agents.saturating_add(most));
        self.vectors.values.truncate(self.groups.rows() * self.vectors.columns);
        self
    }

    /// Keeps the given goals only.
    pub fn with_goals(mut self, keep: &[usize]) -> Self {
        let mut features = Table { columns: self.goal_features.columns, values: Vec::new() };
        for &goal in keep {
            features.values.extend_from_slice(self.goal_features.row(goal));
        }
        self.goals = keep.iter().map(|&goal| self.goals[goal]).collect();
        self.goal_features = features;
        self
    }
}

fn flip(table: &mut Table, signed: &[usize]) {
    for row in table.values.chunks_exact_mut(table.columns) {
        for &column in signed {
            row[column] = -row[column];
        }
    }
}

/// Frame and local velocity of an agent.
fn target_frame(scene: &Scene, target: usize) -> Result<(Frame, [f32; 2]), Error> {
    let track = scene.tracks.get(target).ok_or_else(|| sage_core::Error::Scene {
        scene: scene.id.clone(),
        problem: format!("no track number {target}; there are {}", scene.tracks.len()),
    })?;
    if !track.is_valid(NOW) {
        return Err(sage_core::Error::Scene {
            scene: scene.id.clone(),
            problem: format!(
                "agent `{}` is not valid at frame {NOW}, so nothing can be predicted for it; `sage inspect --tracks` lists those that are",
                track.id.escape_debug()
            ),
        }
        .into());
    }
    let frame = Frame::new(track.point(NOW), track.heading[NOW]);
    let velocity = frame.direction_from_world(track.velocity[NOW]).map(|v| v.clamp(-FASTEST, FASTEST) as f32);
    Ok((frame, velocity))
}

/// An angle in (−π, π].
fn wrap(angle: f32) -> f32 {
    let turned = angle % (2.0 * PI);
    if turned > PI {
        turned - 2.0 * PI
    } else if turned <= -PI {
        turned + 2.0 * PI
    } else {
        turned
    }
}
