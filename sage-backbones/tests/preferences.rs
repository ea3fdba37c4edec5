//! Preference tuning of a network whose experts have trajectories of their own: it learns what is preferred, on scenes that it was
//! not tuned on, and faults are noticed.
#![allow(clippy::unwrap_used)]

use candle_core::Tensor;
use sage_backbones::{
    Backbone, Parameters, backbones,
    parameters::Header,
    training::{
        EpochRow, FinetuneOptions, Measures, Observer, PreparedScene, PretrainOptions, Tunes, finetune,
        preference_margin, pretrain, recorded_sample, trainable,
    },
};
use sage_core::{
    objective::{Objective, ObjectiveSpec, feasibilities, rewards},
    scene::SceneData,
    seed::Rng,
    statistics,
};
use sage_data::procedural::{Kind, generate};

fn scenes(count: u64, seed: u64) -> Vec<SceneData> {
    let scene = |k: u64| generate(Kind::ALL[k as usize % Kind::ALL.len()], seed, k);
    let scenes = (0..count).filter_map(scene);
    scenes.map(|scene| SceneData::new(scene.id.clone(), scene)).collect()
}

fn network() -> Box<dyn Backbone> {
    let options = serde_json::json!({"hidden": 16, "rounds": 1, "samples": 32, "steps": 3});
    backbones().unwrap().build("diffusion", &options).unwrap()
}

struct Silent;

impl Observer for Silent {
    fn step(&mut self, _epoch: u32, _step: usize, _steps: usize, _loss: f64) {}
    fn epoch(&mut self, _row: &EpochRow) {}
}

/// A network that knows a little of how cars move.
fn pretrained() -> Box<dyn Backbone> {
    let folder = tempfile::tempdir().unwrap();
    let (network, options) = (network(), PretrainOptions { epochs: 6, ..PretrainOptions::default() });
    let header = Header { backbone: network.name().to_owned(), ..Header::default() };
    let (train, dev) = (scenes(48, 3), scenes(6, 4));
    let done = pretrain(&*network, &train, &dev, &options, &header, folder.path(), &mut Silent).unwrap();
    let first = done.rows.first().unwrap().nll;
    assert!(done.rows.last().unwrap().nll < first, "it learns to denoise what it has not seen");
    network.with_parameters(done.best.unwrap()).unwrap()
}

fn options() -> FinetuneOptions {
    FinetuneOptions {
        candidates: 32,
        max_pairs: 64,
        epochs: 6,
        mirror: false,
        rate: 1e-3,
        weight_decay: 0.0,
        ..FinetuneOptions::default()
    }
}

struct Case {
    prior: Box<dyn Backbone>,
    measures: Measures,
    objective: Objective,
    held_out: Vec<PreparedScene>,
}

impl Case {
    fn of(prior: Box<dyn Backbone>) -> Self {
        let spec = ObjectiveSpec::preset("natural-adversarial").unwrap();
        let (rewards, rules) = (rewards().unwrap(), feasibilities().unwrap());
        let objective = Objective::new(&spec, &rewards, &rules).unwrap();
        let measures = Measures::of(&[&objective], &rewards, &rules).unwrap();
        let held_out = PreparedScene::all(&*prior, &scenes(24, 2), false, &measures, |_, _| ()).unwrap();
        Self { prior, measures, objective, held_out }
    }

    fn tuned(&self, options: &FinetuneOptions) -> Parameters {
        let train =
            PreparedScene::all(&*self.prior, &scenes(48, 1), false, &self.measures, |_, _| ()).unwrap();
        finetune(&*self.prior, &train, &self.measures, &self.objective, options, None, |_| ()).unwrap()
    }

