// The scene of this crate's examples, as an expression that they include. On a road between edges at y = ±8 m, the ego drives
// along +x at 10 m/s; the adversary drives 20 m ahead, one lane to the left, at 8 m/s. Cars are 4 m × 2 m; *now* is at 1 s.
{
    use sage_core::scene::{AdversaryOrigin, Map, MapFeature, MapKind, Scene, Track, TrackKind};

    let car = |id: &str, [x, y]: [f64; 2], speed: f64| Track {
        id: id.to_owned(),
        kind: TrackKind::Vehicle,
        position: (0..91).map(|frame| [x + 0.1 * speed * f64::from(frame - 10), y, 0.75]).collect(),
        heading: vec![0.0; 91],
        velocity: vec![[speed, 0.0]; 91],
        size: vec![[4.0, 2.0, 1.5]; 91],
        valid: vec![true; 91],
    };
    let kind = MapKind::EdgeBoundary;
    let edge = |id: &str, points| MapFeature { id: id.to_owned(), kind: kind.clone(), points, lane: None };
    let points = vec![[-100.0, -8.0, 0.0], [300.0, -8.0, 0.0], [300.0, 8.0, 0.0], [-100.0, 8.0, 0.0]];
    Scene {
        id: "road".to_owned(),
        frames: 91,
        timestamps: Vec::new(),
        tracks: vec![car("ego", [0.0, 0.0], 10.0), car("other", [20.0, 4.0], 8.0)].into(),
        map: Map { points, features: vec![edge("right", 0..2), edge("left", 2..4)] }.into(),
        lights: Vec::new(),
        ego: 0,
        adversary: Some(1),
        adversary_origin: AdversaryOrigin::User,
        notes: Vec::new(),
        held: Vec::new(),
    }
}
