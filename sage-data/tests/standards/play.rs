//! A player for tests: where each road user of a scenario is at each tenth of a second.

use std::collections::HashMap;

use sage_core::geometry::{OrientedBox, wrap_angle};

use super::xml::Element;

/// A road user of the scenario.
pub struct Actor {
    pub name: String,
    /// Id of its track in the source.
    pub source: String,
    /// Length, width, height.
    pub size: [f64; 3],
    /// x, y, z, heading at each tenth of a second; none if it is not there.
    pub states: Vec<Option<[f64; 4]>>,
}

impl Actor {
    /// Its box at a frame.
    pub fn oriented_box(&self, frame: usize) -> Option<OrientedBox> {
        let [x, y, _, heading] = self.states[frame]?;
        Some(OrientedBox::new([x, y], heading, self.size[0], self.size[1]))
    }
}

/// An event: what it does to an actor once its trigger is true.
enum Effect {
    Appear([f64; 4]),
    Follow(Vec<(f64, [f64; 4])>),
    Leave,
}

/// Plays a scenario to its end. Entities are in the order of the file.
pub fn play(root: &Element) -> Vec<Actor> {
    let board = root.child("Storyboard").unwrap();
    let last = (0..).find(|frame| is_true(board.child("StopTrigger").unwrap(), time(*frame))).unwrap();
    let mut effects: HashMap<&str, Vec<(&Element, Effect)>> = HashMap::new();
    for group in board.find(&["Story", "Act"]).unwrap().all("ManeuverGroup") {
        let actor = group.find(&["Actors", "EntityRef"]).map(|actor| actor.at("entityRef"));
        for event in group.child("Maneuver").iter().flat_map(|maneuver| maneuver.all("Event")) {
            for action in event.all("Action") {
                let trigger = event.child("StartTrigger").unwrap();
                if let Some((whom, effect)) = effect(action, actor) {
                    effects.entry(whom).or_default().push((trigger, effect));
                }
            }
        }
    }
    let mut starts = HashMap::new();
    for private in board.find(&["Init", "Actions"]).unwrap().all("Private") {
        for action in private.all("PrivateAction") {
            if let Some(position) = action.find(&["TeleportAction", "Position"]) {
                starts.insert(private.at("entityRef"), pose(position));
            }
        }
    }
    let actor = |object: &Element| {
        let name = object.at("name");
        let body = &object.children[0];
        let size = body.find(&["BoundingBox", "Dimensions"]).unwrap();
        let center = body.find(&["BoundingBox", "Center"]).unwrap();
        assert_eq!((center.at("x"), center.at("y")), ("0", "0"), "{name}");
        let source = body.child("Properties").unwrap().all("Property").find(|p| p.at("name") == "sage:track");
        let mut there: Option<[f64; 4]> = starts.get(name).copied();
        let mut line: Option<&[(f64, [f64; 4])]> = None;
        let mut fired = 0;
        let effects = effects.get(name).map_or(&[][..], Vec::as_slice);
        let state = |frame: usize| {
            while let Some((trigger, effect)) = effects.get(fired)
                && is_true(trigger, time(frame))
            {
                match effect {
                    Effect::Appear(pose) => (there, line) = (Some(*pose), None),
                    Effect::Follow(vertices) => line = Some(vertices),
                    Effect::Leave => (there, line) = (None, None),
                }
                fired += 1;
            }
            there.map(|pose| line.map_or(pose, |line| interpolated(line, time(frame))))
        };
        Actor {
            name: name.to_owned(),
            source: source.unwrap().at("value").to_owned(),
            size: ["length", "width", "height"].map(|side| size.number(side)),
            states: (0..=last).map(state).collect(),
        }
    };
    root.child("Entities").unwrap().all("ScenarioObject").map(actor).collect()
}

fn time(frame: usize) -> f64 {
    frame as f64 * 0.1
}

/// Whether a trigger is true at a time.
fn is_true(trigger: &Element, time: f64) -> bool {
    let condition = ["ConditionGroup", "Condition", "ByValueCondition", "SimulationTimeCondition"];
    let condition = trigger.find(&condition).unwrap();
    let value = condition.number("value");
    match condition.at("rule") {
        "greaterThan" => time > value,
        "greaterOrEqual" => time >= value,
        other => panic!("rule {other}"),
    }
}

fn effect<'e>(action: &'e Element, actor: Option<&'e str>) -> Option<(&'e str, Effect)> {
    if let Some(entity) = action.find(&["GlobalAction", "EntityAction"]) {
        let whom = entity.at("entityRef");
        let effect = match entity.child("AddEntityAction") {
            Some(add) => Effect::Appear(pose(add.child("Position").unwrap())),
            None => entity.child("DeleteEntityAction").map(|_| Effect::Leave).unwrap(),
        };
        return Some((whom, effect));
    }
    let follow = action.find(&["PrivateAction", "RoutingAction", "FollowTrajectoryAction"])?;
    let timing = follow.find(&["TimeReference", "Timing"]).unwrap();
    assert_eq!(timing.at("domainAbsoluteRelative"), "absolute");
    assert_eq!((timing.number("scale"), timing.number("offset")), (1.0, 0.0));
    assert_eq!(follow.child("TrajectoryFollowingMode").unwrap().at("followingMode"), "position");
    let trajectory = follow.child("TrajectoryRef").unwrap_or(follow).child("Trajectory").unwrap();
    let line = trajectory.find(&["Shape", "Polyline"]).unwrap();
    let vertices: Vec<(f64, [f64; 4])> = line
        .all("Vertex")
        .map(|vertex| (vertex.number("time"), pose(vertex.child("Position").unwrap())))
        .collect();
    assert!(vertices.len() >= 2 && vertices.windows(2).all(|pair| pair[0].0 < pair[1].0));
    Some((actor.unwrap(), Effect::Follow(vertices)))
}

fn pose(position: &Element) -> [f64; 4] {
    let world = position.child("WorldPosition").unwrap();
    assert_eq!((world.number("p"), world.number("r")), (0.0, 0.0));
    let pose = ["x", "y", "z", "h"].map(|name| world.number(name));
    assert!(pose[3].abs() <= std::f64::consts::PI + 1e-6, "heading {}", pose[3]);
    pose
}

fn interpolated(line: &[(f64, [f64; 4])], time: f64) -> [f64; 4] {
    let next = line.iter().position(|(at, _)| *at >= time - 1e-9).unwrap_or(line.len() - 1);
    let (at, b) = line[next];
    if next == 0 || (at - time).abs() < 1e-9 {
        return b;
    }
    let (before, a) = line[next - 1];
    let share = ((time - before) / (at - before)).min(1.0);
    let mut pose = [0, 1, 2, 3].map(|k| a[k] + share * (b[k] - a[k]));
    pose[3] = a[3] + share * wrap_angle(b[3] - a[3]);
    pose
}
