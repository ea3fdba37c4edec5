//! Ready layers of candle-nn and candle-transformers over the parameters of a network.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::collections::HashMap;

use candle_core::{DType, Device, Module, Result, Tensor};
use candle_nn::{
    Conv1dConfig, GRUConfig, LSTMConfig, LayerNormConfig, RNN, VarBuilder, conv1d, embedding, group_norm,
    gru, layer_norm, linear, lstm,
};
use candle_transformers::models::bert::{BertEncoder, Config};
use sage_backbones::{
    Parameters,
    parameters::{Init, Scope},
};
use sage_core::seed::Rng;

const WIDTH: usize = 4;

/// What candle's gradients of a layer are.
#[derive(Clone, Copy, PartialEq)]
enum Gradients {
    Right,
    /// Dropped by a fused operation, without an error.
    Dropped,
    /// Wrong for a batch above 1: the gradient of the weights is a convolution with a kernel that is not contiguous (candle #3836).
    Wrong,
}

/// A layer applied to an input of fixed shape.
struct Case {
    name: &'static str,
    gradients: Gradients,
    forward: fn(VarBuilder, &Tensor) -> Result<Tensor>,
    /// (batch, channels, length).
    input: [usize; 3],
}

const CASES: [Case; 10] = [
    Case {
        name: "linear",
        gradients: Gradients::Right,
        forward: |vb, x| linear(WIDTH, 3, vb)?.forward(x),
        input: [2, 5, WIDTH],
    },
    Case {
        name: "layer norm without bias",
        gradients: Gradients::Right,
        forward: |vb, x| {
            let config = LayerNormConfig { affine: false, ..LayerNormConfig::default() };
            layer_norm(WIDTH, config, vb)?.forward(x)
        },
        input: [2, 5, WIDTH],
    },
    Case {
        name: "convolution",
        gradients: Gradients::Right,
        forward: |vb, x| conv1d(WIDTH, 3, 3, Conv1dConfig::default(), vb)?.forward(x),
        input: [1, WIDTH, 6],
    },
    Case {
        name: "convolution of a batch",
        gradients: Gradients::Wrong,
        forward: |vb, x| conv1d(WIDTH, 3, 3, Conv1dConfig::default(), vb)?.forward(x),
        input: [2, WIDTH, 6],
    },
    Case {
        name: "group norm",
        gradients: Gradients::Right,
        forward: |vb, x| group_norm(2, WIDTH, 1e-5, vb)?.forward(x),
        input: [2, WIDTH, 6],
    },
    Case {
        name: "embedding",
        gradients: Gradients::Right,
        forward: |vb, _| {
            let rows = Tensor::new(&[0_u32, 2, 2], &Device::Cpu)?;
            embedding(3, WIDTH, vb)?.forward(&rows)
        },
        input: [1, 1, 1],
    },
    Case {
        name: "LSTM",
        gradients: Gradients::Right,
        forward: |vb, x| {
            let layer = lstm(WIDTH, 3, LSTMConfig::default(), vb)?;
            layer.states_to_tensor(&layer.seq(x)?)
        },
        input: [2, 5, WIDTH],
    },
    Case {
        name: "GRU",
        gradients: Gradients::Right,
        forward: |vb, x| {
            let layer = gru(WIDTH, 3, GRUConfig::default(), vb)?;
            layer.states_to_tensor(&layer.seq(x)?)
        },
        input: [2, 5, WIDTH],
    },
    Case {
        name: "layer norm",
        gradients: Gradients::Dropped,
        forward: |vb, x| layer_norm(WIDTH, 1e-5, vb)?.forward(x),
        input: [2, 5, WIDTH],
    },
    Case {
        name: "BERT",
        gradients: Gradients::Dropped,
        forward: |vb, x| {
            let sizes = (WIDTH, 6);
            let config = Config {
                hidden_size: sizes.0,
                intermediate_size: sizes.1,
                num_hidden_layers: 1,
                num_attention_heads: 2,
                ..Config::default()
            };
            let mask = Tensor::zeros((1, 1, 1, x.dim(1)?), x.dtype(), x.device())?;
            BertEncoder::load(vb, &config)?.forward(x, &mask)
        },
        input: [2, 5, WIDTH],
    },
];

fn input(case: &Case, dtype: DType) -> Tensor {
    let mut rng = Rng::new(1, case.name, "input");
    let values: Vec<f64> = (0..case.input.iter().product()).map(|_| rng.normal()).collect();
    Tensor::from_vec(values, case.input.as_slice(), &Device::Cpu).unwrap().to_dtype(dtype).unwrap()
}

fn forward(case: &Case, scope: &Scope) -> Tensor {
    let dtype = scope.var_builder().dtype();
    (case.forward)(scope.at("part").at(0).var_builder(), &input(case, dtype)).unwrap()
}

/// Initial values with noise, so that none is zero.
fn start(case: &Case, dtype: DType) -> Parameters {
    let specs = Scope::list(|scope| Ok(forward(case, scope))).unwrap();
    let noisy = |(name, tensor): (&str, &Tensor)| {
        let mut rng = Rng::new(2, name, "noise");
        let numbers = tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let numbers: Vec<f64> = numbers.into_iter().map(|x| f64::from(x) + 0.1 * rng.normal()).collect();
        (name.to_owned(), Tensor::from_vec(numbers, tensor.dims(), &Device::Cpu).unwrap())
    };
    let start: Parameters = Parameters::start(&specs, 5).unwrap().iter().map(noisy).collect();
    start.to_dtype(dtype).unwrap()
}

