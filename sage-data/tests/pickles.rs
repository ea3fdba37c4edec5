//! Classes that pickles name, pickles of protocols 0 and 1, and which format a file has.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

use std::path::{Path, PathBuf};

use sage_core::seed::Rng;
use sage_data::{
    Format, Recording,
    pickle::{Document, PickleProblem},
};

fn problem(bytes: &[u8]) -> PickleProblem {
    Document::parse(bytes.to_vec()).map(|_| ()).unwrap_err().kind
}

#[test]
fn old_protocols_are_refused_with_the_line_that_saves_the_file_again() {
    for pickle in [
        &b"(dp0\nVa\np1\nI1\ns."[..],
        b"}q\x00U\x01aK\x01s.",
        b"(lp0\n",
        b"cos\nsystem\n.",
        b"\x80\x00N.",
        b"\x80\x01N.",
        b"\x80\x04\x80\x01N.",
    ] {
        assert_eq!(problem(pickle), PickleProblem::OldProtocol, "{}", pickle.escape_ascii());
        let error = Recording::from_bytes(Path::new("a.pkl"), pickle.to_vec()).unwrap_err().to_string();
        for part in ["protocol 0 or 1", "only if you trust", "python3 -c 'import pickle", "protocol=4"] {
            assert!(error.contains(part), "{}: {error}", pickle.escape_ascii());
        }
    }
    // No newer pickler writes their opcodes, whose arguments are lines.
    for line in [&b"I1\n."[..], b"L1L\n.", b"F1.0\n.", b"S'a'\n.", b"Va\n.", b"Np0\n.", b"(l.", b"(d."] {
        let problem = problem(&[b"\x80\x02", line].concat());
        assert!(matches!(problem, PickleProblem::Opcode { .. }), "{}: {problem}", line.escape_ascii());
    }
}

#[test]
fn a_vector_is_the_tuple_that_it_was_made_from() {
    // As Python 3 writes it in protocols 2 and 4, and as a call.
    for pickle in [
        &b"\x80\x02}q\x00X\x01\x00\x00\x00aq\x01cmetadrive.utils.math\nVector\nq\x02G@D\x00\x00\x00\x00\x00\x00G\xbf\xfc\x00\x00\x00\x00\x00\x00\x86q\x03\x85q\x04\x81q\x05s."[..],
        b"\x80\x04}\x94\x8c\x01a\x94\x8c\x14metadrive.utils.math\x94\x8c\x06Vector\x94\x93\x94G@D\x00\x00\x00\x00\x00\x00G\xbf\xfc\x00\x00\x00\x00\x00\x00\x86\x94\x85\x94\x81\x94s.",
        b"\x80\x05}\x8c\x01acmetadrive.utils.math_utils\nVector\nG@D\x00\x00\x00\x00\x00\x00G\xbf\xfc\x00\x00\x00\x00\x00\x00\x86\x85\x81s.",
        b"\x80\x04}\x8c\x01acmetadrive.utils.math\nVector\nG@D\x00\x00\x00\x00\x00\x00G\xbf\xfc\x00\x00\x00\x00\x00\x00\x86\x85Rs.",
    ] {
        let document = Document::parse(pickle.to_vec()).unwrap();
        let vector = document.get(document.root(), "a").and_then(|id| document.items(id)).unwrap();
        let numbers: Vec<_> = vector.iter().map(|id| document.number(*id)).collect();
        assert_eq!(numbers, [Some(40.0), Some(-1.75)], "{}", pickle.escape_ascii());
    }
}

#[test]
fn a_file_that_python_would_run_is_never_another_format() {
    for pickle in [
        &b"(dp0\n."[..],
        b"(dp0\nVab{\nNs.",
        b"}q\x00.",
        b"I1\n.",
        b"cos\nsystem\n(S'ls'\ntR.",
        b"(lp0\ncos\nsystem\n",
    ] {
        assert_eq!(Format::of(pickle), Some(Format::Pickle), "{}", pickle.escape_ascii());
    }
    // The length of a native file's header, and then its brace, inside the argument of an opcode.
    for start in [
        &b"X\x04\0\0\0\0\0\0{cos\nsystem\n."[..],
        b"(X\x03\0\0\0\0\0{cos\nsystem\n.",
        b"T\x04\0\0\0\0\0\0{cos\nsystem\n.",
        b"G\x01\0\0\0\0\0\0{cos\nsystem\n.",
        b"VX\0\0\0\0\0\0{\"a\": 1}\ncos\nsystem\n.",
        b"I1\0\0\0\0\0\0{}\ncos\nsystem\n.",
        b"I1\0\0\0\0\0\0{}\n(S'ls'\nios\nsystem\n.",
        b"X\x04\0\0\0\0\0\0{\x8c\x02os\x8c\x06system\x93.",
    ] {
        assert_eq!(Format::of(start), Some(Format::Pickle), "{}", start.escape_ascii());
    }
    // Python stops at a zero or a quote before it has a name.
    for native in [
        &b"(\x01\0\0\0\0\0\0{\"a\": {}}"[..],
        b"X\x01\0\0\0\0\0\0{\"a\": {}}",
        b"}\0\0\0\0\0\0\0{}",
        b"N\0\0\0\0\0\0\0{}",
    ] {
        assert_eq!(Format::of(native), Some(Format::Native), "{}", native.escape_ascii());
    }
    for neither in [&b"{\"a\": 1}"[..], b"<xml>", b"PK\x03\x04", b"(", b"text", b"\x1f\x8b"] {
        assert_eq!(Format::of(neither), None, "{}", neither.escape_ascii());
    }
}

