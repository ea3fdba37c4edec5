//! Tests of `gru`.

use candle_core::{DType, WithDType};
use sage_core::seed::Rng;

use super::*;
use crate::Parameters;

const INPUTS: usize = 3;
const UNITS: usize = 4;
const NAMES: [&str; 4] = ["weight_ih", "weight_hh", "bias_ih", "bias_hh"];

fn gru(parameters: &Parameters) -> Gru {
    Gru::new(&Scope::of(parameters), INPUTS, UNITS).unwrap()
}

fn parameters() -> Parameters {
    let specs = Scope::list(|scope| Gru::new(scope, INPUTS, UNITS)).unwrap();
    Parameters::start(&specs, 5).unwrap().to_dtype(DType::F64).unwrap()
}

fn sequences() -> Vec<Vec<[f64; INPUTS]>> {
    let mut rng = Rng::new(1, "inputs", "test");
    [2, 5, 1, 5, 3].map(|steps| (0..steps).map(|_| [(); INPUTS].map(|()| rng.normal())).collect()).into()
}

fn forward<T: WithDType>(gru: &Gru, sequences: &[Vec<[T; INPUTS]>]) -> Tensor {
    let slices: Vec<&[[T; INPUTS]]> = sequences.iter().map(Vec::as_slice).collect();
    gru.forward(Sequences::new(&slices).unwrap()).unwrap()
}

/// The equations of the module, in candle's own operations, for one sequence after the other.
fn definition(parameters: &Parameters, sequences: &[Vec<[f64; INPUTS]>]) -> Result<Tensor> {
    let of = |name: &str| parameters.get(name).unwrap();
    let sigmoid = |x: Tensor| (x.neg()?.exp()? + 1.0)?.recip();
    let mut last = Vec::new();
    for sequence in sequences {
        let mut state = Tensor::zeros((1, UNITS), DType::F64, &Device::Cpu)?;
        for row in sequence {
            let x = Tensor::from_slice(row, (1, INPUTS), &Device::Cpu)?;
            let input = x.matmul(&of("weight_ih").t()?)?.broadcast_add(of("bias_ih"))?;
            let hidden = state.matmul(&of("weight_hh").t()?)?.broadcast_add(of("bias_hh"))?;
            let parts = |k: usize| [&input, &hidden].map(|x| x.narrow(1, UNITS * k, UNITS).unwrap());
            let gate = |k: usize| {
                let [input, hidden] = parts(k);
                sigmoid((input + hidden)?)
            };
            let (reset, update) = (gate(0)?, gate(1)?);
            let [input, hidden] = parts(2);
            let candidate = (input + (reset * hidden)?)?.tanh()?;
            state = ((update.affine(-1.0, 1.0)? * candidate)? + (update * state)?)?;
        }
        last.push(state);
    }
    Tensor::cat(&last, 0)
}

