use super::*;

#[test]
fn a_mean_leaves_out_what_was_not_measured() {
    let samples = Samples::of([Some(1.0), None, Some(4.0), Some(4.0)]);
    let e = samples.estimate(Aggregate::Mean, "x").unwrap();
    assert_eq!((e.value, e.n), (3.0, 3));
    assert!(e.low >= 1.0 && e.low < 3.0 && e.high > 3.0 && e.high <= 4.0, "{e:?}");
    let e = samples.estimate(Aggregate::Median, "x").unwrap();
    assert_eq!((e.value, e.n), (4.0, 3));
    assert!(Samples::of([None, None]).estimate(Aggregate::Mean, "x").is_none());
}

#[test]
fn the_interval_of_a_share_is_wilsons() {
    // 3 of 4: centre (0.75 + z²/8)/(1 + z²/4) with z = 1.96 is 0.627, half width 0.327.
    let samples = Samples::of([Some(1.0), Some(1.0), Some(0.0), Some(1.0), None]);
    let e = samples.estimate(Aggregate::Share, "x").unwrap();
    assert_eq!((e.value, e.n), (0.75, 4));
    assert!((e.low - 0.3006).abs() < 1e-4 && (e.high - 0.9544).abs() < 1e-4, "{e:?}");
}

#[test]
fn weights_are_those_of_the_scenes() {
    // Speeds 2 over 10 steps and 8 over 30 steps: (20 + 240)/40.
    let samples = Samples { seeds: vec![vec![[20.0, 10.0], [240.0, 30.0]]], ..Samples::default() };
    assert_eq!(samples.estimate(Aggregate::Mean, "x").unwrap().value, 6.5);
}

#[test]
fn seeds_are_averaged_after_their_scenes() {
    let seeds = vec![vec![[1.0, 1.0], [0.0, 1.0]], vec![[1.0, 1.0], [1.0, 1.0]]];
    let samples = Samples { seeds, ..Samples::default() };
    let e = samples.estimate(Aggregate::Share, "x").unwrap();
    assert_eq!((e.value, e.n), (0.75, 2));
    // Seed values 0.5 and 1: deviation 0.5/√2.
    assert!((samples.deviation().unwrap() - 0.125f64.sqrt()).abs() < 1e-12);
}

#[test]
fn differences_are_paired_by_scene() {
    let a = Samples::of([Some(10.0), Some(21.0), Some(32.0), None]);
    let b = Samples::of([Some(9.0), Some(20.0), Some(31.0), Some(99.0)]);
    let d = a.less(&b, "x").unwrap();
    // The same in every common scene, so without any spread.
    assert_eq!((d.estimate.value, d.estimate.low, d.estimate.high, d.estimate.n), (1.0, 1.0, 1.0, 3));
    assert_eq!((d.larger, d.seeds_needed), (Some([3, 0]), None));
    assert_eq!(d.p, 1.0 / RESAMPLES as f64);
    assert!(a.less(&Samples::of([None, None, None, Some(1.0)]), "x").is_none());
}

#[test]
fn the_seeds_that_are_needed_follow_from_both_deviations() {
    let method =
        |values: [f64; 2]| Samples { seeds: values.map(|v| vec![[v, 1.0]]).to_vec(), ..Samples::default() };
    // Deviations 0.1/√2 each: variance 0.01; (2.8016)² · 0.01/0.2² = 1.96, at least 2.
    let d = method([0.5, 0.6]).less(&method([0.3, 0.4]), "x").unwrap();
    assert!((d.estimate.value - 0.2).abs() < 1e-12);
    assert_eq!(d.seeds_needed, Some(2));
    // With a difference of 0.05 it is 31.4.
    let d = method([0.35, 0.45]).less(&method([0.3, 0.4]), "x").unwrap();
    assert_eq!(d.seeds_needed, Some(32));
}

#[test]
fn holm_multiplies_by_what_is_left() {
    assert_eq!(holm(&[0.01, 0.04, 0.03]), [0.03, 0.06, 0.06]);
    assert_eq!(holm(&[0.6, 0.9]), [1.0, 1.0]);
}

#[test]
fn intervals_cover_at_their_level() {
    // 300 samples of 40 uniform values: 95 % of the intervals hold 0.5, up to sampling.
    let held = (0..300)
        .filter(|k| {
            let mut rng = Rng::new(*k, "values", "test");
            let samples = Samples::of((0..40).map(|_| Some(rng.uniform(0.0, 1.0))));
            let e = samples.estimate(Aggregate::Mean, "x").unwrap();
            (e.low..=e.high).contains(&0.5)
        })
        .count();
    assert!((270..=298).contains(&held), "{held} of 300");
}
