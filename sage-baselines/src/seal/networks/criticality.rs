//! Criticality of a candidate trajectory of the adversary, predicted from the ego's path relative to it.
//!
//! Three blocks `ReLU(LN(W [h ; max over time of h] + b))` are followed by a maximum over time and a small head. The
//! network follows SEAL (Stoler et al., 2025) and has 6 194 parameters.

use candle_core::{Device, Module as _, Result, Tensor};
use sage_backbones::{
    Error,
    nn::{Groups, Linear, Mlp, max_of_rows},
    parameters::Scope,
};
use sage_core::{
    geometry::{Point, cross, dot, sub},
    motion::Pose,
};

/// Width of the blocks.
const WIDTH: usize = 32;

/// Network of two scores in [0, 1]: the chance of a collision, and how far the ego has to deviate from its path.
#[derive(Clone, Debug)]
pub struct CriticalityNetwork {
    blocks: [Mlp; 3],
    head: [Mlp; 2],
    out: Linear,
}

impl CriticalityNetwork {
    /// Takes `blocks.*`, `head.*` and `out` from the scope.
    ///
    /// *Errors*: a tensor that is missing or has another shape.
    pub fn new(scope: &Scope) -> Result<Self> {
        let block = |k: usize, inputs| Mlp::new(&scope.at("blocks").at(k), inputs, WIDTH);
        let head = |k: usize, outputs| Mlp::new(&scope.at("head").at(k), WIDTH, outputs);
        Ok(Self {
            blocks: [block(0, 3)?, block(1, 2 * WIDTH)?, block(2, 2 * WIDTH)?],
            head: [head(0, WIDTH)?, head(1, WIDTH / 2)?],
            out: Linear::new(&scope.at("out"), WIDTH / 2, 2)?,
        })
    }

    /// Scores of sequences of equal length.
    ///
    /// *Shapes*: `sequences` (n, frames, 3), see [`relative_path`]; result (n, 2) = collision, deviation.
    ///
    /// *Errors*: another shape, or no frames.
    pub fn forward(&self, sequences: &Tensor) -> Result<Tensor> {
        let (n, frames, columns) = sequences.dims3()?;
        let rows = sequences.reshape((n * frames, columns))?;
        self.forward_rows(&rows, &Groups::of_lengths(std::iter::repeat_n(frames, n)))
    }

    /// Scores of sequences of any lengths.
    ///
    /// *Shapes*: `rows` (all frames, 3), a group for each sequence; result (groups, 2).
    ///
    /// *Errors*: another shape, or an empty group.
    pub fn forward_rows(&self, rows: &Tensor, groups: &Groups) -> Result<Tensor> {
        let [first, later @ ..] = &self.blocks;
        let mut states = first.forward(rows)?;
        let mut largest = max_of_rows(&states, groups)?;
        for block in later {
            states = block.forward_by_group(&states, &largest, groups)?;
            largest = max_of_rows(&states, groups)?;
        }
        let [wide, narrow] = &self.head;
        let logits = self.out.forward(&narrow.forward(&wide.forward(&largest)?)?)?;
        // The logistic function. As 1 / (1 + e⁻ˣ), its gradient would be NaN where the exponential overflows.
        ((logits * 0.5)?.tanh()? + 1.0)? * 0.5
    }

    /// Scores of sequences of any lengths, each in [0, 1]. A result does not depend on the other sequences.
    ///
    /// *Errors*: [`Error::NotFinite`] for a sequence or score that is not finite and [`Error::Mismatch`] for a sequence
    /// without frames, each with its number from 0.
    pub fn scores(&self, sequences: &[Vec<[f32; 3]>]) -> std::result::Result<Vec<[f64; 2]>, Error> {
        sequences.iter().enumerate().map(|(k, sequence)| self.score(k, sequence)).collect()
    }

