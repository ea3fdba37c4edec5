//! Training: the same bits on any number of threads and across interruptions, and clear errors.
#![allow(clippy::unwrap_used)]

use std::{path::Path, sync::Arc};

use candle_core::{Device, Tensor};
use insta::assert_snapshot;
use sage_backbones::{
    Backbone, Error, Parameters, backbones,
    nn::AdamWConfig,
    parameters::Header,
    training::{
        EpochRow, Examples, Observer, PretrainOptions, Pretrained, Trainer, pretrain, role_assignments,
        trainable,
    },
};
use sage_core::{
    geometry::distance,
    motion::NOW,
    scene::{Held, Scene, SceneData},
    seed::Rng,
};
use sage_data::procedural::{Kind, generate};

fn scenes(count: u64, seed: u64) -> Vec<SceneData> {
    let scene = |k: u64| {
        let scene = generate(Kind::ALL[k as usize % 6], seed, k).unwrap();
        SceneData::new(scene.id.clone(), scene)
    };
    (0..count).map(scene).collect()
}

/// A small network, for fast tests.
fn network(name: &str) -> Box<dyn Backbone> {
    backbones().unwrap().build(name, &serde_json::json!({"hidden": 16, "rounds": 1})).unwrap()
}

fn options() -> PretrainOptions {
    PretrainOptions { epochs: 3, batch: 8, ..PretrainOptions::default() }
}

struct Silent {
    steps: usize,
    stop_after: usize,
    epochs: Vec<EpochRow>,
}

impl Silent {
    fn new(stop_after: usize) -> Self {
        Self { steps: 0, stop_after, epochs: Vec::new() }
    }
}

impl Observer for Silent {
    fn step(&mut self, _epoch: u32, _step: usize, _steps: usize, _loss: f64) {
        self.steps += 1;
    }
    fn epoch(&mut self, row: &EpochRow) {
        self.epochs.push(row.clone());
    }
    fn stops(&self) -> bool {
        self.steps >= self.stop_after
    }
}

fn train(network: &dyn Backbone, folder: &Path, stop_after: usize) -> Result<Pretrained, Error> {
    let header = Header { backbone: network.name().to_owned(), ..Header::default() };
    let (scenes, dev) = (scenes(2, 3), scenes(2, 4));
    pretrain(network, &scenes, &dev, &options(), &header, folder, &mut Silent::new(stop_after))
}

fn bytes(weights: &Parameters) -> Vec<u8> {
    weights.to_bytes(&Header::default()).unwrap()
}

#[test]
fn three_steps_give_the_same_bits_on_one_two_and_three_threads() {
    let data = scenes(3, 8);
    let examples = Examples::of(&data);
    for name in ["densetnt", "query-transformer", "diffusion"] {
        let network = network(name);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let trained = |name: &str| network.parameter_group(name).is_pretrained();
                let mut trainer = Trainer::new(&*network, trained, AdamWConfig::default()).unwrap();
                for batch in examples.list().chunks(7).take(3) {
                    let gradient = |example: &_| {
                        let sample = examples.sample(example, trainer.trainable()?, true)?;
                        trainer.gradient(
                            &trainer.trainable().unwrap().loss(&sample, &mut Rng::new(0, "", "loss"))?,
                            "test",
                        )
                    };
                    let gradients = trainer.gradients(batch, gradient).unwrap();
                    trainer.update(&gradients, 1e-3, 5.0).unwrap();
                }
                assert_eq!(trainer.adam.steps, 3);
                bytes(&trainer.weights().unwrap())
            })
        };
        let one = run(1);
        assert_ne!(one, bytes(network.parameters()));
        assert!(one == run(2) && one == run(3), "{name}: bits depend on the number of threads");
    }
}

