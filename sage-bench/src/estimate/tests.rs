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

#[test]
fn differences_of_the_same_seeds_are_paired_by_seed() {
    let method = |seeds: [u64; 3], values: [f64; 3]| Samples {
        seeds: values.map(|v| vec![[v, 1.0], [v + 1.0, 1.0]]).to_vec(),
        training_seeds: seeds.to_vec(),
        ..Samples::default()
    };
    let a = method([1, 2, 3], [0.5, 1.5, 4.0]);
    // Differences of 0.5, 0.5 and 0.8 in both scenes, whatever the order of the seeds.
    let d = a.less(&method([3, 1, 2], [3.2, 0.0, 1.0]), "x").unwrap();
    // Their mean is 0.6 and its variance 0.03/3 with 2 degrees of freedom.
    assert!((d.estimate.value - 0.6).abs() < 1e-12);
    assert!((d.estimate.high - d.estimate.value - 4.302_65 * 0.1).abs() < 1e-5, "{d:?}");
    // t = 6: 1 − 6/√38.
    assert!((d.p - (1.0 - 6.0 / 38f64.sqrt())).abs() < 1e-9, "{d:?}");
    // (2.8016)² · 0.03/0.36 is below 1, at least 2.
    assert_eq!(d.seeds_needed, Some(2));
    // Other seeds: variances of seeds add.
    let other = a.less(&method([3, 1, 4], [3.2, 0.0, 1.0]), "x").unwrap();
    assert_eq!(other.estimate.value, d.estimate.value);
    assert!(other.estimate.high > 3.0 && other.p > 0.5, "{other:?}");
}

#[test]
fn a_share_of_several_seeds_without_any_case_has_a_width() {
    let samples = |value: f64| Samples { seeds: vec![vec![[value, 1.0]; 60]; 5], ..Samples::default() };
    // Wilson's of 0 in 60 scenes: up to z²/(60 + z²).
    let none = samples(0.0).estimate(Aggregate::Share, "x").unwrap();
    assert!(none.low == 0.0 && (none.high - 0.0602).abs() < 1e-4, "{none:?}");
    let all = samples(1.0).estimate(Aggregate::Share, "x").unwrap();
    assert!((all.low - 0.9398).abs() < 1e-4 && all.high > 1.0 - 1e-12, "{all:?}");
}

#[test]
fn weights_of_several_seeds_are_those_of_the_scenes() {
    // Values 2 and 4 with weights 1 and 3 in both seeds, and a scene without weight: a mean of 3.5 with linearised values
    // 3.5 − 0.75 and 3.5 + 0.75.
    let seed = vec![[2.0, 1.0], [0.0, 0.0], [12.0, 3.0]];
    let samples = Samples { seeds: vec![seed.clone(), seed], ..Samples::default() };
    assert_eq!(samples.linear(&[0, 2]), vec![vec![2.75, 4.25]; 2]);
    let e = samples.estimate(Aggregate::Mean, "x").unwrap();
    // Scenes alone differ: 0.75 with 1 degree of freedom.
    assert!(e.value == 3.5 && (e.high - e.value - 12.706_2 * 0.75).abs() < 1e-3, "{e:?}");
}
