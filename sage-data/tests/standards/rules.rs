//! Rules of the two standards that need no schema. Each function gives the violations in words.

use std::collections::HashSet;

use sage_core::geometry::wrap_angle;
use sage_data::openscenario::Standard;

use super::{
    map::{Link, Network, Road, gap},
    xml::Element,
};

/// Children of an element in the order that the schemas demand.
const ORDER: [(&str, &[&str]); 26] = [
    ("OpenSCENARIO", &["FileHeader", "CatalogLocations", "RoadNetwork", "Entities", "Storyboard"]),
    ("FileHeader", &["License", "Properties"]),
    ("RoadNetwork", &["LogicFile"]),
    ("Entities", &["ScenarioObject"]),
    ("ScenarioObject", &["Vehicle", "Pedestrian", "MiscObject", "ObjectController"]),
    ("Vehicle", &["BoundingBox", "Performance", "Axles", "Properties"]),
    ("Pedestrian", &["BoundingBox", "Properties"]),
    ("MiscObject", &["BoundingBox", "Properties"]),
    ("Storyboard", &["Init", "Story", "StopTrigger"]),
    ("Actions", &["GlobalAction", "Private"]),
    ("Act", &["ManeuverGroup", "StartTrigger"]),
    ("ManeuverGroup", &["Actors", "Maneuver"]),
    ("Event", &["Action", "StartTrigger"]),
    ("FollowTrajectoryAction", &["Trajectory", "TrajectoryRef", "TimeReference", "TrajectoryFollowingMode"]),
    ("SpeedAction", &["SpeedActionDynamics", "SpeedActionTarget"]),
    ("OpenDRIVE", &["header", "road", "junction", "userData"]),
    ("road", &["link", "type", "planView", "elevationProfile", "lanes", "objects", "signals"]),
    ("link", &["predecessor", "successor"]),
    ("planView", &["geometry"]),
    ("elevationProfile", &["elevation"]),
    ("lanes", &["laneOffset", "laneSection"]),
    ("laneSection", &["center", "right"]),
    ("lane", &["link", "width", "roadMark"]),
    ("signals", &["signal"]),
    ("junction", &["connection"]),
    ("connection", &["laneLink"]),
];

/// Elements out of order.
pub fn order(root: &Element) -> Vec<String> {
    let mut wrong = Vec::new();
    for element in root.walk() {
        let Some((_, order)) = ORDER.iter().find(|(tag, _)| *tag == element.tag) else { continue };
        let ranks = element.children.iter().map(|child| order.iter().position(|tag| *tag == child.tag));
        let mut before = 0;
        for (rank, child) in ranks.zip(&element.children) {
            match rank {
                Some(rank) if rank >= before => before = rank,
                _ => wrong.push(format!("{} in {}", child.tag, element.tag)),
            }
        }
    }
    wrong
}

/// Rules of a scenario file: names, references, and what its version knows. `signals` are the ids on the map.
pub fn scenario(root: &Element, standard: Standard, map_file: &str, network: &Network) -> Vec<String> {
    let mut wrong = order(root);
    let all = root.walk();
    let mut require = |holds: bool, what: String| {
        if !holds {
            wrong.push(what);
        }
    };
    for element in &all {
        let mut names = HashSet::new();
        for name in element.children.iter().filter_map(|child| child.get("name")) {
            require(names.insert(name), format!("{name} twice in {}", element.tag));
        }
    }
    let entities: HashSet<&str> =
        root.child("Entities").unwrap().all("ScenarioObject").map(|object| object.at("name")).collect();
    for element in &all {
        if let Some(name) = element.get("entityRef") {
            require(entities.contains(name), format!("no entity {name}"));
        }
        if element.tag == "TrafficSignalStateAction" {
            let signal = element.at("name");
            require(network.signals.contains_key(signal), format!("no signal {signal}"));
        }
    }
    let file = root.find(&["RoadNetwork", "LogicFile"]).map(|file| file.at("filepath"));
    require(file == Some(map_file), format!("map {file:?}"));
    let header = root.child("FileHeader").unwrap();
    let is = |version: Standard| standard == version;
    require(format!("1.{}", header.at("revMinor")) == standard.name(), "version".to_owned());
    require(standard >= Standard::V1_1 || header.child("License").is_none(), "License".to_owned());
    require((standard >= Standard::V1_2) == header.child("Properties").is_some(), "Properties".to_owned());
    for element in all {
        let holds = match element.tag.as_str() {
            "FollowTrajectoryAction" => is(Standard::V1_0) == element.child("Trajectory").is_some(),
            "SimulationTimeCondition" => is(Standard::V1_0) == (element.at("rule") == "greaterThan"),
            "Pedestrian" => is(Standard::V1_0) == element.get("model").is_some(),
            "Controller" => (standard >= Standard::V1_2) == element.get("controllerType").is_some(),
            "PrivateAction" => is(Standard::V1_0) || element.child("ActivateControllerAction").is_none(),
            "Event" => {
                element.at("priority") == if standard >= Standard::V1_2 { "override" } else { "overwrite" }
            }
            "Actors" => element.at("selectTriggeringEntities") == "false",
            "Act" | "Maneuver" => !element.children.is_empty(),
            _ => true,
        };
        require(holds, format!("{} is not of {standard}", element.tag));
    }
    wrong
}

