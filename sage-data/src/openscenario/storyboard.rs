//! What happens in a scenario: who is where at the start, and who appears, moves and leaves when.

use sage_core::geometry::norm;

use super::{
    Entity, Scenario, Standard,
    actions::{Event, Pose, time, write_action, write_group, write_speed, write_trigger},
    presence::Stretch,
};
use crate::xml::Xml;

impl Scenario<'_> {
    pub(super) fn write_storyboard(&self, xml: &mut Xml) {
        let frames = self.scene.frames;
        let stretches: Vec<Vec<Stretch>> =
            self.entities.iter().map(|entity| Stretch::all(entity.track, frames)).collect();
        xml.element("Storyboard", |xml| {
            xml.nested(&["Init", "Actions"], |xml| {
                // The schema wants global actions before private ones.
                self.write_first_lights(xml);
                for (entity, stretches) in self.entities.iter().zip(&stretches) {
                    if let Some(first) = stretches.first().filter(|stretch| stretch.first == 0) {
                        self.write_start(xml, entity, *first);
                    }
                }
            });
            xml.element("Story", |xml| {
                xml.text("name", "replay");
                xml.element("Act", |xml| {
                    xml.text("name", "replay");
                    let mut is_empty = true;
                    for (entity, stretches) in self.entities.iter().zip(&stretches) {
                        is_empty &= !self.write_entity_events(xml, entity, stretches);
                    }
                    is_empty &= !self.write_light_changes(xml);
                    // Versions before 1.2 demand a story, and an act needs a group.
                    if is_empty {
                        write_group(xml, "nothing", None, |_| {});
                    }
                    write_trigger(xml, "StartTrigger", "start", 0.0, self.standard());
                });
            });
            let end = time(frames.saturating_sub(1));
            write_trigger(xml, "StopTrigger", "end", end, self.standard());
        });
    }

    /// Puts a road user in its place at the start.
    fn write_start(&self, xml: &mut Xml, entity: &Entity, stretch: Stretch) {
        xml.element("Private", |xml| {
            xml.text("entityRef", entity.name);
            xml.nested(&["PrivateAction", "TeleportAction"], |xml| {
                self.pose(entity, 0).write(xml);
            });
            if self.is_controlled(entity) {
                self.hand_over(entity, 0).into_iter().for_each(|(_, write)| write(xml));
            } else {
                // With the small speed that recordings give parked cars, they would creep.
                let speed = if stretch.moves(entity.track) { norm(entity.track.velocity[0]) } else { 0.0 };
                write_speed(xml, speed);
            }
        });
    }

    /// What hands the ego over to its controller at a frame: named private actions.
    fn hand_over<'a>(&'a self, entity: &'a Entity, frame: usize) -> [(&'static str, Write<'a>); 3] {
        [
            ("speed", Box::new(move |xml| write_speed(xml, norm(entity.track.velocity[frame])))),
            ("route", Box::new(move |xml| self.write_route(xml, entity))),
            ("control", Box::new(move |xml| write_activation(xml, self.standard()))),
        ]
    }

    /// The route of the ego: from its first to its last recorded place.
    fn write_route(&self, xml: &mut Xml, entity: &Entity) {
        let valid = &entity.track.valid;
        let ends = [valid.iter().position(|valid| *valid), valid.iter().rposition(|valid| *valid)];
        xml.nested(&["PrivateAction", "RoutingAction", "AssignRouteAction", "Route"], |xml| {
            xml.text("name", "recorded").text("closed", "false");
            for frame in ends.into_iter().flatten() {
                xml.element("Waypoint", |xml| {
                    xml.text("routeStrategy", "shortest");
                    self.pose(entity, frame).write(xml);
                });
            }
        });
    }

    /// Writes the events of a road user as a group; `false` if there is none.
    fn write_entity_events(&self, xml: &mut Xml, entity: &Entity, stretches: &[Stretch]) -> bool {
        let last = self.scene.frames.saturating_sub(1);
        let origin = self.network.origin;
        let is_eventful = |stretch: &Stretch| {
            stretch.first > 0 || stretch.last < last || stretch.needs_trajectory(entity.track, origin)
        };
        let starts_late = stretches.first().is_some_and(|stretch| stretch.first > 0);
        let is_controlled = self.is_controlled(entity);
        if if is_controlled { !starts_late } else { !stretches.iter().any(is_eventful) } {
            return false;
        }
        let name = format!("of {}", entity.name);
        write_group(xml, &name, Some(entity.name), |xml| {
            xml.element("Maneuver", |xml| {
                xml.text("name", &name);
                // A controller keeps the ego from its first place on, whatever the recording does.
                let stretches = if is_controlled { &stretches[..1] } else { stretches };
                for (number, stretch) in stretches.iter().enumerate() {
                    if stretch.first > 0 {
                        self.write_appearance(xml, entity, number, *stretch);
                    }
                    if is_controlled {
                        continue;
                    }
                    if stretch.needs_trajectory(entity.track, origin) {
                        self.write_motion(xml, entity, number, *stretch);
                    }
                    if stretch.last < last {
                        self.write_departure(xml, entity, number, *stretch);
                    }
                }
            });
        });
        true
    }

    fn write_appearance(&self, xml: &mut Xml, entity: &Entity, number: usize, stretch: Stretch) {
        let (name, when) = (format!("appear {number}"), format!("at frame {}", stretch.first));
        let event = Event { name: &name, when: &when, time: time(stretch.first) };
        event.write(xml, self.standard(), |xml| {
            write_action(xml, "add", |xml| {
                xml.nested(&["GlobalAction", "EntityAction"], |xml| {
                    xml.text("entityRef", entity.name);
                    xml.element("AddEntityAction", |xml| self.pose(entity, stretch.first).write(xml));
                });
            });
            if self.is_controlled(entity) {
                for (name, write) in self.hand_over(entity, stretch.first) {
                    write_action(xml, name, write);
                }
            }
        });
    }

    fn write_motion(&self, xml: &mut Xml, entity: &Entity, number: usize, stretch: Stretch) {
        let (name, when) = (format!("move {number}"), format!("from frame {}", stretch.first));
        let event = Event { name: &name, when: &when, time: time(stretch.first) };
        let write_trajectory = |xml: &mut Xml| {
            xml.element("Trajectory", |xml| {
                xml.text("name", &format!("{} {number}", entity.name)).text("closed", "false");
                xml.nested(&["Shape", "Polyline"], |xml| {
                    for frame in stretch.frames(entity.track) {
                        xml.element("Vertex", |xml| {
                            xml.number("time", time(frame), 1);
                            self.pose(entity, frame).write(xml);
                        });
                    }
                });
            });
        };
        event.write(xml, self.standard(), |xml| {
            write_action(xml, "follow", |xml| {
                xml.nested(&["PrivateAction", "RoutingAction", "FollowTrajectoryAction"], |xml| {
                    if self.standard() == Standard::V1_0 {
                        write_trajectory(xml);
                    } else {
                        xml.element("TrajectoryRef", write_trajectory);
                    }
                    xml.nested(&["TimeReference", "Timing"], |xml| {
                        xml.text("domainAbsoluteRelative", "absolute").integer("scale", 1);
                        xml.integer("offset", 0);
                    });
                    // With `follow` a player would choose its own speed.
                    xml.element("TrajectoryFollowingMode", |xml| {
                        xml.text("followingMode", "position");
                    });
                });
            });
        });
    }

    fn write_departure(&self, xml: &mut Xml, entity: &Entity, number: usize, stretch: Stretch) {
        let (name, when) = (format!("leave {number}"), format!("after frame {}", stretch.last));
        // Halfway to the next frame, so that the last frame is played whatever the step.
        let between = 0.5 * (time(stretch.last) + time(stretch.last + 1));
        Event { name: &name, when: &when, time: between }.write(xml, self.standard(), |xml| {
            write_action(xml, "delete", |xml| {
                xml.nested(&["GlobalAction", "EntityAction"], |xml| {
                    xml.text("entityRef", entity.name);
                    xml.element("DeleteEntityAction", |_| {});
                });
            });
        });
    }

    fn pose(&self, entity: &Entity, frame: usize) -> Pose {
        Pose::of(entity.track, frame, self.network.origin)
    }
}

/// Writes one action.
type Write<'a> = Box<dyn Fn(&mut Xml) + 'a>;

/// Gives an object's controller the control of its motion.
fn write_activation(xml: &mut Xml, standard: Standard) {
    let activate = |xml: &mut Xml| {
        xml.element("ActivateControllerAction", |xml| {
            xml.text("longitudinal", "true").text("lateral", "true");
        });
    };
    xml.element("PrivateAction", |xml| {
        // In 1.0 a `ControllerAction` assigns and overrides a controller at once.
        if standard == Standard::V1_0 {
            activate(xml);
        } else {
            xml.element("ControllerAction", activate);
        }
    });
}
