//! Own layers and optimiser beside those of candle-nn, forward and with gradients, in one run. If cargo starts it, candle uses one
//! thread.

use criterion::{Criterion, criterion_group, criterion_main};
use sage_backbones::{
    Parameters,
    candle::{D, Device, Module, Result, Tensor, Var},
    candle_nn::{self, GRUConfig, LSTMConfig, ModuleT, Optimizer, RNN, ops},
    nn::{AdamW, AdamWConfig, Attention, BatchNorm, Gru, Linear, Lstm, Mlp, Sequences, log_softmax},
    parameters::Scope,
};
use sage_core::seed::Rng;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Goals of a scene, width of the states.
const GOALS: [usize; 2] = [2000, WIDTH];
const WIDTH: usize = 64;
/// Windows of driving of 10 steps, numbers a step and width of the state, as SEAL encodes them.
const WINDOWS: [usize; 2] = [64, 10];
const OF_WINDOW: [usize; 2] = [103, 256];
/// Drives of 80 steps, numbers a step and width of the state, as GOOSE encodes them.
const DRIVES: [usize; 2] = [16, 80];
const OF_DRIVE: [usize; 2] = [40, 128];

type Forward = Box<dyn Fn(&Tensor) -> Result<Tensor>>;

/// Own and candle's layer from a scope.
struct Pair {
    name: &'static str,
    /// Rows and columns of its input.
    input: [usize; 2],
    own: fn(&Scope) -> Result<Forward>,
    candle: fn(&Scope) -> Result<Forward>,
}

const PAIRS: [Pair; 7] = [
    Pair {
        name: "linear",
        input: GOALS,
        own: |scope| {
            let layer = Linear::new(scope, WIDTH, WIDTH)?;
            Ok(Box::new(move |x| layer.forward(x)))
        },
        candle: |scope| {
            let layer = candle_nn::linear(WIDTH, WIDTH, scope.var_builder())?;
            Ok(Box::new(move |x| layer.forward(x)))
        },
    },
    Pair {
        name: "linear, layer norm, ReLU",
        input: GOALS,
        own: |scope| {
            let layer = Mlp::new(scope, WIDTH, WIDTH)?;
            Ok(Box::new(move |x| layer.forward(x)))
        },
        // The fused layer norm of candle-nn drops gradients; this form is the one that trains.
        candle: |scope| {
            let linear = candle_nn::linear(WIDTH, WIDTH, scope.at("linear").var_builder())?;
            let norm = candle_nn::layer_norm(WIDTH, 1e-5, scope.at("layer_norm").var_builder())?;
            let [weight, bias] = [Some(norm.weight()), norm.bias()].map(|tensor| tensor.cloned());
            let (Some(weight), Some(bias)) = (weight, bias) else { unreachable!("a layer norm with both") };
            Ok(Box::new(move |x| ops::layer_norm_slow(&linear.forward(x)?, &weight, &bias, 1e-5)?.relu()))
        },
    },
    Pair {
        name: "attention to 200 states",
        input: GOALS,
        own: |scope| {
            let layer = Attention::across(scope, WIDTH, WIDTH)?;
            Ok(Box::new(move |x| layer.forward(x, &x.narrow(0, 0, 200)?)))
        },
        candle: |scope| {
            let linear = |name| candle_nn::linear(WIDTH, WIDTH, scope.at(name).var_builder());
            let [query, key, value] = [linear("query")?, linear("key")?, linear("value")?];
            Ok(Box::new(move |x| {
                let states = x.narrow(0, 0, 200)?;
                let scores = query.forward(x)?.matmul(&key.forward(&states)?.t()?)?;
                ops::softmax(&(scores / (WIDTH as f64).sqrt())?, D::Minus1)?.matmul(&value.forward(&states)?)
            }))
        },
    },
    Pair {
        name: "log softmax of 128 000 numbers",
        input: GOALS,
        own: |_| Ok(Box::new(|x| log_softmax(&x.flatten_all()?))),
        candle: |_| Ok(Box::new(|x| ops::log_softmax(&x.flatten_all()?, 0))),
    },
    Pair {
        name: "batch norm in training",
        input: [WINDOWS[0], OF_WINDOW[1]],
        own: |scope| {
            let layer = BatchNorm::new(scope, OF_WINDOW[1])?;
            Ok(Box::new(move |x| layer.forward_training(x)))
        },
        candle: |scope| {
            let layer = candle_nn::batch_norm(OF_WINDOW[1], 1e-5, scope.var_builder())?;
            Ok(Box::new(move |x| layer.forward_t(x, true)))
        },
    },
    Pair {
        name: "LSTM",
        input: [WINDOWS[0] * WINDOWS[1], OF_WINDOW[0]],
        own: |scope| {
            let layer = Lstm::new(scope, OF_WINDOW[0], OF_WINDOW[1])?;
            Ok(Box::new(move |x| layer.forward(x, WINDOWS[1])))
        },
        candle: |scope| {
            let layer =
                candle_nn::lstm(OF_WINDOW[0], OF_WINDOW[1], LSTMConfig::default(), scope.var_builder())?;
            Ok(Box::new(move |x| last(&layer, x, WINDOWS[0], |state| state.h())))
        },
    },
    Pair {
        name: "GRU",
        input: [DRIVES[0] * DRIVES[1], OF_DRIVE[0]],
        own: |scope| {
            let layer = Gru::new(scope, OF_DRIVE[0], OF_DRIVE[1])?;
            Ok(Box::new(move |x| {
                let [drives, steps] = DRIVES;
                let order = (0..drives).collect();
                layer.forward(Sequences { inputs: x.clone(), counts: vec![drives; steps], order })
            }))
        },
        candle: |scope| {
            let layer = candle_nn::gru(OF_DRIVE[0], OF_DRIVE[1], GRUConfig::default(), scope.var_builder())?;
            Ok(Box::new(move |x| last(&layer, x, DRIVES[0], |state| state.h())))
        },
    },
];