fn bits(tensor: &Tensor) -> Vec<u64> {
    let numbers = tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1::<f64>().unwrap();
    numbers.into_iter().map(f64::to_bits).collect()
}

#[test]
fn a_ready_layer_reads_named_parameters_and_computes_what_candle_computes() {
    for case in &CASES {
        let parameters = start(case, DType::F32);
        assert!(parameters.iter().all(|(name, _)| name.starts_with("part.0.")), "{}", case.name);
        let tensors: HashMap<String, Tensor> =
            parameters.iter().map(|(name, tensor)| (name.to_owned(), tensor.clone())).collect();
        let theirs = VarBuilder::from_tensors(tensors, DType::F32, &Device::Cpu).pp("part.0");
        let theirs = (case.forward)(theirs, &input(case, DType::F32)).unwrap();
        assert_eq!(bits(&forward(case, &Scope::of(&parameters))), bits(&theirs), "{}", case.name);
    }
}

#[test]
fn gradients_of_ready_layers_equal_differences_or_are_known_not_to() {
    for case in &CASES {
        let mut worst = 0.0_f64;
        // The fused operations of candle have no double precision.
        let dtype = if case.gradients == Gradients::Dropped { DType::F32 } else { DType::F64 };
        let weights = start(case, dtype);
        let loss = |parameters: &Parameters| {
            let y = forward(case, &Scope::of(parameters));
            let mut rng = Rng::new(4, case.name, "weights of the loss");
            let weights: Vec<f64> = (0..y.elem_count()).map(|_| rng.normal()).collect();
            let weights = Tensor::from_vec(weights, y.dims(), &Device::Cpu).unwrap().to_dtype(dtype).unwrap();
            (y.sqr().unwrap() * weights).unwrap().sum_all().unwrap()
        };
        let (traced, variables) = weights.variables(|_| true).unwrap();
        let store = loss(&traced).backward().unwrap();
        for (name, variable) in variables.iter() {
            let gradient = store.get(variable);
            assert_eq!(gradient.is_none(), case.gradients == Gradients::Dropped, "{}: {name}", case.name);
            let Some(gradient) = gradient else { continue };
            let gradient = gradient.flatten_all().unwrap().to_vec1::<f64>().unwrap();
            let numbers = variable.as_detached_tensor().flatten_all().unwrap().to_vec1::<f64>().unwrap();
            for k in (0..numbers.len()).step_by(3) {
                let at = |step: f64| -> f64 {
                    let mut moved = numbers.clone();
                    moved[k] += step;
                    let mut parameters = weights.clone();
                    let moved = Tensor::from_vec(moved, variable.dims(), &Device::Cpu).unwrap();
                    parameters.insert(name, moved);
                    loss(&parameters).to_scalar().unwrap()
                };
                let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
                worst = worst.max((gradient[k] - difference).abs() / (1.0 + difference.abs()));
            }
        }
        assert_eq!(worst < 1e-6, case.gradients != Gradients::Wrong, "{}: {worst}", case.name);
    }
}

#[test]
fn initial_values_follow_what_a_layer_asks_for() {
    let specs = Scope::list(|scope| {
        let vb = scope.var_builder();
        linear(WIDTH, 3, vb.pp("linear"))?;
        group_norm(2, WIDTH, 1e-5, vb.pp("norm"))?;
        embedding(3, WIDTH, vb.pp("rows"))
    })
    .unwrap();
    let init = |name: &str| specs.iter().find(|spec| spec.name == name).unwrap().init;
    // candle-nn's linear layers: He et al. for the weight, ±1/√inputs for the bias.
    assert_eq!(init("linear.weight"), Init::Normal(0.0, 2.0_f64.sqrt() / (WIDTH as f64).sqrt()));
    assert_eq!(init("linear.bias"), Init::Between(-0.5, 0.5));
    assert_eq!(init("norm.weight"), Init::Constant(1.0));
    assert_eq!(init("rows.weight"), Init::Normal(0.0, 1.0));
    let values = Init::Normal(3.0, 0.5).values(4000, 1, "x");
    let mean = values.iter().sum::<f32>() / 4000.0;
    let deviation = (values.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / 4000.0).sqrt();
    assert!((mean - 3.0).abs() < 0.03 && (deviation - 0.5).abs() < 0.02, "{mean} {deviation}");
    assert_eq!(values, Init::Normal(3.0, 0.5).values(4000, 1, "x"));
    assert_ne!(values, Init::Normal(3.0, 0.5).values(4000, 2, "x"));
}

#[test]
fn two_layers_may_share_a_tensor_and_a_wrong_shape_is_named() {
    let tied = |scope: &Scope| {
        let vb = scope.var_builder();
        linear(WIDTH, WIDTH, vb.pp("a"))?;
        linear(WIDTH, WIDTH, vb.pp("a"))
    };
    let specs = Scope::list(tied).unwrap();
    assert_eq!(specs.len(), 2);
    let parameters = Parameters::start(&specs, 0).unwrap();
    let wrong = linear(3, WIDTH, Scope::of(&parameters).at("a").var_builder()).unwrap_err().to_string();
    assert!(wrong.contains("tensor `a.weight` is [4, 4], expected [4, 3]"), "{wrong}");
    let missing = Scope::of(&parameters).var_builder().get_unchecked("b").unwrap_err().to_string();
    assert!(missing.contains("tensor `b` is missing"), "{missing}");
}
