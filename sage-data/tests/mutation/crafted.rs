//! Pickles that are made to be slow or large, not by damage to a file.

use sage_core::seed::Rng;

/// Values inside values, deeper than any scene.
pub(super) fn deep(rng: &mut Rng) -> Vec<u8> {
    let n = [65, 1_000, 100_000, 400_000][rng.below(4)];
    let mut bytes = vec![0x80, 4];
    match rng.below(4) {
        0 => {
            bytes.extend(std::iter::repeat_n(b']', n));
            bytes.extend(std::iter::repeat_n(b'a', n - 1));
        }
        1 => {
            bytes.push(b'N');
            bytes.extend(std::iter::repeat_n(0x85, n));
        }
        2 => {
            bytes.extend(std::iter::repeat_n(b'(', n));
            bytes.extend(std::iter::repeat_n(b't', n));
        }
        _ => {
            for _ in 0..n {
                bytes.extend(b"}K\x01");
            }
            bytes.push(b'N');
            bytes.extend(std::iter::repeat_n(b's', n));
        }
    }
    bytes.push(b'.');
    bytes
}

/// Values that hold themselves.
pub(super) fn memo_loop(rng: &mut Rng) -> Vec<u8> {
    let body: &[u8] = match rng.below(6) {
        0 => b"]\x94h\x00a.",
        1 => b"}\x94K\x01h\x00s.",
        2 => b"]\x94h\x00\x85a.",
        3 => b"]\x94]\x94h\x00ah\x01\x86.",
        4 => b"\x8f\x94(h\x00\x90.",
        _ => b"]\x94(h\x00h\x00h\x00eh\x00h\x00\x86.",
    };
    let mut bytes = vec![0x80, 4];
    bytes.extend(body);
    bytes
}

/// Short files with large effects: shared lists of lists, repeated copies, large memo indices.
pub(super) fn amplified(rng: &mut Rng) -> Vec<u8> {
    let mut bytes = vec![0x80, 4];
    match rng.below(8) {
        5 => searched(&mut bytes),
        6 => bytes.extend(std::iter::repeat_n([b']', b'('][rng.below(2)], 4 << 20)),
        7 => listed(&mut bytes),
        0 => {
            // Each list contains the previous one twice: a traversal without memory visits 2^60 leaves.
            bytes.extend(b"]\x94");
            for k in 0..60u8 {
                bytes.extend([b']', 0x94, b'(', b'h', k, b'h', k, b'e']);
            }
        }
        1 => {
            // One long text, decoded many times.
            bytes.extend(b"c_codecs\nencode\n\x94X\x00\x00\x10\x00");
            bytes.extend(std::iter::repeat_n(b'x', 1 << 20));
            bytes.extend(b"\x94\x8c\x06latin1\x94");
            for _ in 0..100_000 {
                bytes.extend(b"h\x00h\x01h\x02\x86R0");
            }
        }
        2 => {
            // One long list, converted to a set many times.
            bytes.extend(b"cbuiltins\nset\n\x94](");
            bytes.extend(std::iter::repeat_n(b'N', 200_000));
            bytes.extend(b"e\x94");
            for _ in 0..100_000 {
                bytes.extend(b"h\x00h\x01\x85R0");
            }
            bytes.push(b'N');
        }
        3 => {
            bytes.extend(b"Nr\xff\xff\xff\xff");
        }
        _ => {
            // A scene whose tracks are all one shared track.
            bytes.extend(b"}\x94(\x8c\x06lengthK\x0b\x8c\x06tracks}(");
            for k in 0..20_000u32 {
                bytes.extend([0x8c, 8]);
                bytes.extend(format!("{k:08}").bytes());
                bytes.extend(b"h\x00");
            }
            bytes.extend(b"uu");
        }
    }
    bytes.push(b'.');
    bytes
}

/// A text.
fn text(bytes: &mut Vec<u8>, text: &str) {
    bytes.extend([0x8c, text.len() as u8]);
    bytes.extend(text.bytes());
}

/// Many complete tracks that are one shared dict of very many keys; each is searched for a few of them.
fn searched(bytes: &mut Vec<u8>) {
    shared_track(bytes, 100_000);
    scene_of_one_track(bytes, 20_000, |_| {});
}

/// Many tracks, and a long list of objects of interest that are not tracks.
fn listed(bytes: &mut Vec<u8>) {
    shared_track(bytes, 0);
    scene_of_one_track(bytes, 5_000, |bytes| {
        text(bytes, "objects_of_interest");
        text(bytes, "nobody");
        bytes.extend(b"\x940](");
        for _ in 0..200_000 {
            bytes.extend(b"h\x01");
        }
        bytes.push(b'e');
    });
}

/// Files with one shared track, and whether they must be accepted.
pub fn repeated(number: u64) -> Option<(Vec<u8>, bool)> {
    let mut bytes = vec![0x80, 4];
    let is_scene = match number {
        0 => {
            shared_track(&mut bytes, 10);
            scene_of_one_track(&mut bytes, 3, |_| {});
            true
        }
        1 => {
            searched(&mut bytes);
            false
        }
        2 => {
            // Long, but accessed by an index: the work is at most the number of bytes.
            listed(&mut bytes);
            true
        }
        _ => return None,
    };
    bytes.push(b'.');
    Some((bytes, is_scene))
}

/// A standing vehicle of 11 frames as memo entry 0, its columns behind `keys` meaningless keys.
fn shared_track(bytes: &mut Vec<u8>, keys: u32) {
    let column = |bytes: &mut Vec<u8>, name: &str, cell: &[u8]| {
        text(bytes, name);
        bytes.extend(b"](");
        (0..11).for_each(|_| bytes.extend(cell));
        bytes.push(b'e');
    };
    bytes.extend(b"}(");
    text(bytes, "type");
    text(bytes, "VEHICLE");
    text(bytes, "state");
    bytes.extend(b"}(");
    for k in 0..keys {
        text(bytes, &format!("{k:06}"));
        bytes.push(b'N');
    }
    column(bytes, "position", b"K\x00K\x00K\x00\x87");
    column(bytes, "velocity", b"K\x00K\x00\x86");
    for name in ["heading", "valid", "length", "width"] {
        column(bytes, name, b"K\x01");
    }
    bytes.extend(b"uu\x940");
}

/// A scene with that vehicle many times, and more metadata.
fn scene_of_one_track(bytes: &mut Vec<u8>, tracks: u32, metadata: impl Fn(&mut Vec<u8>)) {
    bytes.extend(b"}(");
    text(bytes, "length");
    bytes.extend(b"K\x0b");
    text(bytes, "metadata");
    bytes.extend(b"}(");
    text(bytes, "sdc_id");
    text(bytes, "0");
    metadata(bytes);
    bytes.push(b'u');
    text(bytes, "tracks");
    bytes.extend(b"}(");
    for k in 0..tracks {
        text(bytes, &k.to_string());
        bytes.extend(b"h\x00");
    }
    bytes.extend(b"uu");
}
