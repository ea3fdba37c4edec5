//! File header and the properties that state where a scenario comes from.

use super::{EgoMode, Scenario, Standard, names::literal};
use crate::{opendrive::origin_text, xml::Xml};

/// Date of every file: the standard demands one, and the time of writing would make files differ.
const DATE: &str = "1970-01-01T00:00:00";

impl Scenario<'_> {
    pub(super) fn write_header(&self, xml: &mut Xml) {
        let standard = self.standard();
        xml.element("FileHeader", |xml| {
            xml.integer("revMajor", 1).integer("revMinor", standard.minor()).text("date", DATE);
            xml.text("description", &self.description()).text("author", "sage");
            if let Some(license) = self.options.license.as_ref().filter(|_| standard >= Standard::V1_1) {
                xml.element("License", |xml| {
                    xml.text("name", literal(&license.name).as_ref());
                    xml.text("spdxId", literal(&license.spdx_id).as_ref());
                    if !license.notice.is_empty() {
                        xml.content(&license.notice);
                    }
                });
            }
            if standard >= Standard::V1_2 {
                xml.element("Properties", |xml| write_properties(xml, &self.facts()));
            }
        });
    }

    fn description(&self) -> String {
        let replay = match self.options.ego {
            EgoMode::Replay => "replayed",
            EgoMode::Controller => {
                "replayed but for the ego, which has a controller and to which nobody reacts"
            }
        };
        let origin = origin_text(self.network.origin);
        let method = self.provenance.facts().find(|(key, _)| *key == "method");
        let attacked = method.map_or(String::new(), |(_, method)| format!("attacked by {method}, "));
        format!(
            "Scene {}, {attacked}{replay}. Add ({origin}) to positions for the source's frame.",
            self.scene.id
        )
    }

    /// Facts on the file: the scene, the origin, the licence, then the provenance.
    pub(super) fn facts(&self) -> Vec<(String, String)> {
        let mut facts = vec![
            ("sage:scene".to_owned(), self.scene.id.clone()),
            ("sage:origin".to_owned(), origin_text(self.network.origin)),
        ];
        if let Some(license) = &self.options.license {
            facts.push(("sage:license".to_owned(), format!("{}: {}", license.spdx_id, license.notice)));
        }
        facts.extend(self.provenance.facts().map(|(key, value)| (format!("sage:{key}"), value.to_owned())));
        facts
    }
}

/// Writes properties; of several with one name the first.
pub(super) fn write_properties(xml: &mut Xml, properties: &[(String, String)]) {
    for (k, (name, value)) in properties.iter().enumerate() {
        if !properties[..k].iter().any(|(other, _)| other == name) {
            xml.element("Property", |xml| {
                xml.text("name", literal(name).as_ref()).text("value", literal(value).as_ref());
            });
        }
    }
}
