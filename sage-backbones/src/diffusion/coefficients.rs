//! Futures as a few numbers of variance about one, which noise can be added to.
//!
//! A future is the motion at the present velocity and a polynomial along each axis that starts with its square, so every future
//! begins where the target is and as fast as it is. The polynomials are orthonormal over the 80 steps, so a coefficient is a
//! root mean square displacement; it is divided by what is usual of its order (after Jiang et al. 2023, MotionDiffuser, who take
//! principal components).

use std::sync::LazyLock;

use candle_core::{DType, Result, Tensor};
use sage_core::motion::{DT, HORIZON};

/// Coefficients of one axis.
const ORDERS: usize = 4;
/// Numbers of a future: coefficients along x, then along y.
pub(super) const COEFFICIENTS: usize = 2 * ORDERS;
/// Usual size of the coefficients along x and y, metres: root mean squares over the recorded futures of moving vehicles.
const USUAL: [[f64; ORDERS]; 2] = [[11.6, 1.5, 0.41, 0.18], [6.8, 0.81, 0.23, 0.088]];
/// Standard deviation of a recorded position about its polynomial, metres. It counts where a record has gaps or ends early.
const ERROR: f64 = 0.1;

/// The polynomials at the 80 steps.
static BASIS: LazyLock<[[f64; HORIZON]; ORDERS]> = LazyLock::new(|| {
    let mut basis = [[0.0; HORIZON]; ORDERS];
    for order in 0..ORDERS {
        let mut own: [f64; HORIZON] =
            std::array::from_fn(|step| ((step + 1) as f64 / HORIZON as f64).powi(order as i32 + 2));
        let mean = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / HORIZON as f64;
        // Twice, because rounding leaves a rest the first time.
        for _ in 0..2 {
            for other in &basis[..order] {
                let share = mean(&own, other);
                own.iter_mut().zip(other).for_each(|(x, other)| *x -= share * other);
            }
        }
        let size = mean(&own, &own).sqrt();
        basis[order] = own.map(|x| x / size);
    }
    basis
});

/// The likeliest coefficients of a future, of which some steps are known.
///
/// *Shapes*: `future` and `valid` have 80 steps; positions in metres, target frame.
pub(super) fn of_future(future: &[[f32; 2]], valid: &[bool], velocity: [f32; 2]) -> [f32; COEFFICIENTS] {
    let mut out = [0.0; COEFFICIENTS];
    for (axis, usual) in USUAL.iter().enumerate() {
        // Normal equations of least squares, with a normal distribution of the coefficients beforehand.
        let mut rows = [[0.0; ORDERS + 1]; ORDERS];
        for (k, row) in rows.iter_mut().enumerate() {
            row[k] = ERROR * ERROR;
        }
        for step in (0..HORIZON).filter(|step| valid[*step]) {
            let time = (step + 1) as f64 * DT;
            let rest = f64::from(future[step][axis]) - f64::from(velocity[axis]) * time;
            let at: [f64; ORDERS] = std::array::from_fn(|k| BASIS[k][step] * usual[k]);
            for (k, row) in rows.iter_mut().enumerate() {
                at.iter().zip(row.iter_mut()).for_each(|(x, entry)| *entry += at[k] * x);
                row[ORDERS] += at[k] * rest;
            }
        }
        out[axis * ORDERS..(axis + 1) * ORDERS].copy_from_slice(&solved(rows).map(|x| x as f32));
    }
    out
}

/// Solution of a positive definite system by elimination; the last column is the right side.
fn solved(mut rows: [[f64; ORDERS + 1]; ORDERS]) -> [f64; ORDERS] {
    for k in 0..ORDERS {
        let pivot = rows[k];
        for row in &mut rows[k + 1..] {
            let factor = row[k] / pivot[k];
            row.iter_mut().zip(pivot).for_each(|(x, above)| *x -= factor * above);
        }
    }
    let mut out = [0.0; ORDERS];
    for k in (0..ORDERS).rev() {
        let known: f64 = (k + 1..ORDERS).map(|j| rows[k][j] * out[j]).sum();
        out[k] = (rows[k][ORDERS] - known) / rows[k][k];
    }
    out
}

