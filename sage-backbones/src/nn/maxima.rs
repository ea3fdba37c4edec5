//! Maxima over groups of successive rows: the pooling of a polyline encoder.

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, backend::BackendStorage as _};

use super::{
    composed::{self, is_composed},
    groups::{Group, Groups},
    real::{Real, by_dtype, slice, wide, with_slice},
};

struct MaxOfOthers(Groups);

struct MaxOfRows(Groups);

/// Each row followed by the maximum over the other seen rows of its group, column by column, at least 0.
///
/// *Shapes*: `x` (n, d); result (n, 2 d) = `[x ; max(0, max over the others)]`.
pub fn max_of_others(x: &Tensor, groups: &Groups) -> Result<Tensor> {
    if is_composed(x) {
        return composed::max_of_others(x, groups);
    }
    x.contiguous()?.apply_op1(MaxOfOthers(groups.clone()))
}

/// The maximum over all rows of each group, unseen ones included, column by column.
///
/// *Shapes*: `x` (n, d); result (groups, d).
pub fn max_of_rows(x: &Tensor, groups: &Groups) -> Result<Tensor> {
    if is_composed(x) {
        return composed::max_of_rows(x, groups);
    }
    x.contiguous()?.apply_op1(MaxOfRows(groups.clone()))
}

const NONE: u32 = u32::MAX;

/// The two largest positive values of each column of a group, with their rows.
struct TopTwo<T> {
    first: Vec<T>,
    second: Vec<T>,
    first_row: Vec<u32>,
    second_row: Vec<u32>,
}

impl<T: Real> TopTwo<T> {
    fn new(d: usize) -> Self {
        let zeros = vec![T::zero(); d];
        Self { first: zeros.clone(), second: zeros, first_row: vec![NONE; d], second_row: vec![NONE; d] }
    }

    fn find(&mut self, x: &[T], d: usize, group: &Group) {
        self.first.fill(T::zero());
        self.second.fill(T::zero());
        self.first_row.fill(NONE);
        self.second_row.fill(NONE);
        for row in group.start..group.seen {
            for (k, &value) in x[row * d..(row + 1) * d].iter().enumerate() {
                if value > self.first[k] {
                    (self.second[k], self.second_row[k]) = (self.first[k], self.first_row[k]);
                    (self.first[k], self.first_row[k]) = (value, row as u32);
                } else if value > self.second[k] {
                    (self.second[k], self.second_row[k]) = (value, row as u32);
                }
            }
        }
    }
}

#[inline(always)]
fn others_forward<T: Real>(x: &[T], d: usize, groups: &Groups) -> Vec<T> {
    let mut out = vec![T::zero(); 2 * x.len()];
    let (mut first, mut second) = (vec![T::zero(); d], vec![T::zero(); d]);
    for group in groups.as_slice() {
        first.fill(T::zero());
        second.fill(T::zero());
        for row in x[group.start * d..group.seen * d].chunks_exact(d) {
            for ((first, second), &value) in first.iter_mut().zip(&mut second).zip(row) {
                let beaten = if value > *first { *first } else { value };
                *second = beaten.larger(*second);
                *first = value.larger(*first);
            }
        }
        for row in group.start..group.end {
            let (own, others) = out[2 * row * d..2 * (row + 1) * d].split_at_mut(d);
            own.copy_from_slice(&x[row * d..(row + 1) * d]);
            if row >= group.seen {
                others.copy_from_slice(&first);
                continue;
            }
            for (((other, own), &first), &second) in others.iter_mut().zip(own).zip(&first).zip(&second) {
                // If two rows share the maximum, `second` equals it.
                *other = if *own == first { second } else { first };
            }
        }
    }
    out
}