#[test]
fn an_interrupted_training_resumes_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, parts] = ["whole", "parts"].map(|name| folder.path().join(name));
    std::fs::create_dir(&whole).unwrap();
    std::fs::create_dir(&parts).unwrap();
    let network = network("densetnt");
    let reference = train(&*network, &whole, usize::MAX).unwrap();
    assert!(!reference.stopped);
    let steps = reference.rows.iter().map(|r| r.steps).max().unwrap() as usize / 3;
    // Stopped in the second epoch, then in the third, then run to its end.
    for stop_after in [steps + 2, steps + 1] {
        assert!(train(&*network, &parts, stop_after).unwrap().stopped);
    }
    let resumed = train(&*network, &parts, usize::MAX).unwrap();
    assert_eq!(bytes(&resumed.best.unwrap()), bytes(reference.best.as_ref().unwrap()));
    let figures = |rows: &[EpochRow]| {
        rows.iter().map(|r| (r.steps, r.goal, r.trajectory, r.min_fde6)).collect::<Vec<_>>()
    };
    assert_eq!(figures(&resumed.rows), figures(&reference.rows));
    let prior = |folder: &Path| std::fs::read(folder.join("prior.safetensors")).unwrap();
    assert_eq!(prior(&whole), prior(&parts));
    let first = reference.rows.first().unwrap();
    assert!(reference.rows.last().unwrap().goal < first.goal, "it learns");
}

#[test]
fn a_folder_of_another_run_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    train(&*network("densetnt"), folder.path(), usize::MAX).unwrap();
    let error = train(&*network("query-transformer"), folder.path(), usize::MAX).err().unwrap().to_string();
    assert_snapshot!(error.replace(&folder.path().display().to_string(), "[folder]"), @"`[folder]/last.safetensors`: belongs to a run with other options or data; give another folder or remove it");
}

#[test]
fn a_number_that_is_not_finite_stops_with_scene_step_and_tensor_and_does_not_change_the_prior() {
    let folder = tempfile::tempdir().unwrap();
    let network = network("densetnt");
    let mut weights = network.parameters().clone();
    let broken = Tensor::full(f32::NAN, 16, &Device::Cpu).unwrap();
    weights.insert("decoder.goals_2D_mlps.1.linear.bias", broken);
    let network = network.load_parameters(weights, "test").unwrap();
    std::fs::write(folder.path().join("prior.safetensors"), "earlier").unwrap();
    let error = train(&*network, folder.path(), usize::MAX).err().unwrap().to_string();
    assert!(error.starts_with("epoch 1, step 1, scene `") && error.contains("agent `"), "{error}");
    assert!(error.ends_with("the loss `trajectory` is NaN"), "{error}");
    assert_eq!(std::fs::read(folder.path().join("prior.safetensors")).unwrap(), b"earlier");
}

#[test]
fn a_gradient_that_is_not_finite_names_its_tensor() {
    let data = scenes(1, 9);
    let network = network("densetnt");
    let trainer = Trainer::new(&*network, |_| true, AdamWConfig::default()).unwrap();
    let examples = Examples::of(&data);
    let sample = examples.sample(&examples.list()[0], trainer.trainable().unwrap(), false).unwrap();
    let mut loss = trainer.trainable().unwrap().loss(&sample, &mut Rng::new(0, "", "loss")).unwrap();
    loss.total = (loss.total * f64::INFINITY).unwrap();
    let error = trainer.gradient(&loss, "epoch 2, step 5, scene `x`").err().unwrap().to_string();
    assert!(error.starts_with("epoch 2, step 5, scene `x`: the gradient of `decoder."), "{error}");
}

#[test]
fn a_parameter_that_no_gradient_reaches_is_named() {
    let data = scenes(1, 9);
    let network = network("densetnt");
    let examples = Examples::of(&data);
    let check = |trained: &dyn Fn(&str) -> bool| {
        let trainer = Trainer::new(&*network, trained, AdamWConfig::default()).unwrap();
        let sample = examples.sample(&examples.list()[0], trainer.trainable().unwrap(), false).unwrap();
        let loss = trainer.trainable().unwrap().loss(&sample, &mut Rng::new(0, "", "loss")).unwrap();
        trainer.gradient(&loss, "sample").unwrap();
        trainer.check_reached()
    };
    check(&|name| network.parameter_group(name).is_pretrained()).unwrap();
    let error = check(&|_| true).unwrap_err().to_string();
    assert_snapshot!(error);
}

#[test]
fn scenes_without_a_vehicle_to_train_on_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut still = scenes(1, 3);
    for track in &mut Arc::make_mut(&mut still[0].scene).tracks {
        track.valid.fill(false);
    }
    let network = network("densetnt");
    let error = pretrain(
        &*network,
        &still,
        &scenes(1, 4),
        &options(),
        &Header::default(),
        folder.path(),
        &mut Silent::new(usize::MAX),
    )
    .err()
    .unwrap()
    .to_string();
    assert_snapshot!(error, @"no scene of 1 shows a moving vehicle that is valid at frame 10 and in 30 of the 80 frames after it");
}

