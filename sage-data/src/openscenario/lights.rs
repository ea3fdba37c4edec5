//! States of traffic lights.

use sage_core::scene::LightState;

use super::{
    Scenario,
    actions::{Event, time, write_action, write_group},
};
use crate::xml::Xml;

/// Lamps from above: the standard leaves the words to the user; these are those of esmini.
fn lamps(state: LightState) -> &'static str {
    match state {
        LightState::Stop | LightState::FlashingStop => "on;off;off",
        LightState::Caution => "off;on;off",
        LightState::Go => "off;off;on",
        LightState::Unknown => "off;off;off",
    }
}

/// A signal that takes a state at a frame.
struct Change {
    signal: usize,
    frame: usize,
    state: LightState,
}

impl Change {
    fn write(&self, xml: &mut Xml) {
        let tags =
            ["GlobalAction", "InfrastructureAction", "TrafficSignalAction", "TrafficSignalStateAction"];
        xml.nested(&tags, |xml| {
            xml.integer("name", self.signal as i64).text("state", lamps(self.state));
        });
    }
}

impl Scenario<'_> {
    /// First states and changes of all lights that have a signal.
    fn light_changes(&self) -> Vec<Change> {
        let mut changes = Vec::new();
        for (light, signal) in self.scene.lights.iter().zip(&self.network.signals) {
            let Some(signal) = *signal else { continue };
            let mut before = None;
            for (frame, state) in light.states.iter().take(self.scene.frames).enumerate() {
                let state = state.steady();
                if before != Some(state) {
                    changes.push(Change { signal, frame, state });
                    before = Some(state);
                }
            }
        }
        changes
    }

    /// Writes the states at the start.
    pub(super) fn write_first_lights(&self, xml: &mut Xml) {
        self.light_changes().iter().filter(|change| change.frame == 0).for_each(|change| change.write(xml));
    }

    /// Writes the later changes as a group of events; `false` if there is none.
    pub(super) fn write_light_changes(&self, xml: &mut Xml) -> bool {
        let mut changes = self.light_changes();
        changes.retain(|change| change.frame > 0);
        if changes.is_empty() {
            return false;
        }
        write_group(xml, "lights", None, |xml| {
            xml.element("Maneuver", |xml| {
                xml.text("name", "lights");
                for change in &changes {
                    let (name, when) = (
                        format!("light {} frame {}", change.signal, change.frame),
                        format!("at frame {}", change.frame),
                    );
                    let event = Event { name: &name, when: &when, time: time(change.frame) };
                    event.write(xml, self.standard(), |xml| {
                        write_action(xml, "switch", |xml| change.write(xml));
                    });
                }
            });
        });
        true
    }
}
