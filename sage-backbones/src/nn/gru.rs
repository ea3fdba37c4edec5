//! One layer of gated recurrent units (Cho et al., 2014), as PyTorch computes it, for sequences of different lengths:
//!
//! `r = σ(W_ir x + b_ir + W_hr h + b_hr)`, `z = σ(W_iz x + b_iz + W_hz h + b_hz)`,
//! `n = tanh(W_in x + b_in + r (W_hn h + b_hn))`, `h' = (1 − z) n + z h`.
//!
//! Inputs of all steps are projected by one product. The recurrent part is one operation with its own gradient, so
//! the gradients of the weights are one product each, not one for each step. Sequences are sorted, the longest first:
//! each step is one product over the first rows of the step before, and no row is padding.

#[cfg(test)]
mod tests;

use candle_core::{
    CpuStorage, CustomOp3, Device, Layout, Result, Shape, Tensor, WithDType as _,
    backend::BackendStorage as _,
};

use super::{
    add_row::column_sums,
    real::{Real, by_dtype, sigmoid, tanh, wide, with_slice},
    sequences::Sequences,
};
use crate::parameters::{Init, Scope};

/// The layer; gates are in the order reset, update, candidate.
#[derive(Clone, Debug)]
pub struct Gru {
    weight_ih: Tensor,
    weight_hh: Tensor,
    bias_ih: Tensor,
    bias_hh: Tensor,
}

impl Gru {
    /// Takes `weight_ih`, `weight_hh`, `bias_ih` and `bias_hh` from the scope.
    ///
    /// *Errors*: a tensor that is missing or has another shape.
    pub fn new(scope: &Scope, inputs: usize, hidden: usize) -> Result<Self> {
        let tensor =
            |name: &str, shape: &[usize]| scope.tensor(name, shape, Init::Uniform { fan_in: hidden });
        Ok(Self {
            weight_ih: tensor("weight_ih", &[3 * hidden, inputs])?,
            weight_hh: tensor("weight_hh", &[3 * hidden, hidden])?,
            bias_ih: tensor("bias_ih", &[3 * hidden])?,
            bias_hh: tensor("bias_hh", &[3 * hidden])?,
        })
    }

    /// The hidden state of each sequence after its own last step, from a state of zeros. No gradient flows to the
    /// inputs.
    ///
    /// *Shapes*: result (n, hidden), in the order in which the sequences were given.
    /// *Errors*: inputs of another width.
    pub fn forward(&self, sequences: Sequences) -> Result<Tensor> {
        let biases = Tensor::stack(&[&self.bias_ih, &self.bias_hh], 0)?;
        let weights = [&self.weight_ih, &self.weight_hh, &biases];
        let trace = Trace::of(sequences, weights.map(Tensor::detach))?;
        if weights.iter().any(|tensor| tensor.track_op()) {
            return self.weight_ih.apply_op3(&self.weight_hh, &biases, trace);
        }
        by_dtype!(self.weight_ih.dtype(), T => trace.last::<T>())
    }
}

/// What the gradient needs of a forward pass. Rows are those of the inputs.
struct Trace {
    sequences: Sequences,
    /// (rows, 3 hidden), after their activation.
    gates: Tensor,
    /// (rows, hidden): `W_hn h + b_hn`.
    candidates: Tensor,
    /// (rows, hidden).
    states: Tensor,
}

