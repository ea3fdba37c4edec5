//! Positions, actions and triggers.

use sage_core::{geometry::wrap_angle, scene::Track};

use super::Standard;
use crate::xml::{Xml, rounded};

/// Decimals of a position in metres and of a heading in radians.
const POSITION: usize = 6;
/// Frames in a second.
const RATE: f64 = 10.0;

/// Simulation time of a frame, seconds. Recorded times stray from it by up to 26 ms, and players step by
/// tenths of a second.
pub(super) fn time(frame: usize) -> f64 {
    frame as f64 / RATE
}

/// Place and heading of a road user as the file has them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pose([f64; 4]);

impl Pose {
    /// The pose at a frame: the centre of the box in the plane, its lower side, and the heading in (−π, π].
    pub(super) fn of(track: &Track, frame: usize, origin: [f64; 3]) -> Self {
        let [x, y, z] = track.position[frame];
        let ground = z - 0.5 * track.size[frame][2];
        let heading = wrap_angle(track.heading[frame]);
        let pose = [x - origin[0], y - origin[1], ground - origin[2], heading];
        Self(pose.map(|value| rounded(value, POSITION)))
    }

    /// Whether place and heading are those of another pose, and the height differs by at most `rise` metres.
    pub(super) fn stays_at(self, other: Self, rise: f64) -> bool {
        let ([x, y, z, heading], [other_x, other_y, other_z, other_heading]) = (self.0, other.0);
        [x, y, heading] == [other_x, other_y, other_heading] && (z - other_z).abs() <= rise
    }

    pub(super) fn write(self, xml: &mut Xml) {
        let [x, y, z, heading] = self.0;
        xml.nested(&["Position", "WorldPosition"], |xml| {
            xml.number("x", x, POSITION).number("y", y, POSITION).number("z", z, POSITION);
            // Without pitch and roll, players may take them from the road.
            xml.number("h", heading, POSITION).integer("p", 0).integer("r", 0);
        });
    }
}

/// Sets the speed of the road user that the action belongs to, at once.
pub(super) fn write_speed(xml: &mut Xml, speed: f64) {
    xml.nested(&["PrivateAction", "LongitudinalAction", "SpeedAction"], |xml| {
        xml.element("SpeedActionDynamics", |xml| {
            xml.text("dynamicsShape", "step").integer("value", 0).text("dynamicsDimension", "time");
        });
        xml.nested(&["SpeedActionTarget", "AbsoluteTargetSpeed"], |xml| {
            xml.number("value", speed, POSITION);
        });
    });
}

/// A start or stop trigger at a time.
pub(super) fn write_trigger(xml: &mut Xml, tag: &'static str, name: &str, time: f64, standard: Standard) {
    // Version 1.0 knows no `greaterOrEqual`. The margins are below a step of any player, and above the error
    // of its clock.
    let (rule, margin) =
        if standard == Standard::V1_0 { ("greaterThan", 1e-3) } else { ("greaterOrEqual", 1e-6) };
    xml.nested(&[tag, "ConditionGroup", "Condition"], |xml| {
        xml.text("name", name).integer("delay", 0).text("conditionEdge", "none");
        xml.nested(&["ByValueCondition", "SimulationTimeCondition"], |xml| {
            xml.number("value", time - margin, POSITION).text("rule", rule);
        });
    });
}

/// Something that happens once, at a time.
pub(super) struct Event<'e> {
    pub(super) name: &'e str,
    /// Name of its trigger.
    pub(super) when: &'e str,
    /// Simulation time, seconds.
    pub(super) time: f64,
}

impl Event<'_> {
    /// Writes the event; `actions` writes what it does.
    pub(super) fn write(&self, xml: &mut Xml, standard: Standard, actions: impl FnOnce(&mut Xml)) {
        // Since 1.2 `overwrite` is deprecated.
        let priority = if standard >= Standard::V1_2 { "override" } else { "overwrite" };
        xml.element("Event", |xml| {
            xml.text("name", self.name).text("priority", priority).integer("maximumExecutionCount", 1);
            actions(xml);
            write_trigger(xml, "StartTrigger", self.when, self.time, standard);
        });
    }
}

/// A named action of an event.
pub(super) fn write_action(xml: &mut Xml, name: &str, content: impl FnOnce(&mut Xml)) {
    xml.element("Action", |xml| {
        xml.text("name", name);
        content(xml);
    });
}

/// A group of events with the road users that act in it.
pub(super) fn write_group(xml: &mut Xml, name: &str, actor: Option<&str>, events: impl FnOnce(&mut Xml)) {
    xml.element("ManeuverGroup", |xml| {
        xml.text("name", name).integer("maximumExecutionCount", 1);
        xml.element("Actors", |xml| {
            xml.text("selectTriggeringEntities", "false");
            if let Some(actor) = actor {
                xml.element("EntityRef", |xml| {
                    xml.text("entityRef", actor);
                });
            }
        });
        events(xml);
    });
}