    // One product for all sequences could round a row differently, depending on the number of rows.
    fn score(&self, candidate: usize, sequence: &[[f32; 3]]) -> std::result::Result<[f64; 2], Error> {
        let numbers = sequence.as_flattened();
        // A maximum drops NaN, so the result would not show it.
        if let Some(bad) = numbers.iter().find(|x| !x.is_finite()) {
            return Err(Error::NotFinite(format!("candidate {candidate}: its sequence holds {bad}")));
        }
        if sequence.is_empty() {
            return Err(Error::Mismatch(format!("candidate {candidate}: its sequence has no frames")));
        }
        let rows = Tensor::from_slice(numbers, (sequence.len(), 3), &Device::Cpu)?;
        let scores = self.forward_rows(&rows, &Groups::of_lengths([sequence.len()]))?;
        let scores = scores.flatten_all()?.to_vec1::<f32>()?;
        match scores[..] {
            [collision, deviation] if collision.is_finite() && deviation.is_finite() => {
                Ok([collision, deviation].map(f64::from))
            }
            _ => Err(Error::NotFinite(format!("candidate {candidate}: its scores are {scores:?}"))),
        }
    }
}

/// The ego's path relative to the adversary: for each frame that both have (x, y, 1), the ego's position ahead and to
/// the left of the adversary, metres. Zeros stand for a frame in which one is absent or a number is not finite. The
/// result is as long as the shorter of the two.
pub fn relative_path(ego: &[Option<Point>], adversary: &[Option<Pose>]) -> Vec<[f32; 3]> {
    let relative = |ego: Point, adversary: Pose| {
        let (sin, cos) = adversary.heading.sin_cos();
        let offset = sub(ego, adversary.position);
        [dot([cos, sin], offset) as f32, cross([cos, sin], offset) as f32, 1.0]
    };
    let row = |(ego, adversary): (&Option<Point>, &Option<Pose>)| match (ego, adversary) {
        (Some(ego), Some(adversary)) => {
            let row = relative(*ego, *adversary);
            if row.iter().all(|x| x.is_finite()) { row } else { [0.0; 3] }
        }
        _ => [0.0; 3],
    };
    ego.iter().zip(adversary).map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Var};
    use sage_backbones::{Parameters, parameters::Scope};
    use sage_core::seed::Rng;

    fn network(dtype: DType) -> (Parameters, CriticalityNetwork) {
        let specs = Scope::list(CriticalityNetwork::new).unwrap();
        let parameters = Parameters::start(&specs, 3).unwrap().to_dtype(dtype).unwrap();
        let network = CriticalityNetwork::new(&Scope::of(&parameters)).unwrap();
        (parameters, network)
    }

    fn sequence(seed: u64, frames: usize) -> Vec<[f32; 3]> {
        let mut rng = Rng::new(seed, "sequence", "test");
        (0..frames).map(|_| [rng.uniform(-30.0, 30.0) as f32, rng.uniform(-9.0, 9.0) as f32, 1.0]).collect()
    }

    #[test]
    fn the_network_has_the_published_number_of_parameters() {
        assert_eq!(network(DType::F32).0.numbers(), 6194);
    }

    #[test]
    fn a_car_ahead_is_ahead_whatever_the_heading() {
        let up = Pose::new(2.0, 3.0, std::f64::consts::FRAC_PI_2);
        let ego = [Some([1.0, 7.0]), Some([1.0, 7.0]), None, Some([f64::NAN, 0.0]), Some([0.0, 0.0])];
        let path = relative_path(&ego, &[Some(up), None, Some(up), Some(up)]);
        // The ego is 4 m further along +y, which is ahead, and 1 m along −x, which is to the left.
        assert!((path[0][0] - 4.0).abs() < 1e-6 && (path[0][1] - 1.0).abs() < 1e-6 && path[0][2] == 1.0);
        assert_eq!(path[1..], [[0.0; 3]; 3]);
    }

    #[test]
    fn a_score_does_not_depend_on_the_other_sequences() {
        let (_, network) = network(DType::F32);
        let sequences: Vec<_> = (0..6).map(|k| sequence(k, 91 - 17 * k as usize)).collect();
        let together = network.scores(&sequences).unwrap();
        for (sequence, scores) in sequences.iter().zip(&together) {
            let alone = network.scores(std::slice::from_ref(sequence)).unwrap()[0];
            assert_eq!(alone.map(f64::to_bits), scores.map(f64::to_bits));
            assert!(scores.iter().all(|score| (0.0..=1.0).contains(score)));
        }
        let batch = Tensor::from_slice(sequences[0].as_flattened(), (1, 91, 3), &Device::Cpu).unwrap();
        let batch = Tensor::cat(&[&batch, &batch], 0).unwrap();
        let scores = network.forward(&batch).unwrap().to_vec2::<f32>().unwrap();
        assert!((f64::from(scores[1][0]) - together[0][0]).abs() < 1e-6);
    }

    #[test]
    fn bad_sequences_are_named() {
        let (_, network) = network(DType::F32);
        let message = |bad: Vec<[f32; 3]>| network.scores(&[sequence(0, 4), bad]).unwrap_err().to_string();
        assert_eq!(message(vec![[0.0; 3], [f32::NAN, 0.0, 1.0]]), "candidate 1: its sequence holds NaN");
        assert_eq!(message(vec![]), "candidate 1: its sequence has no frames");
    }

    /// Blocks on explicit concatenations, and their gradients by differences.
    #[test]
    fn blocks_equal_their_definition_and_have_its_gradients() {
        let (parameters, network) = network(DType::F64);
        let groups = Groups::of_lengths([4, 2, 5]);
        let numbers: Vec<f32> = sequence(1, 11).into_iter().flatten().collect();
        let rows = Tensor::from_vec(numbers, (11, 3), &Device::Cpu).unwrap().to_dtype(DType::F64).unwrap();
        let h = network.blocks[0].forward(&rows).unwrap();
        let largest = max_of_rows(&h, &groups).unwrap();
        let index = Tensor::new(&[0u32, 0, 0, 0, 1, 1, 2, 2, 2, 2, 2], &Device::Cpu).unwrap();
        let joined = Tensor::cat(&[&h, &largest.index_select(&index, 0).unwrap()], 1).unwrap();
        let expected = network.blocks[1].forward(&joined).unwrap();
        let found = network.blocks[1].forward_by_group(&h, &largest, &groups).unwrap();
        let difference = (expected - found).unwrap().abs().unwrap().max_all().unwrap();
        assert!(difference.to_scalar::<f64>().unwrap() < 1e-12);

        let loss = |parameters: &Parameters| {
            let network = CriticalityNetwork::new(&Scope::of(parameters)).unwrap();
            network.forward_rows(&rows, &groups).unwrap().sqr().unwrap().sum_all().unwrap()
        };
        let (traced, variables) = parameters.variables(|_| true).unwrap();
        let store = loss(&traced).backward().unwrap();
        for (name, variable) in variables.iter() {
            let gradient = store.get(variable).unwrap().flatten_all().unwrap().to_vec1::<f64>().unwrap();
            for index in [0, gradient.len() / 2, gradient.len() - 1] {
                let at = |step: f64| -> f64 {
                    let mut values =
                        variable.as_detached_tensor().flatten_all().unwrap().to_vec1::<f64>().unwrap();
                    values[index] += step;
                    let mut moved = traced.detached();
                    let tensor = Tensor::from_vec(values, variable.dims(), &Device::Cpu).unwrap();
                    moved.insert(name, Var::from_tensor(&tensor).unwrap().as_detached_tensor());
                    loss(&moved).to_scalar().unwrap()
                };
                let difference = (at(1e-6) - at(-1e-6)) / 2e-6;
                assert!((gradient[index] - difference).abs() < 1e-7, "{name} {index}");
            }
        }
    }
}
