//! Pickles of protocols 0 and 1: values of each opcode, and what CPython reads but no pickler writes.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

use std::path::{Path, PathBuf};

use sage_core::seed::Rng;
use sage_data::{
    Format, Recording,
    pickle::{Document, Node, PickleProblem},
};

/// The value of a pickle, as Python's `repr` writes it.
fn shown(bytes: &[u8]) -> Result<String, PickleProblem> {
    let document = Document::parse(bytes.to_vec()).map_err(|error| error.kind)?;
    fn of(document: &Document, id: sage_data::pickle::Id) -> String {
        let all = |items: &[_]| items.iter().map(|id| of(document, *id)).collect::<Vec<_>>().join(", ");
        match document.node(id) {
            Node::None => "None".to_owned(),
            Node::Bool(x) => format!("{x}"),
            Node::Int(x) => format!("{x}"),
            Node::BigInt(span) => format!("{:02x?}", document.bytes(*span)),
            Node::Float(x) => format!("{x:?}"),
            Node::Str(_) => format!("{:?}", document.text(id).unwrap()),
            Node::Bytes(span) => format!("b{:02x?}", document.bytes(*span)),
            Node::List(items) => format!("[{}]", all(items)),
            Node::Tuple(items) => format!("({})", all(items)),
            Node::Dict(entries) => {
                let pairs: Vec<String> = entries
                    .iter()
                    .map(|(k, v)| format!("{}: {}", of(document, *k), of(document, *v)))
                    .collect();
                format!("{{{}}}", pairs.join(", "))
            }
            other => other.kind().to_owned(),
        }
    }
    Ok(of(&document, document.root()))
}

#[test]
fn every_text_opcode_has_the_value_that_python_reads() {
    for (pickle, value) in [
        (&b"I0\n."[..], "0"),
        (b"I00\n.", "false"),
        (b"I01\n.", "true"),
        (b"I-17\n.", "-17"),
        (b"I1099511627776\n.", "1099511627776"),
        (b"L5L\n.", "5"),
        (b"L5\n.", "5"),
        (b"L0L\n.", "0"),
        (b"L-9223372036854775808L\n.", "-9223372036854775808"),
        (b"L9223372036854775808L\n.", "[00, 00, 00, 00, 00, 00, 00, 80, 00]"),
        (b"L-9223372036854775809L\n.", "[ff, ff, ff, ff, ff, ff, ff, 7f, ff]"),
        (b"L100000000000000000000L\n.", "[00, 00, 10, 63, 2d, 5e, c7, 6b, 05]"),
        (b"F1.5\n.", "1.5"),
        (b"F-0.0\n.", "-0.0"),
        (b"F1e+16\n.", "1e16"),
        (b"F5e-324\n.", "5e-324"),
        (b"F40\n.", "40.0"),
        (b"Finf\n.", "inf"),
        (b"F-inf\n.", "-inf"),
        (b"Fnan\n.", "NaN"),
        (b"S'ab'\n.", "\"ab\""),
        (b"S\"it's\"\n.", "\"it's\""),
        (b"S'\\x41\\n\\t\\\\\\''\n.", "\"A\\n\\t\\\\'\""),
        (b"S'\\101\\0'\n.", "\"A\\0\""),
        (b"S''\n.", "\"\""),
        (b"Va b\n.", "\"a b\""),
        (b"V\n.", "\"\""),
        (b"V\xe9\n.", "\"é\""),
        (b"V\\u00e9\\U0001f600\n.", "\"é😀\""),
        (b"V\\u005cu0041\n.", "\"\\\\u0041\""),
        (b"V\\\\u0041\n.", "\"\\\\\\\\u0041\""),
        (b"V\\x41\n.", "\"\\\\x41\""),
        (b"Va\\\n.", "\"a\\\\\""),
        (b"(I1\nI2\nt.", "(1, 2)"),
        (b"(lp0\nI1\naNa.", "[1, None]"),
        (b"(I1\nI2\nl.", "[1, 2]"),
        (b"(dp0\nVa\np1\nI1\nsVb\np2\ng1\ns.", "{\"a\": 1, \"b\": \"a\"}"),
        (b"(Va\nI1\nd.", "{\"a\": 1}"),
        (b"(I1\n0I2\nt.", "(2)"),
        (b"(I1\n2t.", "(1, 1)"),
        (b"I1\n(I2\nI3\n1.", "1"),
        (b"}q\x00(U\x01aK\x01T\x01\x00\x00\x00bI01\nu.", "{\"a\": 1, \"b\": true}"),
        (b"]q\x00(NG@D\x00\x00\x00\x00\x00\x00e.", "[None, 40.0]"),
        (b"c_codecs\nencode\n(Vab\xff\nVlatin1\ntR.", "b[61, 62, ff]"),
        (b"c__builtin__\nbytes\n(tR.", "b[]"),
        (b"\x80\x00I5\n.", "5"),
        (b"\x80\x01K\x05.", "5"),
    ] {
        assert_eq!(shown(pickle).as_deref(), Ok(value), "{}", pickle.escape_ascii());
    }
}