/// The state after the last step, with all rows of the first step first. The input needs no gradient.
fn last<R: RNN>(layer: &R, x: &Tensor, rows: usize, of: impl Fn(&R::State) -> &Tensor) -> Result<Tensor> {
    let x = x.detach();
    let mut state = layer.zero_state(rows)?;
    for start in (0..x.dim(0)?).step_by(rows) {
        state = layer.step(&x.narrow(0, start, rows)?, &state)?;
    }
    Ok(of(&state).clone())
}

fn noise([rows, columns]: [usize; 2]) -> Tensor {
    let mut rng = Rng::new(0, "", "noise");
    let numbers: Vec<f32> = (0..rows * columns).map(|_| rng.normal() as f32).collect();
    Tensor::from_vec(numbers, (rows, columns), &Device::Cpu).expect("the numbers fit the shape")
}

fn layers(c: &mut Criterion) {
    let mut group = c.benchmark_group("layers");
    for pair in &PAIRS {
        let x = noise(pair.input);
        for (whose, build) in [("own", pair.own), ("candle", pair.candle)] {
            let specs = Scope::list(build).expect("sizes are sound");
            let parameters = Parameters::start(&specs, 0).expect("it is a CPU");
            let (traced, _) = parameters.variables(|_| true).expect("it is a CPU");
            let plain = build(&Scope::of(&parameters)).expect("the parameters fit");
            group.bench_function(format!("{}: forward, {whose}", pair.name), |b| b.iter(|| plain(&x)));
            let traced = build(&Scope::of(&traced)).expect("the parameters fit");
            let x = Var::from_tensor(&x).expect("it is a CPU");
            group.bench_function(format!("{}: with gradients, {whose}", pair.name), |b| {
                b.iter(|| traced(x.as_tensor())?.sum_all()?.backward());
            });
        }
    }
    group.finish();
}

fn optimisers(c: &mut Criterion) {
    let mut group = c.benchmark_group("optimisers");
    let weights = Parameters::from_iter([("w".to_owned(), noise(GOALS))]);
    let gradient: Vec<f32> = vec![0.01; GOALS[0] * GOALS[1]];
    let mut own = AdamW::new(AdamWConfig::default());
    let mut values = gradient.clone();
    group.bench_function("AdamW, 128 000 weights: own", |b| {
        b.iter(|| {
            own.begin_step();
            own.update("w", &mut values, &gradient, 1e-4);
        });
    });
    let (traced, variables) = weights.variables(|_| true).expect("it is a CPU");
    let loss = (traced.get("w").expect("it is there") * 0.01).and_then(|x| x.sum_all()).expect("a sum");
    let store = loss.backward().expect("it has a gradient");
    let all = variables.iter().map(|(_, variable)| variable.clone()).collect();
    let mut candle = candle_nn::AdamW::new_lr(all, 1e-4).expect("it is a CPU");
    group.bench_function("AdamW, 128 000 weights: candle", |b| b.iter(|| candle.step(&store)));
    group.finish();
}

criterion_group!(benches, layers, optimisers);
criterion_main!(benches);
