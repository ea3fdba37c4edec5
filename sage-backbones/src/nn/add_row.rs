//! A row added to every row of a matrix, with a fast gradient: candle sums over the first axis
//! fifty times slower than over the last.

use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor, backend::BackendStorage as _};

use super::real::{BlockSums, Real, by_dtype, slice, with_slice};

struct AddRow;

/// `x + row` for every row of `x`.
///
/// *Shapes*: `x` (n, d), `row` (d) or (1, d); result (n, d).
pub fn add_row(x: &Tensor, row: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op2(&row.contiguous()?, AddRow)
}

fn column_sums<T: Real>(rows: &[T], d: usize) -> Vec<T> {
    let mut sums = BlockSums::new(d);
    for row in rows.chunks_exact(d) {
        for (sum, x) in sums.next().iter_mut().zip(row) {
            *sum += *x;
        }
    }
    sums.finish()
}

impl CustomOp2 for AddRow {
    fn name(&self) -> &'static str {
        "add-row"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        row: &CpuStorage,
        row_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let d = row_layout.shape().elem_count();
        if x_layout.dims().last() != Some(&d) {
            candle_core::bail!("add-row of {:?} and {:?}", x_layout.dims(), row_layout.dims());
        }
        by_dtype!(x.dtype(), T => {
            let (x, row) = (slice::<T>(x, x_layout)?, slice::<T>(row, row_layout)?);
            let mut out = vec![0 as T; x.len()];
            for (x, y) in x.chunks_exact(d).zip(out.chunks_exact_mut(d)) {
                for ((y, x), b) in y.iter_mut().zip(x).zip(row) {
                    *y = *x + *b;
                }
            }
            Ok((candle_core::WithDType::to_cpu_storage_owned(out), x_layout.shape().clone()))
        })
    }

    fn bwd(
        &self,
        _x: &Tensor,
        row: &Tensor,
        _result: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let gradient = gradient.contiguous()?;
        let d = row.elem_count();
        by_dtype!(gradient.dtype(), T => {
            let sums = with_slice::<T, _>(&gradient, |g| column_sums(g, d))?;
            let sums = Tensor::from_vec(sums, row.shape(), row.device())?;
            Ok((Some(gradient), Some(sums)))
        })
    }
}