fn numbers(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

fn distance(a: &Tensor, b: &Tensor) -> f64 {
    assert_eq!(a.dims(), b.dims());
    numbers(a).iter().zip(numbers(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// A sum with another weight for each number, which shows rows in the wrong order.
fn weighted(states: &Tensor) -> Tensor {
    let weights: Vec<f64> = (0..states.elem_count()).map(|k| f64::from(k as u32 + 1).sin()).collect();
    let weights = Tensor::from_vec(weights, states.shape(), &Device::Cpu).unwrap();
    (states.sqr().unwrap() * weights).unwrap().sum_all().unwrap()
}

#[test]
fn states_and_gradients_equal_those_of_the_definition() {
    let (traced, variables) = parameters().variables(|_| true).unwrap();
    let found = forward(&gru(&traced), &sequences());
    let expected = definition(&traced, &sequences()).unwrap();
    assert!(distance(&found, &expected) < 1e-14);
    let plain = forward(&gru(&traced.detached()), &sequences());
    assert_eq!(distance(&plain, &found), 0.0);
    let [found, expected] = [found, expected].map(|states| weighted(&states).backward().unwrap());
    for (name, variable) in variables.iter() {
        let distance = distance(found.get(variable).unwrap(), expected.get(variable).unwrap());
        assert!(distance < 1e-14, "{name}: {distance}");
    }
}

#[test]
fn gradients_equal_differences() {
    let (traced, variables) = parameters().variables(|_| true).unwrap();
    let loss = |parameters: &Parameters| weighted(&forward(&gru(parameters), &sequences()));
    let store = loss(&traced).backward().unwrap();
    for (name, variable) in variables.iter() {
        for (index, gradient) in numbers(store.get(variable).unwrap()).into_iter().enumerate() {
            let at = |step: f64| -> f64 {
                let mut values = numbers(&variable.as_detached_tensor());
                values[index] += step;
                let mut moved = traced.detached();
                moved.insert(name, Tensor::from_vec(values, variable.dims(), &Device::Cpu).unwrap());
                loss(&moved).to_scalar().unwrap()
            };
            let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
            assert!((gradient - difference).abs() < 1e-9, "{name} {index}: {gradient} {difference}");
        }
    }
}

/// Number k of all weights, in the order of [`NAMES`], is sin k; number j of a sequence is cos (first + j). The
/// loss is the sum of `unit · state` over the units 1 to 4 and all sequences. torch 2's `nn.GRU` in `f64` gives
/// these states, and these sums of `gradient[k] · cos k`.
#[test]
fn states_and_gradients_are_those_of_pytorch() {
    const STATES: [[f64; UNITS]; 3] = [
        [0.11655434632727013, -0.3231856363986878, -0.24784150288534812, -0.3665612505178998],
        [-0.4826948197767247, -0.47681790921076395, -0.18280696574914002, 0.6369789151086611],
        [-0.36156980396524335, -0.21923479543312807, -0.07885488048264877, 0.3122358539992519],
    ];
    const GRADIENTS: [f64; 4] =
        [11.206642265171322, -1.930720186776003, -1.928683779400675, -0.9218449524172365];
    let mut all = parameters();
    let mut next = (0..).map(|k: u32| f64::from(k).sin());
    for name in NAMES {
        let shape = all.get(name).unwrap().shape().clone();
        let values: Vec<f64> = next.by_ref().take(shape.elem_count()).collect();
        all.insert(name, Tensor::from_vec(values, shape, &Device::Cpu).unwrap());
    }
    let sequence = |(steps, first): (u32, u32)| -> Vec<[f64; INPUTS]> {
        let row = |step: u32| [0, 1, 2].map(|j| f64::from(first + 3 * step + j).cos());
        (0..steps).map(row).collect()
    };
    let sequences = [(2, 0), (5, 100), (1, 200)].map(sequence);
    let narrow: Vec<Vec<[f32; INPUTS]>> =
        sequences.iter().map(|rows| rows.iter().map(|row| row.map(|x| x as f32)).collect()).collect();
    for (dtype, bound) in [(DType::F64, 1e-12), (DType::F32, 1e-6)] {
        let (traced, variables) = all.to_dtype(dtype).unwrap().variables(|_| true).unwrap();
        let states = match dtype {
            DType::F64 => forward(&gru(&traced), &sequences),
            _ => forward(&gru(&traced), &narrow),
        };
        for (found, expected) in numbers(&states).iter().zip(STATES.as_flattened()) {
            assert!((found - expected).abs() < bound, "{dtype:?}: {found} and {expected}");
        }
        let units = Tensor::new(&[1.0, 2.0, 3.0, 4.0], &Device::Cpu).unwrap().to_dtype(dtype).unwrap();
        let loss = states.broadcast_mul(&units).unwrap().sum_all().unwrap();
        let store = loss.backward().unwrap();
        for (name, expected) in NAMES.iter().zip(GRADIENTS) {
            let variable = variables.iter().find(|(own, _)| own == name).unwrap().1;
            let gradient = numbers(store.get(variable).unwrap());
            let found: f64 = gradient.iter().zip(0_u32..).map(|(g, k)| g * f64::from(k).cos()).sum();
            // The sums are of up to 48 numbers of size 1.
            assert!((found - expected).abs() < 10.0 * bound, "{dtype:?} {name}: {found} and {expected}");
        }
    }
}
