//! One layer of long short-term memory (Hochreiter and Schmidhuber, 1997), as PyTorch computes it.
//!
//! Inputs of all steps are projected by one product. The recurrent part is one operation with its own gradient, so
//! the gradients of the weights are one product each, not one for each step.

use candle_core::{
    CpuStorage, CustomOp3, DType, Layout, Result, Shape, Tensor, WithDType as _, backend::BackendStorage as _,
};

use super::{
    add_row::{add_row, column_sums},
    real::{Real, by_dtype, sigmoid, tanh, wide, with_slice},
};
use crate::parameters::{Init, Scope};

/// The layer; gates are in the order input, forget, candidate, output.
#[derive(Clone, Debug)]
pub struct Lstm {
    weight_ih: Tensor,
    weight_hh: Tensor,
    bias_ih: Tensor,
    bias_hh: Tensor,
}

impl Lstm {
    /// Takes `weight_ih`, `weight_hh`, `bias_ih` and `bias_hh` from the scope.
    ///
    /// *Errors*: a tensor that is missing or has another shape.
    pub fn new(scope: &Scope, inputs: usize, hidden: usize) -> Result<Self> {
        let tensor =
            |name: &str, shape: &[usize]| scope.tensor(name, shape, Init::Uniform { fan_in: hidden });
        Ok(Self {
            weight_ih: tensor("weight_ih", &[4 * hidden, inputs])?,
            weight_hh: tensor("weight_hh", &[4 * hidden, hidden])?,
            bias_ih: tensor("bias_ih", &[4 * hidden])?,
            bias_hh: tensor("bias_hh", &[4 * hidden])?,
        })
    }

    /// The hidden state after the last step, from a state of zeros. No gradient flows to the inputs.
    ///
    /// *Shapes*: `inputs` (steps · n, inputs), all rows of the first step first; result (n, hidden).
    /// *Errors*: rows that are not a multiple of the steps.
    pub fn forward(&self, inputs: &Tensor, steps: usize) -> Result<Tensor> {
        let bias = (&self.bias_ih + &self.bias_hh)?;
        let trace = Trace::of(
            &inputs.detach(),
            [&self.weight_ih.detach(), &self.weight_hh.detach(), &bias.detach()],
            steps,
        )?;
        if [&self.weight_ih, &self.weight_hh, &bias].iter().any(|tensor| tensor.track_op()) {
            return self.weight_ih.apply_op3(&self.weight_hh, &bias, trace);
        }
        trace.last()
    }
}

/// What the gradient needs of a forward pass: for each step the gates, cells and hidden states.
struct Trace {
    /// Number of sequences.
    n: usize,
    steps: usize,
    /// (steps · n, inputs).
    inputs: Tensor,
    /// (steps · n, 4 hidden), after their activation.
    gates: Tensor,
    /// (steps · n, hidden).
    cells: Tensor,
    /// (steps · n, hidden).
    states: Tensor,
}