#[test]
fn options_out_of_range_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let plain = PretrainOptions::default;
    let wrong = [
        PretrainOptions { batch: 0, ..plain() },
        PretrainOptions { per_scene: 0, ..plain() },
        PretrainOptions { rate: -1.0, ..plain() },
        PretrainOptions { rate: f64::NAN, ..plain() },
        PretrainOptions { clip: -3.0, ..plain() },
        PretrainOptions { epochs: 0, ..plain() },
    ];
    let said = wrong.map(|options| {
        let (train, dev) = (scenes(1, 3), scenes(1, 4));
        let mut silent = Silent::new(usize::MAX);
        let header = Header::default();
        let run =
            pretrain(&*network("densetnt"), &train, &dev, &options, &header, folder.path(), &mut silent);
        run.err().unwrap().to_string()
    });
    assert_snapshot!(said.join("\n"), @r"
    option `batch` is 0; expected 1 to 1000000
    option `per_scene` is 0; expected 1 to 1000000000
    option `rate` is -1; expected 0 to 1
    option `rate` is NaN; expected 0 to 1
    option `clip` is -3; expected 0.000000001 to inf
    option `epochs` is 0; expected 1 to 1000000
    ");
}

#[test]
fn scenes_without_a_vehicle_to_validate_on_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut short = scenes(1, 4);
    for track in &mut Arc::make_mut(&mut short[0].scene).tracks {
        track.valid[90] = false;
    }
    let mut silent = Silent::new(usize::MAX);
    let header = Header::default();
    let run = pretrain(
        &*network("densetnt"),
        &scenes(1, 3),
        &short,
        &options(),
        &header,
        folder.path(),
        &mut silent,
    );
    let error = run.err().unwrap().to_string();
    assert_snapshot!(error, @"no scene of 1 to validate on shows a vehicle that is valid at frames 10 and 90");
}

#[test]
fn the_published_network_trains_too() {
    let data = scenes(1, 8);
    let network = backbones().unwrap().build_default("densetnt-cat").unwrap();
    let examples = Examples::of(&data);
    // Its features cannot be mirrored, so the sample is not mirrored.
    let sample = examples.sample(&examples.list()[0], trainable(&*network).unwrap(), true).unwrap();
    assert!(
        trainable(&*network)
            .unwrap()
            .loss(&sample, &mut Rng::new(0, "", "loss"))
            .unwrap()
            .parts
            .iter()
            .all(|(_, loss)| loss.is_finite())
    );
}

#[test]
fn a_truncated_checkpoint_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let network = network("densetnt");
    train(&*network, folder.path(), usize::MAX).unwrap();
    let path = folder.path().join("last.safetensors");
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() - 10]).unwrap();
    let error = train(&*network, folder.path(), usize::MAX).err().unwrap().to_string();
    assert_snapshot!(error.replace(&folder.path().display().to_string(), "[folder]"), @"`[folder]/last.safetensors`: is no whole file of weights (incomplete metadata, file not fully covered); copy or train it again; remove it to start again");
}

#[test]
fn a_road_user_that_is_held_now_is_no_example_and_has_no_role() {
    let whole = scenes(1, 0);
    let moves = |scene: &Scene, k: usize| {
        let track = &scene.tracks[k];
        track.is_valid(90) && distance(track.point(NOW), track.point(90)) > 10.0 && k != scene.ego
    };
    let k = (0..whole[0].scene.tracks.len()).find(|k| moves(&whole[0].scene, *k)).unwrap();
    let mut scene = (*whole[0].scene).clone();
    let held = Held::between(k, &mut scene.tracks[k], NOW - 2, NOW + 2);
    scene.held.push(held);
    let data = [SceneData::new("held".to_owned(), scene)];
    assert!(Examples::of(&whole).list().iter().any(|example| example.track == k));
    assert!(!Examples::of(&data).list().iter().any(|example| example.track == k));
    let takes = |data: &[SceneData]| {
        let all = role_assignments(&data[0].scene, 20);
        all.iter().any(|scene| scene.ego == k || scene.adversary == Some(k))
    };
    assert!(takes(&whole) && !takes(&data));
}