fn others_backward<T: Real>(x: &[T], dy: &[T], d: usize, groups: &Groups) -> Vec<T> {
    let mut dx = vec![T::zero(); x.len()];
    let mut top = TopTwo::new(d);
    let mut total = vec![T::zero(); d];
    let mut at_first = vec![T::zero(); d];
    for group in groups.as_slice() {
        top.find(x, d, group);
        total.fill(T::zero());
        at_first.fill(T::zero());
        for row in group.start..group.end {
            let (own, others) = dy[2 * row * d..2 * (row + 1) * d].split_at(d);
            for (dx, dy) in dx[row * d..(row + 1) * d].iter_mut().zip(own) {
                *dx += *dy;
            }
            for k in 0..d {
                if top.first_row[k] == row as u32 {
                    at_first[k] = others[k];
                } else {
                    total[k] += others[k];
                }
            }
        }
        for k in 0..d {
            if top.first_row[k] != NONE {
                dx[top.first_row[k] as usize * d + k] += total[k];
            }
            if top.second_row[k] != NONE {
                dx[top.second_row[k] as usize * d + k] += at_first[k];
            }
        }
    }
    dx
}

/// For each group and column the row of the largest value, the first of equals.
fn largest_rows<T: Real>(x: &[T], d: usize, groups: &Groups) -> Vec<u32> {
    let mut rows = Vec::with_capacity(groups.len() * d);
    let mut best = vec![T::zero(); d];
    for group in groups.as_slice() {
        let first = rows.len();
        rows.resize(first + d, group.start as u32);
        best.copy_from_slice(&x[group.start * d..(group.start + 1) * d]);
        for row in group.start + 1..group.end {
            for (k, &value) in x[row * d..(row + 1) * d].iter().enumerate() {
                if value > best[k] {
                    best[k] = value;
                    rows[first + k] = row as u32;
                }
            }
        }
    }
    rows
}

/// Number of columns, if the matrix has the rows that the groups cover and no group is empty.
fn columns(layout: &Layout, groups: &Groups) -> Result<usize> {
    let (rows, d) = layout.shape().dims2()?;
    if rows != groups.rows() || groups.as_slice().iter().any(|g| g.start == g.end) {
        candle_core::bail!("{rows} rows for groups of {}, none of which may be empty", groups.rows());
    }
    Ok(d)
}

impl CustomOp1 for MaxOfOthers {
    fn name(&self) -> &'static str {
        "max-of-others"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let d = columns(layout, &self.0)?;
        by_dtype!(x.dtype(), T => {
            let x = slice(x, layout)?;
            let out = wide(#[inline(always)] || others_forward::<T>(x, d, &self.0));
            Ok((candle_core::WithDType::to_cpu_storage_owned(out), (self.0.rows(), 2 * d).into()))
        })
    }

    fn bwd(&self, x: &Tensor, _result: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let gradient = gradient.contiguous()?;
        let d = x.dim(1)?;
        by_dtype!(x.dtype(), T => {
            let dx = with_slice::<T, _>(x, |x| {
                with_slice::<T, _>(&gradient, |dy| others_backward(x, dy, d, &self.0))
            })??;
            Ok(Some(Tensor::from_vec(dx, x.shape(), x.device())?))
        })
    }
}

impl CustomOp1 for MaxOfRows {
    fn name(&self) -> &'static str {
        "max-of-rows"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let d = columns(layout, &self.0)?;
        by_dtype!(x.dtype(), T => {
            let x = slice::<T>(x, layout)?;
            let rows = largest_rows(x, d, &self.0);
            let out: Vec<T> = rows.iter().enumerate().map(|(k, &row)| x[row as usize * d + k % d]).collect();
            Ok((candle_core::WithDType::to_cpu_storage_owned(out), (self.0.len(), d).into()))
        })
    }

    fn bwd(&self, x: &Tensor, _result: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let gradient = gradient.contiguous()?;
        let d = x.dim(1)?;
        by_dtype!(x.dtype(), T => {
            let dx = with_slice::<T, _>(x, |x| {
                with_slice::<T, _>(&gradient, |dy| {
                    let mut dx = vec![0 as T; x.len()];
                    for (k, &row) in largest_rows(x, d, &self.0).iter().enumerate() {
                        dx[row as usize * d + k % d] += dy[k];
                    }
                    dx
                })
            })??;
            Ok(Some(Tensor::from_vec(dx, x.shape(), x.device())?))
        })
    }
}