impl Trace {
    fn of(inputs: &Tensor, [weight_ih, weight_hh, bias]: [&Tensor; 3], steps: usize) -> Result<Self> {
        let rows = inputs.dim(0)?;
        let width = weight_hh.dim(1)?;
        if steps == 0 || rows == 0 || rows % steps != 0 {
            candle_core::bail!("{rows} rows of an LSTM in {steps} steps");
        }
        let n = rows / steps;
        let device = inputs.device();
        let recurrent = weight_hh.t()?;
        let projected = add_row(&inputs.matmul(&weight_ih.t()?)?, bias)?.flatten_all()?;
        by_dtype!(inputs.dtype(), T => {
            let mut gates = projected.to_vec1::<T>()?;
            let [mut cells, mut states] = [(); 2].map(|()| vec![0 as T; rows * width]);
            for step in 0..steps {
                let gates = &mut gates[step * n * 4 * width..(step + 1) * n * 4 * width];
                let (before, cells) = cells.split_at_mut(step * n * width);
                let (states_before, states) = states.split_at_mut(step * n * width);
                let (cells, states) = (&mut cells[..n * width], &mut states[..n * width]);
                let Some(first) = (step * n * width).checked_sub(n * width) else {
                    wide(#[inline(always)] || forward_step(gates, None, cells, states, width));
                    continue;
                };
                let state = Tensor::from_slice(&states_before[first..], (n, width), device)?;
                with_slice::<T, _>(&state.matmul(&recurrent)?, |product| {
                    let before = Some((product, &before[first..]));
                    wide(#[inline(always)] || forward_step(gates, before, cells, states, width));
                })?;
            }
            Ok(Self {
                n,
                steps,
                inputs: inputs.clone(),
                gates: Tensor::from_vec(gates, (rows, 4 * width), device)?,
                cells: Tensor::from_vec(cells, (rows, width), device)?,
                states: Tensor::from_vec(states, (rows, width), device)?,
            })
        })
    }

    /// (n, hidden): the hidden state after the last step.
    fn last(&self) -> Result<Tensor> {
        self.states.narrow(0, (self.steps - 1) * self.n, self.n)
    }

    /// Gradient with respect to the gates before their activation, from that of the last hidden state.
    ///
    /// *Shapes*: result (steps · n, 4 hidden).
    fn gate_gradients<T: Real>(&self, weight_hh: &Tensor, last: &Tensor) -> Result<Tensor> {
        let width = self.cells.dim(1)?;
        let size = self.n * width;
        let device = last.device();
        let mut gradients = vec![T::zero(); self.steps * 4 * size];
        let mut dstate = last.contiguous()?;
        let mut dcell = vec![T::zero(); size];
        for step in (0..self.steps).rev() {
            let own = &mut gradients[step * 4 * size..(step + 1) * 4 * size];
            with_slice::<T, _>(&dstate, |dstate| {
                with_slice::<T, _>(&self.gates, |gates| {
                    with_slice::<T, _>(&self.cells, |cells| {
                        let gates = &gates[step * 4 * size..(step + 1) * 4 * size];
                        let before = step.checked_sub(1).map(|step| &cells[step * size..(step + 1) * size]);
                        let cells = &cells[step * size..(step + 1) * size];
                        wide(
                            #[inline(always)]
                            || backward_step(gates, before, cells, dstate, &mut dcell, own, width),
                        );
                    })
                })
            })???;
            if step > 0 {
                dstate = Tensor::from_slice(own, (self.n, 4 * width), device)?.matmul(weight_hh)?;
            }
        }
        Tensor::from_vec(gradients, (self.steps * self.n, 4 * width), device)
    }
}

/// One step: activates the gates, and computes cells and states. `before` holds the recurrent product and the cells of
/// the step before, unless the step is the first.
#[inline(always)]
fn forward_step<T: Real>(
    gates: &mut [T],
    before: Option<(&[T], &[T])>,
    cells: &mut [T],
    states: &mut [T],
    width: usize,
) {
    if let Some((product, previous)) = before {
        for (gate, product) in gates.iter_mut().zip(product) {
            *gate += *product;
        }
        cells.copy_from_slice(previous);
    }
    let rows = cells.chunks_exact_mut(width).zip(states.chunks_exact_mut(width));
    for (gates, (cells, states)) in gates.chunks_exact_mut(4 * width).zip(rows) {
        let (input, rest) = gates.split_at_mut(width);
        let (forget, rest) = rest.split_at_mut(width);
        let (candidate, output) = rest.split_at_mut(width);
        let inner = input.iter_mut().zip(forget).zip(candidate.iter_mut().zip(output));
        for (((i, f), (g, o)), (cell, state)) in inner.zip(cells.iter_mut().zip(states)) {
            (*i, *f, *g, *o) = (sigmoid(*i), sigmoid(*f), tanh(*g), sigmoid(*o));
            *cell = *f * *cell + *i * *g;
            *state = *o * tanh(*cell);
        }
    }
}

/// Gradients of the gates of one step. `dcell` is the gradient of the step's cells when the function is called, and
/// that of the cells before when it returns.
#[inline(always)]
fn backward_step<T: Real>(
    gates: &[T],
    before: Option<&[T]>,
    cells: &[T],
    dstate: &[T],
    dcell: &mut [T],
    gradients: &mut [T],
    width: usize,
) {
    let one = T::one();
    let none = vec![T::zero(); width];
    for (row, (gates, own)) in
        gates.chunks_exact(4 * width).zip(gradients.chunks_exact_mut(4 * width)).enumerate()
    {
        let span = row * width..(row + 1) * width;
        let before = before.map_or(&none[..], |cells| &cells[span.clone()]);
        let (cells, dstate, dcell) = (&cells[span.clone()], &dstate[span.clone()], &mut dcell[span]);
        let (input, rest) = gates.split_at(width);
        let (forget, rest) = rest.split_at(width);
        let (candidate, output) = rest.split_at(width);
        let (dinput, rest) = own.split_at_mut(width);
        let (dforget, rest) = rest.split_at_mut(width);
        let (dcandidate, doutput) = rest.split_at_mut(width);
        for k in 0..width {
            let (i, f, g, o) = (input[k], forget[k], candidate[k], output[k]);
            let squashed = tanh(cells[k]);
            let total = dcell[k] + dstate[k] * o * (one - squashed * squashed);
            dinput[k] = total * g * i * (one - i);
            dforget[k] = total * before[k] * f * (one - f);
            dcandidate[k] = total * i * (one - g * g);
            doutput[k] = dstate[k] * squashed * o * (one - o);
            dcell[k] = total * f;
        }
    }
}

impl CustomOp3 for Trace {
    fn name(&self) -> &'static str {
        "lstm"
    }

    fn cpu_fwd(
        &self,
        weight: &CpuStorage,
        _: &Layout,
        _: &CpuStorage,
        _: &Layout,
        _: &CpuStorage,
        _: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let last = self.last()?;
        by_dtype!(weight.dtype(), T => {
            Ok((T::to_cpu_storage_owned(last.flatten_all()?.to_vec1::<T>()?), last.shape().clone()))
        })
    }

    fn bwd(
        &self,
        _weight_ih: &Tensor,
        weight_hh: &Tensor,
        bias: &Tensor,
        _result: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let gates = match gradient.dtype() {
            DType::F64 => self.gate_gradients::<f64>(weight_hh, gradient)?,
            _ => self.gate_gradients::<f32>(weight_hh, gradient)?,
        };
        let dbias = by_dtype!(gates.dtype(), T => {
            let sums = with_slice::<T, _>(&gates, |gates| column_sums(gates, bias.elem_count()))?;
            Tensor::from_vec(sums, bias.shape(), bias.device())?
        });
        let later = (self.steps - 1) * self.n;
        let dweight_hh = match later {
            0 => weight_hh.zeros_like()?,
            later => gates.narrow(0, self.n, later)?.t()?.matmul(&self.states.narrow(0, 0, later)?)?,
        };
        Ok((Some(gates.t()?.matmul(&self.inputs)?), Some(dweight_hh), Some(dbias)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Parameters;
    use candle_core::Device;
    use sage_core::seed::Rng;

    const STEPS: usize = 3;

    fn parameters() -> Parameters {
        let specs = Scope::list(|scope| Lstm::new(scope, 3, 4)).unwrap();
        Parameters::start(&specs, 5).unwrap().to_dtype(DType::F64).unwrap()
    }

    fn inputs() -> Tensor {
        let mut rng = Rng::new(1, "inputs", "test");
        let numbers: Vec<f64> = (0..STEPS * 2 * 3).map(|_| rng.normal()).collect();
        Tensor::from_vec(numbers, (STEPS * 2, 3), &Device::Cpu).unwrap()
    }

    /// The equations of a cell, in candle's own operations.
    fn definition(parameters: &Parameters, inputs: &Tensor) -> Result<Tensor> {
        let of = |name: &str| parameters.get(name).unwrap();
        let sigmoid = |x: Tensor| (x.neg()?.exp()? + 1.0)?.recip();
        let mut state = Tensor::zeros((2, 4), DType::F64, &Device::Cpu)?;
        let mut cell = state.clone();
        for step in 0..STEPS {
            let x = inputs.narrow(0, 2 * step, 2)?.matmul(&of("weight_ih").t()?)?;
            let x = (x + state.matmul(&of("weight_hh").t()?)?)?;
            let x = x.broadcast_add(of("bias_ih"))?.broadcast_add(of("bias_hh"))?;
            let gate = |k: usize| x.narrow(1, 4 * k, 4);
            let kept = (sigmoid(gate(1)?)? * cell)?;
            cell = (kept + (sigmoid(gate(0)?)? * gate(2)?.tanh()?)?)?;
            state = (sigmoid(gate(3)?)? * cell.tanh()?)?;
        }
        Ok(state)
    }

    #[test]
    fn states_and_gradients_equal_those_of_the_definition() {
        let (traced, variables) = parameters().variables(|_| true).unwrap();
        let lstm = Lstm::new(&Scope::of(&traced), 3, 4).unwrap();
        let (found, expected) =
            (lstm.forward(&inputs(), STEPS).unwrap(), definition(&traced, &inputs()).unwrap());
        let distance = |a: &Tensor, b: &Tensor| -> f64 {
            (a - b).unwrap().abs().unwrap().flatten_all().unwrap().max(0).unwrap().to_scalar().unwrap()
        };
        assert!(distance(&found, &expected) < 1e-14);
        let plain = Lstm::new(&Scope::of(&traced.detached()), 3, 4).unwrap();
        assert_eq!(distance(&plain.forward(&inputs(), STEPS).unwrap(), &found), 0.0);
        let [found, expected] =
            [found, expected].map(|state| state.sqr().unwrap().sum_all().unwrap().backward().unwrap());
        for (name, variable) in variables.iter() {
            let distance = distance(found.get(variable).unwrap(), expected.get(variable).unwrap());
            assert!(distance < 1e-14, "{name}: {distance}");
        }
    }

    #[test]
    fn gradients_equal_differences() {
        let (traced, variables) = parameters().variables(|_| true).unwrap();
        let loss = |parameters: &Parameters| {
            let lstm = Lstm::new(&Scope::of(parameters), 3, 4).unwrap();
            lstm.forward(&inputs(), STEPS).unwrap().sqr().unwrap().sum_all().unwrap()
        };
        let store = loss(&traced).backward().unwrap();
        for (name, variable) in variables.iter() {
            let gradient = store.get(variable).unwrap().flatten_all().unwrap().to_vec1::<f64>().unwrap();
            for (index, gradient) in gradient.into_iter().enumerate() {
                let at = |step: f64| -> f64 {
                    let mut values =
                        variable.as_detached_tensor().flatten_all().unwrap().to_vec1::<f64>().unwrap();
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

    #[test]
    fn rows_that_are_no_whole_steps_are_refused() {
        let lstm = Lstm::new(&Scope::of(&parameters()), 3, 4).unwrap();
        assert!(lstm.forward(&inputs(), 4).is_err());
        assert!(lstm.forward(&inputs(), 0).is_err());
    }
}