#[test]
fn what_python_writes_nowhere_is_refused() {
    for pickle in [
        &b"I-0\n."[..],
        b"I007\n.",
        b"I0x10\n.",
        b"I+3\n.",
        b"I 3\n.",
        b"I3 \n.",
        b"I\n.",
        b"I1L\n.",
        b"I1_000\n.",
        b"I3\0\n.",
        b"I3\r\n.",
        b"L\n.",
        b"LL\n.",
        b"L00L\n.",
        b"L5LL\n.",
        b"F\n.",
        b"F1e400\n.",
        b"F-1e400\n.",
        b"F1_0\n.",
        b"F0x1p3\n.",
        b"F 1.0\n.",
        b"Finfinity\n.",
        b"F-nan\n.",
        b"F.\n.",
        b"F1.0e\n.",
        b"Sab\n.",
        b"S'ab\n.",
        b"S'\n.",
        b"S'ab\"\n.",
        b"S'\\x4'\n.",
        b"S'\\q'\n.",
        b"S'\\'\n.",
        b"S'\\400'\n.",
        b"S'\xe9'\n.",
        b"S'\\xe9'\n.",
        b"V\\u12\n.",
        b"V\\ud83d\\ude00\n.",
        b"V\\U00110000\n.",
        b"Np-1\n.",
        b"Np01\n.",
        b"Np\n.",
        b"p0\n.",
        b"Ng0\n.",
        b"Np0\ng1\n.",
        b"I1",
        b"V1.",
        b"{}",
        b"no scene at all",
        b"\x80\x06I1\n.",
        b"\x80\x03ccopy_reg\n_reconstructor\n(tR.",
    ] {
        assert!(shown(pickle).is_err(), "{}", pickle.escape_ascii());
    }
}