    /// By how much more than the prior a network holds feasible futures of the prior likelier than infeasible ones, without the code
    /// that forms pairs: mean over the scenes that have both, and the lower end of its interval.
    fn gain_of_feasible(&self, network: &dyn Backbone) -> [f64; 2] {
        let of = |scene: &PreparedScene| {
            let modes: Vec<usize> = (0..32).collect();
            let trajectories = self.prior.trajectories(scene.encoding(), &modes).unwrap();
            let likelihoods = |network: &dyn Backbone| -> Vec<f32> {
                let likelihood = trainable(network).unwrap().trajectory_likelihood().unwrap();
                let mut rng = Rng::new(0, "gain", "noise");
                likelihood
                    .log_likelihoods(scene.encoding(), &trajectories, &mut rng)
                    .unwrap()
                    .to_vec1()
                    .unwrap()
            };
            let (own, before) = (likelihoods(network), likelihoods(&*self.prior));
            let mean = |is_feasible: bool| {
                let modes = modes.iter().filter(|mode| scene.table.is_feasible(**mode) == is_feasible);
                statistics::mean(&modes.map(|&mode| f64::from(own[mode] - before[mode])).collect::<Vec<_>>())
            };
            Some(mean(true)? - mean(false)?)
        };
        let gains: Vec<f64> = self.held_out.iter().filter_map(of).collect();
        let [mean, low, _] = interval(&gains);
        [mean, low]
    }

    /// Mean margin over the scenes that the network was not tuned on, and its interval.
    fn margin(&self, network: &dyn Backbone) -> [f64; 3] {
        let expert = self.measures.expert(&self.objective).unwrap();
        let of = |scene| preference_margin(network, &*self.prior, scene, &expert, &options()).unwrap();
        let margins: Vec<f64> = self.held_out.iter().filter_map(of).collect();
        interval(&margins)
    }
}

/// Mean and its 95 % interval by the normal distribution.
fn interval(values: &[f64]) -> [f64; 3] {
    let mean = statistics::mean(values).unwrap();
    let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
    let error = (squares / (values.len() - 1) as f64 / values.len() as f64).sqrt();
    [mean, mean - 1.96 * error, mean + 1.96 * error]
}

#[test]
fn tuning_makes_preferred_futures_likelier_on_scenes_that_it_did_not_see() {
    let case = Case::of(pretrained());
    let weights = case.tuned(&options());
    // The encoder is the prior's; what noise leads to is not.
    for (name, own) in weights.iter() {
        let before = case.prior.parameters().get(name).unwrap();
        let bits = |tensor: &Tensor| tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let is_tuned = case.prior.parameter_group(name).is_finetuned();
        assert!(is_tuned || bits(own) == bits(before), "{name}");
    }
    let tuned = case.prior.with_parameters(weights.clone()).unwrap();
    let [margin, low, _] = case.margin(&*tuned);
    assert!(low > 0.0, "{margin}, from {low}");
    let [gain, low] = case.gain_of_feasible(&*tuned);
    assert!(low > 0.0, "{gain}, from {low}");
    // The frozen prior is what margins are measured from, under the same noise: against itself they are nothing at all. A
    // reference that moves along, or noise of its own for each network, would show here.
    assert_eq!(case.margin(&*case.prior), [0.0; 3]);
    // A preference with the wrong sign would show here: tuned the other way, the margin is below 0.
    let away = |(name, own): (&str, &Tensor)| {
        let before = case.prior.parameters().get(name).unwrap();
        (name.to_owned(), ((before * 2.0).unwrap() - own).unwrap())
    };
    let opposite = case.prior.with_parameters(weights.iter().map(away).collect()).unwrap();
    let [_, _, high] = case.margin(&*opposite);
    assert!(high < 0.0, "{high}");
    assert_eq!(case.tuned(&options()).hash().unwrap(), weights.hash().unwrap(), "the same bits again");
}

#[test]
fn noise_is_that_of_the_sample_in_its_epoch() {
    let data = scenes(1, 3).remove(0);
    let network = network();
    let network = trainable(&*network).unwrap();
    let sample = recorded_sample(&data, data.scene.adversary.unwrap(), network).unwrap();
    let loss = |epoch: &str| network.loss(&sample, &mut Rng::new(0, &data.name, epoch)).unwrap().parts[0].1;
    assert_eq!(loss("first"), loss("first"));
    assert_ne!(loss("first"), loss("second"), "the noise is reused");
}

#[test]
fn an_encoder_is_not_tuned_by_scores_that_a_network_does_not_have() {
    let case = Case::of(network());
    let train = PreparedScene::all(&*case.prior, &scenes(2, 1), false, &case.measures, |_, _| ()).unwrap();
    let options = FinetuneOptions { tunes: Tunes::All, ..options() };
    let error = finetune(&*case.prior, &train, &case.measures, &case.objective, &options, None, |_| ());
    let error = error.unwrap_err().to_string();
    assert!(error.contains("experts of backbone `diffusion` have trajectories of their own"), "{error}");
}