/// Rules of a road network: ids, lengths, joints and links.
pub fn map(root: &Element, network: &Network) -> Vec<String> {
    let mut wrong = order(root);
    let ids = root.all("road").map(|road| road.at("id")).collect::<HashSet<_>>();
    if ids.len() != root.all("road").count() {
        wrong.push("a road id twice".to_owned());
    }
    if network.signals.len() != root.walk().iter().filter(|element| element.tag == "signal").count() {
        wrong.push("a signal id twice".to_owned());
    }
    for road in network.roads.values() {
        wrong.extend(geometry(road).into_iter().map(|what| format!("road {}: {what}", road.id)));
        wrong.extend(links(road, network).into_iter().map(|what| format!("road {}: {what}", road.id)));
    }
    for (signal, (road, s)) in &network.signals {
        if !(0.0..=network.roads[road].length).contains(s) {
            wrong.push(format!("signal {signal} at {s}"));
        }
    }
    for (id, connections) in &network.junctions {
        let mut seen = HashSet::new();
        for c in connections {
            let connecting = network.roads.get(&c.connecting);
            let is_sound = c.contact == "start"
                && c.links_lanes
                && seen.insert(&c.connecting)
                && connecting.is_some_and(|road| road.junction.as_ref() == Some(id))
                && connecting.and_then(|road| road.predecessor.as_ref()).is_some_and(|l| l.id == c.incoming);
            if !is_sound {
                wrong.push(format!("junction {id}: {c:?}"));
            }
        }
    }
    wrong
}

/// Lengths and smoothness within a road.
fn geometry(road: &Road) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut s = 0.0;
    for (k, piece) in road.pieces.iter().enumerate() {
        if (piece.s - s).abs() > 1e-6 {
            wrong.push(format!("piece {k} at {}, the one before ends at {s}", piece.s));
        }
        if (piece.measured() - piece.length).abs() > 1e-3 || piece.length <= 0.0 {
            wrong.push(format!("piece {k} measures {}, not {}", piece.measured(), piece.length));
        }
        if let Some(next) = road.pieces.get(k + 1) {
            let ((end, heading), (start, next_heading)) = (piece.at(1.0), next.at(0.0));
            if gap(end, start) > 1e-5 || wrap_angle(heading - next_heading).abs() > 1e-5 {
                wrong.push(format!("piece {k} ends at {end:?} {heading}, then {start:?} {next_heading}"));
            }
        }
        s = piece.s + piece.length;
    }
    if (road.length - s).abs() > 1e-6 {
        wrong.push(format!("length {}, pieces end at {s}", road.length));
    }
    if [0.0, road.length].iter().any(|s| road.width[0] + road.width[1] * s < 0.5) {
        wrong.push(format!("width {:?}", road.width));
    }
    for pair in road.elevation.windows(2) {
        let ([s, height, slope], [next, next_height, _]) = (pair[0], pair[1]);
        if (height + slope * (next - s) - next_height).abs() > 1e-3 || next <= s {
            wrong.push(format!("height jumps at {next}"));
        }
    }
    wrong
}

/// Links of a road to both sides: what it names must exist, name it back, and touch it.
fn links(road: &Road, network: &Network) -> Vec<String> {
    let mut wrong = Vec::new();
    let sides = [(&road.predecessor, false), (&road.successor, true)];
    for (side, (link, at_end)) in sides.into_iter().enumerate() {
        let is_road = link.as_ref().is_some_and(|link| !link.to_junction);
        if road.lane_links[side] != is_road {
            wrong.push("lane links differ from road links".to_owned());
        }
        let Some(link) = link else { continue };
        if link.to_junction {
            let connections = network.junctions.get(&link.id);
            let ends = |id: &String| if at_end { id == &road.id } else { leads_to(network, id, &road.id) };
            let has = connections.is_some_and(|all| {
                all.iter().any(|c| ends(if at_end { &c.incoming } else { &c.connecting }))
            });
            if !has || road.junction.is_some() {
                wrong.push(format!("junction {} does not know it", link.id));
            }
            continue;
        }
        let Some(other) = network.roads.get(&link.id) else {
            wrong.push(format!("no road {}", link.id));
            continue;
        };
        let other_end = link.contact.as_deref() == Some("end");
        if other_end == at_end {
            wrong.push(format!("{link:?} is of the wrong end"));
        }
        let back = if other_end { &other.successor } else { &other.predecessor };
        let expected = Link {
            to_junction: road.junction.is_some(),
            id: road.junction.clone().unwrap_or(road.id.clone()),
            contact: road.junction.is_none().then(|| if at_end { "end" } else { "start" }.to_owned()),
        };
        if back.as_ref() != Some(&expected) {
            wrong.push(format!("{} names back {back:?}", other.id));
        }
        let (own, others) = (road.borders(at_end), other.borders(other_end));
        let widest = gap(own[0], others[0]).max(gap(own[1], others[1]));
        if widest >= 0.01 {
            wrong.push(format!("a gap of {widest} m to {}", other.id));
        }
        if (road.height(at_end) - other.height(other_end)).abs() >= 0.01 {
            wrong.push(format!("a step to {}", other.id));
        }
    }
    wrong
}

fn leads_to(network: &Network, connecting: &str, road: &str) -> bool {
    let successor = network.roads.get(connecting).and_then(|c| c.successor.as_ref());
    successor.is_some_and(|link| link.id == road && !link.to_junction)
}