#[test]
fn a_vector_is_the_tuple_that_it_was_made_from() {
    // As Python 3 writes it in protocols 0, 1, 2 and 4, and as a call.
    for pickle in [
        &b"(dp0\nVa\np1\nccopy_reg\n_reconstructor\np2\n(cmetadrive.utils.math\nVector\np3\nc__builtin__\ntuple\np4\n(F40.0\nF-1.75\ntp5\ntp6\nRp7\ns."[..],
        b"}q\x00X\x01\x00\x00\x00aq\x01ccopy_reg\n_reconstructor\nq\x02(cmetadrive.utils.math\nVector\nq\x03c__builtin__\ntuple\nq\x04(G@D\x00\x00\x00\x00\x00\x00G\xbf\xfc\x00\x00\x00\x00\x00\x00tq\x05tq\x06Rq\x07s.",
        b"\x80\x02}q\x00X\x01\x00\x00\x00aq\x01cmetadrive.utils.math\nVector\nq\x02G@D\x00\x00\x00\x00\x00\x00G\xbf\xfc\x00\x00\x00\x00\x00\x00\x86q\x03\x85q\x04\x81q\x05s.",
        b"\x80\x04}\x94\x8c\x01a\x94\x8c\x14metadrive.utils.math\x94\x8c\x06Vector\x94\x93\x94G@D\x00\x00\x00\x00\x00\x00G\xbf\xfc\x00\x00\x00\x00\x00\x00\x86\x94\x85\x94\x81\x94s.",
        b"\x80\x05}\x8c\x01acmetadrive.utils.math_utils\nVector\nG@D\x00\x00\x00\x00\x00\x00G\xbf\xfc\x00\x00\x00\x00\x00\x00\x86\x85\x81s.",
        b"\x80\x04}\x8c\x01acmetadrive.utils.math\nVector\nG@D\x00\x00\x00\x00\x00\x00G\xbf\xfc\x00\x00\x00\x00\x00\x00\x86\x85Rs.",
    ] {
        assert_eq!(shown(pickle).as_deref(), Ok("{\"a\": (40.0, -1.75)}"), "{}", pickle.escape_ascii());
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
fn a_scene_is_the_same_in_every_protocol() {
    let Some(base) = case("base.pkl") else { return };
    let base = Recording::read(&base).unwrap();
    for name in ["proto0.pkl", "proto1.pkl", "proto2.pkl"] {
        let recording = Recording::read(&case(name).unwrap()).unwrap();
        assert_eq!(recording.scene, base.scene, "{name}");
        assert_eq!(recording.scene.content_hash(), base.scene.content_hash(), "{name}");
        let written = Recording::from_bytes(Path::new("again.pkl"), recording.to_pickle().unwrap()).unwrap();
        assert_eq!(written.scene, base.scene, "{name}");
    }
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
    let document = sage_data::pickle::Document::parse(pickle).unwrap();
    let lane = document.get(document.root(), "l").unwrap();
    let outline = document.get(lane, "o").unwrap();
    assert!(matches!(document.node(outline), sage_data::pickle::Node::None));
    // Only a new lane takes attributes, once, and only a dict of them.
    for wrong in [&b")\x81K\x01b."[..], b")\x81}b}b.", b"K\x01\x85\x81."] {
        let pickle = [&b"\x80\x04"[..], class, wrong].concat();
        assert!(sage_data::pickle::Document::parse(pickle).is_err(), "{wrong:?}");
    }
    for wrong in [&b"}}b."[..], b"cshapely.io\nfrom_wkb\nK\x01\x85R.", b"cshapely.io\nfrom_wkt\n."] {
        let pickle = [&b"\x80\x04"[..], wrong].concat();
        assert!(sage_data::pickle::Document::parse(pickle).is_err(), "{wrong:?}");
    }
}

#[test]
fn a_scenario_description_is_its_dict() {
    let class = b"cmetadrive.scenario.scenario_description\nScenarioDescription\n";
    // `ScenarioDescription()`, then its items, as protocol 4 writes them; and errors.
    let pickle = [&b"\x80\x04"[..], class, b")\x81(\x8c\x01aK\x01u."].concat();
    let document = sage_data::pickle::Document::parse(pickle).unwrap();
    let value = document.get(document.root(), "a").and_then(|id| document.integer(id));
    assert_eq!(value, Some(1));
    let written = document.to_pickle();
    assert!(!written.windows(8).any(|window| window == b"Scenario"));
    for wrong in [&b"K\x01\x85\x81."[..], b")R.", b"."] {
        let pickle = [&b"\x80\x04"[..], class, wrong].concat();
        let parsed = sage_data::pickle::Document::parse(pickle);
        // The class itself is a value that no scene can hold.
        assert!(parsed.is_err() || wrong == b".", "{wrong:?}");
    }
}