/// The same coefficients of whole trajectories.
///
/// *Shapes*: `trajectories` (n, 80, 2), metres, target frame; result (n, 8).
/// *Errors*: [`candle_core::Error`] for other shapes.
pub(super) fn of_trajectories(trajectories: &Tensor, velocity: [f32; 2]) -> Result<Tensor> {
    let (count, dtype) = (trajectories.dim(0)?, trajectories.dtype());
    let numbers = trajectories.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>()?;
    let of = |trajectory: &[f32]| of_future(trajectory.as_chunks::<2>().0, &[true; HORIZON], velocity);
    let coefficients: Vec<f32> = numbers.chunks_exact(2 * HORIZON).flat_map(of).collect();
    Tensor::from_vec(coefficients, (count, COEFFICIENTS), trajectories.device())?.to_dtype(dtype)
}

/// The trajectories of coefficients.
///
/// *Shapes*: `coefficients` (n, 8); result (n, 80, 2), metres, target frame.
/// *Errors*: [`candle_core::Error`] for other shapes.
pub(super) fn trajectories(coefficients: &Tensor, velocity: [f32; 2]) -> Result<Tensor> {
    let constant = |values: Vec<f64>, shape: (usize, usize)| {
        Tensor::from_vec(values, shape, coefficients.device())?.to_dtype(coefficients.dtype())
    };
    let moved = coefficients.matmul(&constant(MATRIX.clone(), (COEFFICIENTS, 2 * HORIZON))?)?;
    let start = (1..=HORIZON).flat_map(|step| velocity.map(|v| f64::from(v) * step as f64 * DT)).collect();
    moved.broadcast_add(&constant(start, (1, 2 * HORIZON))?)?.reshape((coefficients.dim(0)?, HORIZON, 2))
}

/// From coefficients to displacements x, y at the 80 steps (8, 160).
static MATRIX: LazyLock<Vec<f64>> = LazyLock::new(|| {
    let mut matrix = vec![0.0; COEFFICIENTS * 2 * HORIZON];
    for (axis, usual) in USUAL.iter().enumerate() {
        for order in 0..ORDERS {
            for step in 0..HORIZON {
                matrix[(axis * ORDERS + order) * 2 * HORIZON + 2 * step + axis] =
                    usual[order] * BASIS[order][step];
            }
        }
    }
    matrix
});

/// Where futures end, metres, target frame.
///
/// *Shapes*: `coefficients` (n, 8), row by row.
pub(super) fn ends(coefficients: &[f32], velocity: [f32; 2]) -> Vec<[f32; 2]> {
    let end = |own: &[f32]| {
        [0, 1].map(|axis| {
            let moved: f64 = (0..ORDERS)
                .map(|k| f64::from(own[axis * ORDERS + k]) * USUAL[axis][k] * BASIS[k][HORIZON - 1])
                .sum();
            (f64::from(velocity[axis]) * HORIZON as f64 * DT + moved) as f32
        })
    };
    coefficients.chunks_exact(COEFFICIENTS).map(end).collect()
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;
    use sage_core::seed::Rng;

    const VELOCITY: [f32; 2] = [9.0, -0.5];

    #[test]
    fn coefficients_and_trajectories_are_inverse() {
        let mut rng = Rng::new(1, "coefficients", "test");
        let drawn: Vec<f32> = (0..4 * COEFFICIENTS).map(|_| rng.normal() as f32).collect();
        let tensor = Tensor::from_slice(&drawn, (4, COEFFICIENTS), &Device::Cpu).unwrap();
        let paths = trajectories(&tensor, VELOCITY).unwrap();
        let back =
            of_trajectories(&paths, VELOCITY).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        for (a, b) in drawn.iter().zip(&back) {
            // The distribution beforehand draws small orders towards 0 a little.
            assert!((a - b).abs() < 0.15 * a.abs() + 0.05, "{a} and {b}");
        }
        let last = paths.narrow(1, HORIZON - 1, 1).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        for (end, known) in ends(&drawn, VELOCITY).iter().flatten().zip(&last) {
            assert!((end - known).abs() < 1e-3);
        }
    }

    #[test]
    fn a_future_begins_at_the_present_velocity_and_a_gap_is_bridged() {
        let braking: Vec<[f32; 2]> = (1..=HORIZON)
            .map(|step| {
                let t = step as f32 * DT as f32;
                [9.0 * t - 0.4 * t * t, -0.5 * t]
            })
            .collect();
        let whole = of_future(&braking, &[true; HORIZON], VELOCITY);
        // Quadratic: the first order alone.
        assert!(whole[1..].iter().all(|x| x.abs() < 0.02), "{whole:?}");
        let mut valid = [true; HORIZON];
        valid[30..].fill(false);
        let early = of_future(&braking, &valid, VELOCITY);
        assert!((early[0] / whole[0] - 1.0).abs() < 0.2, "{early:?} and {whole:?}");
    }
}