impl Trace {
    fn of(sequences: Sequences, [weight_ih, weight_hh, biases]: [Tensor; 3]) -> Result<Self> {
        let width = weight_hh.dim(1)?;
        let (rows, device) = (sequences.inputs.dim(0)?, &Device::Cpu);
        let recurrent = weight_hh.t()?;
        let projected = sequences.inputs.matmul(&weight_ih.t()?)?;
        by_dtype!(projected.dtype(), T => {
            let [bias_ih, bias_hh] = [biases.get(0)?.to_vec1::<T>()?, biases.get(1)?.to_vec1::<T>()?];
            let mut gates = vec![0 as T; 3 * rows * width];
            let [mut candidates, mut states] = [(); 2].map(|()| vec![0 as T; rows * width]);
            let (mut start, mut previous) = (0, 0);
            with_slice::<T, _>(&projected, |projected| -> Result<()> {
                for count in &sequences.counts {
                    let end = start + count * width;
                    let (before, states) = states.split_at_mut(start);
                    let step = ForwardStep {
                        projected: &projected[3 * start..3 * end],
                        biases: [&bias_ih, &bias_hh],
                        gates: &mut gates[3 * start..3 * end],
                        candidates: &mut candidates[start..end],
                        states: &mut states[..count * width],
                        width,
                    };
                    if start == 0 {
                        wide(#[inline(always)] || step.run(None));
                    } else {
                        let before = &before[previous..previous + count * width];
                        let state = Tensor::from_slice(before, (*count, width), device)?;
                        with_slice::<T, _>(&state.matmul(&recurrent)?, |product| {
                            wide(#[inline(always)] || step.run(Some((product, before))));
                        })?;
                    }
                    (previous, start) = (start, end);
                }
                Ok(())
            })??;
            Ok(Self {
                gates: Tensor::from_vec(gates, (rows, 3 * width), device)?,
                candidates: Tensor::from_vec(candidates, (rows, width), device)?,
                states: Tensor::from_vec(states, (rows, width), device)?,
                sequences,
            })
        })
    }

    /// (n, hidden): the state after the last step of each sequence, in the order in which they were given.
    fn last<T: Real>(&self) -> Result<Tensor> {
        let Sequences { counts, order, .. } = &self.sequences;
        let width = self.states.dim(1)?;
        let mut last = vec![T::zero(); order.len() * width];
        with_slice::<T, _>(&self.states, |states| {
            let mut start = 0;
            for (step, count) in counts.iter().enumerate() {
                let ended = counts.get(step + 1).copied().unwrap_or(0)..*count;
                for row in ended {
                    last[order[row] * width..][..width]
                        .copy_from_slice(&states[(start + row) * width..][..width]);
                }
                start += count;
            }
        })?;
        Tensor::from_vec(last, (order.len(), width), &Device::Cpu)
    }

    /// Gradients of the projected inputs and of the recurrent products, from that of the last states.
    ///
    /// *Shapes*: results (rows, 3 hidden).
    fn gate_gradients<T: Real>(&self, weight_hh: &Tensor, last: &Tensor) -> Result<[Tensor; 2]> {
        let Sequences { counts, order, .. } = &self.sequences;
        let (rows, width) = self.states.dims2()?;
        let [mut projected, mut recurrent] = [(); 2].map(|()| vec![T::zero(); 3 * rows * width]);
        // The gradient of the state after the present step, by row. That of a row that has ended stands there from the
        // beginning, and is not touched before its last step.
        let mut dstate = Vec::with_capacity(order.len() * width);
        with_slice::<T, _>(&last.contiguous()?, |last| {
            order.iter().for_each(|k| dstate.extend_from_slice(&last[k * width..][..width]));
        })?;
        let mut end = rows * width;
        for (step, count) in counts.iter().enumerate().rev() {
            let start = end - count * width;
            let before = step.checked_sub(1).map(|step| start - counts[step] * width);
            let dstate = &mut dstate[..count * width];
            with_slice::<T, _>(&self.gates, |gates| {
                with_slice::<T, _>(&self.candidates, |candidates| {
                    with_slice::<T, _>(&self.states, |states| {
                        let step = BackwardStep {
                            gates: &gates[3 * start..3 * end],
                            candidates: &candidates[start..end],
                            before: before.map(|at| &states[at..][..count * width]),
                            projected: &mut projected[3 * start..3 * end],
                            recurrent: &mut recurrent[3 * start..3 * end],
                            dstate,
                            width,
                        };
                        wide(
                            #[inline(always)]
                            || step.run(),
                        );
                    })
                })
            })???;
            if before.is_some() {
                let own = &recurrent[3 * start..3 * end];
                let product =
                    Tensor::from_slice(own, (*count, 3 * width), &Device::Cpu)?.matmul(weight_hh)?;
                with_slice::<T, _>(&product, |product| {
                    dstate.iter_mut().zip(product).for_each(|(sum, x)| *sum += *x);
                })?;
            }
            end = start;
        }
        let tensor = |numbers| Tensor::from_vec(numbers, (rows, 3 * width), &Device::Cpu);
        Ok([tensor(projected)?, tensor(recurrent)?])
    }

    /// (rows − n, hidden): the state before each step but the first.
    fn states_before<T: Real>(&self) -> Result<Tensor> {
        let counts = &self.sequences.counts;
        let (rows, width) = self.states.dims2()?;
        let mut all = Vec::with_capacity((rows - counts[0]) * width);
        with_slice::<T, _>(&self.states, |states| {
            let mut start = 0;
            for (before, count) in counts.iter().zip(&counts[1..]) {
                all.extend_from_slice(&states[start * width..][..count * width]);
                start += before;
            }
        })?;
        Tensor::from_vec(all, (rows - counts[0], width), &Device::Cpu)
    }

    fn backward<T: Real>(&self, weight_hh: &Tensor, gradient: &Tensor) -> Result<[Tensor; 3]> {
        let [projected, recurrent] = self.gate_gradients::<T>(weight_hh, gradient)?;
        let columns = projected.dim(1)?;
        let mut dbiases = Vec::with_capacity(2 * columns);
        for gradients in [&projected, &recurrent] {
            dbiases.extend(with_slice::<T, _>(gradients, |rows| column_sums(rows, columns))?);
        }
        let first = self.sequences.counts[0];
        let dweight_hh = match recurrent.dim(0)? - first {
            0 => weight_hh.zeros_like()?,
            later => recurrent.narrow(0, first, later)?.t()?.matmul(&self.states_before::<T>()?)?,
        };
        let dweight_ih = projected.t()?.matmul(&self.sequences.inputs)?;
        Ok([dweight_ih, dweight_hh, Tensor::from_vec(dbiases, (2, columns), &Device::Cpu)?])
    }
}

/// The parts of a row of gates: reset, update, candidate.
#[inline(always)]
fn thirds<T>(row: &[T], width: usize) -> [&[T]; 3] {
    let (reset, rest) = row.split_at(width);
    let (update, candidate) = rest.split_at(width);
    [reset, update, &candidate[..width]]
}

#[inline(always)]
fn thirds_mut<T>(row: &mut [T], width: usize) -> [&mut [T]; 3] {
    let (reset, rest) = row.split_at_mut(width);
    let (update, candidate) = rest.split_at_mut(width);
    [reset, update, &mut candidate[..width]]
}

/// Rows of one step of the forward pass.
struct ForwardStep<'a, T> {
    /// Projected inputs, without bias.
    projected: &'a [T],
    /// Those of the projected inputs and of the recurrent products.
    biases: [&'a [T]; 2],
    /// A result, as the two after it.
    gates: &'a mut [T],
    candidates: &'a mut [T],
    states: &'a mut [T],
    width: usize,
}

impl<T: Real> ForwardStep<'_, T> {
    /// `before` holds the recurrent products and the states of the step before, unless the step is the first.
    #[inline(always)]
    fn run(self, before: Option<(&[T], &[T])>) {
        let width = self.width;
        let none = vec![T::zero(); 3 * width];
        let [bias_ih, bias_hh] = self.biases;
        let sums: Vec<T> = bias_ih.iter().zip(bias_hh).map(|(x, y)| *x + *y).collect();
        let [bias_r, bias_z, _] = thirds(&sums, width);
        let ([_, _, bias_in], [_, _, bias_hn]) = (thirds(bias_ih, width), thirds(bias_hh, width));
        let results = self.candidates.chunks_exact_mut(width).zip(self.states.chunks_exact_mut(width));
        let rows = self.projected.chunks_exact(3 * width).zip(self.gates.chunks_exact_mut(3 * width));
        for (row, ((projected, gates), (candidate, state))) in rows.zip(results).enumerate() {
            let (product, previous) = match before {
                Some((products, states)) => {
                    (&products[3 * width * row..][..3 * width], &states[width * row..][..width])
                }
                None => (&none[..], &none[..width]),
            };
            let [r, z, n] = thirds_mut(gates, width);
            let [input_r, input_z, input_n] = thirds(projected, width);
            let [product_r, product_z, product_n] = thirds(product, width);
            // Short loops over few slices: the compiler makes no vector code of one loop over all of them.
            let gates = [(&mut *r, input_r, product_r, bias_r), (&mut *z, input_z, product_z, bias_z)];
            for (gate, input, product, bias) in gates {
                for ((gate, input), (product, bias)) in
                    gate.iter_mut().zip(input).zip(product.iter().zip(bias))
                {
                    *gate = sigmoid(*input + (*product + *bias));
                }
            }
            for (candidate, (product, bias)) in candidate.iter_mut().zip(product_n.iter().zip(bias_hn)) {
                *candidate = *product + *bias;
            }
            let inputs = input_n.iter().zip(bias_in);
            for ((n, (input, bias)), (r, candidate)) in
                n.iter_mut().zip(inputs).zip(r.iter().zip(&*candidate))
            {
                *n = tanh(*input + *bias + *r * *candidate);
            }
            for ((state, n), (z, previous)) in state.iter_mut().zip(&*n).zip(z.iter().zip(previous)) {
                *state = *n + *z * (*previous - *n);
            }
        }
    }
}

/// Rows of one step of the backward pass.
struct BackwardStep<'a, T> {
    gates: &'a [T],
    candidates: &'a [T],
    /// States of the step before; zeros if there is none.
    before: Option<&'a [T]>,
    /// Gradients of the projected inputs: a result.
    projected: &'a mut [T],
    /// Gradients of the recurrent products: a result.
    recurrent: &'a mut [T],
    /// Gradient of the states; afterwards, its part for the states before that does not pass the recurrent products.
    dstate: &'a mut [T],
    width: usize,
}

