//! Adds a row to every row of a matrix, with a fast gradient: candle sums over the first axis
//! fifty times slower than over the last.

use candle_core::{
    CpuStorage, CustomOp2, InplaceOp2, Layout, Result, Shape, Tensor, backend::BackendStorage as _,
};

use super::{
    composed::{self, is_composed},
    real::{BlockSums, Real, by_dtype, slice, slice_mut, with_slice},
};

struct AddRow;

/// `x + row` for every row of `x`.
///
/// *Shapes*: `x` (n, d), `row` (d) or (1, d); result (n, d).
pub fn add_row(x: &Tensor, row: &Tensor) -> Result<Tensor> {
    if is_composed(x) {
        return composed::add_row(x, row);
    }
    x.contiguous()?.apply_op2(&row.contiguous()?, AddRow)
}

/// [`add_row`] for a tensor that no other code reads. It is overwritten if no gradient needs it.
pub(super) fn add_row_in_place(x: Tensor, row: &Tensor) -> Result<Tensor> {
    if x.track_op() || row.track_op() || is_composed(&x) {
        return add_row(&x, row);
    }
    x.inplace_op2(&row.contiguous()?, &AddRow)?;
    Ok(x)
}

/// The number of columns, if the row has as many.
fn columns(x: &Layout, row: &Layout) -> Result<usize> {
    let d = row.shape().elem_count();
    if x.dims().last() != Some(&d) {
        candle_core::bail!("add-row of {:?} and {:?}", x.dims(), row.dims());
    }
    Ok(d)
}

fn add<T: Real>(x: &mut [T], row: &[T], d: usize) {
    for x in x.chunks_exact_mut(d) {
        for (x, b) in x.iter_mut().zip(row) {
            *x += *b;
        }
    }
}

/// Sums of the columns of rows of width `d`.
pub fn column_sums<T: Real>(rows: &[T], d: usize) -> Vec<T> {
    let mut sums = BlockSums::new(d);
    for row in rows.chunks_exact(d) {
        for (sum, x) in sums.next_row().iter_mut().zip(row) {
            *sum += *x;
        }
    }
    sums.finish()
}

impl InplaceOp2 for AddRow {
    fn name(&self) -> &'static str {
        "add-row"
    }

    fn cpu_fwd(
        &self,
        x: &mut CpuStorage,
        x_layout: &Layout,
        row: &CpuStorage,
        row_layout: &Layout,
    ) -> Result<()> {
        let d = columns(x_layout, row_layout)?;
        by_dtype!(x.dtype(), T => {
            add(slice_mut::<T>(x, x_layout)?, slice(row, row_layout)?, d);
            Ok(())
        })
    }
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
        let d = columns(x_layout, row_layout)?;
        by_dtype!(x.dtype(), T => {
            let mut out = slice::<T>(x, x_layout)?.to_vec();
            add(&mut out, slice(row, row_layout)?, d);
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