#[test]
fn records_of_every_length_are_records() {
    let mut rng = Rng::new(3, "records", "data");
    for length in (0..1_000).chain((1_000..300_000).step_by(301)) {
        let record: Vec<u8> = (0..length).map(|_| rng.bits() as u8).collect();
        let record = sage_data::womd::frame(&record);
        let found = Format::of(&record);
        assert!(matches!(found, Some(Format::TfRecord)), "{length}: {found:?}");
    }
}

fn case(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("SAGE_REFERENCE");
    if folder.is_none() {
        eprintln!("left out: SAGE_REFERENCE is not set");
    }
    folder.map(|folder| Path::new(&folder).join("cases").join(name))
}

#[test]
fn a_scene_is_the_same_in_protocol_2() {
    let Some(base) = case("base.pkl") else { return };
    let base = Recording::read(&base).unwrap();
    let recording = Recording::read(&case("proto2.pkl").unwrap()).unwrap();
    assert_eq!(recording.scene, base.scene);
    assert_eq!(recording.scene.content_hash(), base.scene.content_hash());
    let written = Recording::from_bytes(Path::new("again.pkl"), recording.to_pickle().unwrap()).unwrap();
    assert_eq!(written.scene, base.scene);
}

#[test]
fn a_light_at_a_vector_is_read_and_written_as_a_tuple() {
    let Some(path) = case("vector_stop_point.pkl") else { return };
    let recording = Recording::read(&path).unwrap();
    assert_eq!(recording.scene.lights[0].stop_point, Some([40.0, -1.75, 0.0]));
    let written = recording.to_pickle().unwrap();
    assert!(!written.windows(6).any(|window| window == b"Vector"));
    assert_eq!(Recording::from_bytes(&path, written).unwrap().scene, recording.scene);
}

#[test]
fn a_lane_of_metadrive_is_the_dict_of_its_attributes() {
    let class = b"cmetadrive.component.lane.point_lane\nPointLane\n";
    let outline = b"cshapely.io\nfrom_wkb\nC\x02\x01\x03\x85R";
    let pickle = [&b"\x80\x04}\x8c\x01l"[..], class, b")\x81}\x8c\x01o", outline, b"sbs."].concat();
    let document = Document::parse(pickle).unwrap();
    let lane = document.get(document.root(), "l").unwrap();
    let outline = document.get(lane, "o").unwrap();
    assert!(matches!(document.node(outline), sage_data::pickle::Node::None));
    // Only a new lane takes attributes, once, and only a dict of them.
    for wrong in [&b")\x81K\x01b."[..], b")\x81}b}b.", b"K\x01\x85\x81."] {
        let pickle = [&b"\x80\x04"[..], class, wrong].concat();
        assert!(Document::parse(pickle).is_err(), "{wrong:?}");
    }
    for wrong in [&b"}}b."[..], b"cshapely.io\nfrom_wkb\nK\x01\x85R.", b"cshapely.io\nfrom_wkt\n."] {
        let pickle = [&b"\x80\x04"[..], wrong].concat();
        assert!(Document::parse(pickle).is_err(), "{wrong:?}");
    }
}

#[test]
fn a_scenario_description_is_its_dict() {
    let class = b"cmetadrive.scenario.scenario_description\nScenarioDescription\n";
    // `ScenarioDescription()`, then its items, as protocol 4 writes them; and errors.
    let pickle = [&b"\x80\x04"[..], class, b")\x81(\x8c\x01aK\x01u."].concat();
    let document = Document::parse(pickle).unwrap();
    let value = document.get(document.root(), "a").and_then(|id| document.integer(id));
    assert_eq!(value, Some(1));
    let written = document.to_pickle();
    assert!(!written.windows(8).any(|window| window == b"Scenario"));
    for wrong in [&b"K\x01\x85\x81."[..], b")R.", b"."] {
        let pickle = [&b"\x80\x04"[..], class, wrong].concat();
        let parsed = Document::parse(pickle);
        // The class itself is a value that no scene can hold.
        assert!(parsed.is_err() || wrong == b".", "{wrong:?}");
    }
}