impl<T: Real> BackwardStep<'_, T> {
    #[inline(always)]
    fn run(self) {
        let (one, width) = (T::one(), self.width);
        let none = vec![T::zero(); width];
        let results =
            self.projected.chunks_exact_mut(3 * width).zip(self.recurrent.chunks_exact_mut(3 * width));
        let rows = self.gates.chunks_exact(3 * width).zip(self.dstate.chunks_exact_mut(width));
        for (row, ((gates, dstate), (projected, recurrent))) in rows.zip(results).enumerate() {
            let before = self.before.map_or(&none[..], |states| &states[width * row..][..width]);
            let candidate = &self.candidates[width * row..][..width];
            let [r, z, n] = thirds(gates, width);
            let [dr, dz, dn] = thirds_mut(projected, width);
            let [recurrent_dr, recurrent_dz, recurrent_dn] = thirds_mut(recurrent, width);
            for k in 0..width {
                let through = dstate[k] * (one - z[k]) * (one - n[k] * n[k]);
                dn[k] = through;
                recurrent_dn[k] = through * r[k];
                dr[k] = through * candidate[k] * r[k] * (one - r[k]);
                recurrent_dr[k] = dr[k];
                dz[k] = dstate[k] * (before[k] - n[k]) * z[k] * (one - z[k]);
                recurrent_dz[k] = dz[k];
                dstate[k] *= z[k];
            }
        }
    }
}

impl CustomOp3 for Trace {
    fn name(&self) -> &'static str {
        "gru"
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
        by_dtype!(weight.dtype(), T => {
            let last = self.last::<T>()?;
            Ok((T::to_cpu_storage_owned(last.flatten_all()?.to_vec1::<T>()?), last.shape().clone()))
        })
    }

    fn bwd(
        &self,
        _weight_ih: &Tensor,
        weight_hh: &Tensor,
        _biases: &Tensor,
        _result: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let [dweight_ih, dweight_hh, dbiases] =
            by_dtype!(gradient.dtype(), T => self.backward::<T>(weight_hh, gradient)?);
        Ok((Some(dweight_ih), Some(dweight_hh), Some(dbiases)))
    }
}
