//! Products of matrices, over flat row-major slices, on one thread.
//!
//! A number of the product is the sum of its terms in the order of their index, each added with one rounding (a fused
//! multiply-add). Its bits are the same on every processor, with vectors of any width. The second factor is copied into
//! panels of [`WIDTH`] columns, which stay in the cache while [`HEIGHT`] rows of the first factor at a time give a tile
//! of the product, whose sums stay in registers. A processor without fused multiply-add takes many times as long.

use std::array;

use super::kernels::Real;

/// Columns of a panel: two vectors of AVX2 in `f32`.
const WIDTH: usize = 16;
/// Rows of a tile: its sums fill 12 of the 16 registers of AVX2.
const HEIGHT: usize = 6;

/// A row of a panel; aligned, so that no vector lies in two lines of the cache.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct PanelRow<T>([T; WIDTH]);

type Tile<T> = [[T; WIDTH]; HEIGHT];

/// A row-major matrix in a slice: the numbers, and how many rows and columns.
#[derive(Clone, Copy)]
pub(super) struct Rows<'a, T> {
    pub(super) numbers: &'a [T],
    pub(super) shape: [usize; 2],
}

impl<'a, T> Rows<'a, T> {
    pub(super) fn new(numbers: &'a [T], shape: [usize; 2]) -> Self {
        debug_assert_eq!(numbers.len(), shape[0] * shape[1]);
        Self { numbers, shape }
    }

    #[inline(always)]
    fn row(&self, k: usize) -> &'a [T] {
        &self.numbers[k * self.shape[1]..][..self.shape[1]]
    }
}

/// `out = max(0, a bᵀ + bias)`, with one bias for each column. NaN stays NaN.
pub(super) fn relu_layer<T: Real>(out: &mut [T], a: Rows<T>, b: Rows<T>, bias: &[T]) {
    pulp::Arch::new().dispatch(ReluLayer { out, a, b, bias });
}

/// `out = a b`.
pub(super) fn times<T: Real>(out: &mut [T], a: Rows<T>, b: Rows<T>) {
    pulp::Arch::new().dispatch(Times { out, a, b });
}

/// `out = aᵀ b`.
pub(super) fn transposed_times<T: Real>(out: &mut [T], a: Rows<T>, b: Rows<T>) {
    pulp::Arch::new().dispatch(TransposedTimes { out, a, b });
}

struct ReluLayer<'a, T> {
    out: &'a mut [T],
    a: Rows<'a, T>,
    b: Rows<'a, T>,
    bias: &'a [T],
}

impl<T: Real> pulp::NullaryFnOnce for ReluLayer<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { out, a, b, bias } = self;
        let zero = T::default();
        tiles(
            out,
            [a.shape[0], b.shape[0]],
            &panels_of_transposed(b),
            |row, panel| tile(a, row, panel),
            |j, row| {
                let bias = &bias[j..][..row.len()];
                for (x, b) in row.iter_mut().zip(bias) {
                    let y = *x + *b;
                    *x = if y < zero { zero } else { y };
                }
            },
        );
    }
}

struct Times<'a, T> {
    out: &'a mut [T],
    a: Rows<'a, T>,
    b: Rows<'a, T>,
}

impl<T: Real> pulp::NullaryFnOnce for Times<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { out, a, b } = self;
        tiles(out, [a.shape[0], b.shape[1]], &panels(b), |row, panel| tile(a, row, panel), |_, _| ());
    }
}

struct TransposedTimes<'a, T> {
    out: &'a mut [T],
    a: Rows<'a, T>,
    b: Rows<'a, T>,
}

impl<T: Real> pulp::NullaryFnOnce for TransposedTimes<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { out, a, b } = self;
        let tile = |row: usize, panel: &[PanelRow<T>]| tile_of_transposed(a, row, panel);
        tiles(out, [a.shape[1], b.shape[1]], &panels(b), tile, |_, _| ());
    }
}

/// Writes the tiles of a product of some shape; `finish` changes a piece of a row from a column on.
#[inline(always)]
fn tiles<T: Real>(
    out: &mut [T],
    [rows, columns]: [usize; 2],
    panels: &[PanelRow<T>],
    tile: impl Fn(usize, &[PanelRow<T>]) -> Tile<T>,
    finish: impl Fn(usize, &mut [T]),
) {
    let depth = panels.len() / columns.div_ceil(WIDTH);
    for (panel, j) in panels.chunks_exact(depth).zip((0..columns).step_by(WIDTH)) {
        let width = WIDTH.min(columns - j);
        for i in (0..rows).step_by(HEIGHT) {
            let tile = tile(i, panel);
            for (row, numbers) in tile.iter().enumerate().take(rows - i) {
                let to = &mut out[(i + row) * columns + j..][..width];
                // A copy of known length is two instructions.
                match to.first_chunk_mut() {
                    Some(to) => *to = *numbers,
                    None => to.copy_from_slice(&numbers[..width]),
                }
                finish(j, to);
            }
        }
    }
}

/// Rows `first` to `first + HEIGHT` of `a` times a panel; rows after the last repeat it.
#[inline(always)]
fn tile<T: Real>(a: Rows<T>, first: usize, panel: &[PanelRow<T>]) -> Tile<T> {
    let mut sums = [[T::default(); WIDTH]; HEIGHT];
    let [a0, a1, a2, a3, a4, a5] = array::from_fn(|k| a.row((first + k).min(a.shape[0] - 1)));
    // Iterators in step: an index would be checked in each of the rows.
    let rows = panel.iter().zip(a0).zip(a1).zip(a2).zip(a3).zip(a4).zip(a5);
    for ((((((PanelRow(b), a0), a1), a2), a3), a4), a5) in rows {
        add_products(&mut sums, [*a0, *a1, *a2, *a3, *a4, *a5], b);
    }
    sums
}

/// Columns `first` to `first + HEIGHT` of `a`, as rows, times a panel; columns after the last repeat it.
#[inline(always)]
fn tile_of_transposed<T: Real>(a: Rows<T>, first: usize, panel: &[PanelRow<T>]) -> Tile<T> {
    let mut sums = [[T::default(); WIDTH]; HEIGHT];
    for (PanelRow(b), a) in panel.iter().zip(a.numbers.chunks_exact(a.shape[1])) {
        let a = match a[first..].first_chunk() {
            Some(a) => *a,
            None => array::from_fn(|k| a[(first + k).min(a.len() - 1)]),
        };
        add_products(&mut sums, a, b);
    }
    sums
}

#[inline(always)]
fn add_products<T: Real>(sums: &mut Tile<T>, a: [T; HEIGHT], b: &[T; WIDTH]) {
    for (sums, a) in sums.iter_mut().zip(a) {
        for (sum, b) in sums.iter_mut().zip(b) {
            *sum = a.times_plus(*b, *sum);
        }
    }
}

/// The panels of a matrix; columns after the last are 0.
#[inline(always)]
fn panels<T: Real>(b: Rows<T>) -> Vec<PanelRow<T>> {
    let [depth, columns] = b.shape;
    let mut panels = empty_panels(depth, columns);
    for (panel, j) in panels.chunks_exact_mut(depth).zip((0..columns).step_by(WIDTH)) {
        for (to, row) in panel.iter_mut().zip(b.numbers.chunks_exact(columns)) {
            match row[j..].first_chunk() {
                Some(row) => to.0 = *row,
                None => to.0[..columns - j].copy_from_slice(&row[j..]),
            }
        }
    }
    panels
}

/// The panels of a transposed matrix; columns after the last are 0.
#[inline(always)]
fn panels_of_transposed<T: Real>(b: Rows<T>) -> Vec<PanelRow<T>> {
    let [columns, depth] = b.shape;
    let mut panels = empty_panels(depth, columns);
    for (panel, j) in panels.chunks_exact_mut(depth).zip((0..columns).step_by(WIDTH)) {
        for k in 0..WIDTH.min(columns - j) {
            for (to, x) in panel.iter_mut().zip(b.row(j + k)) {
                to.0[k] = *x;
            }
        }
    }
    panels
}

fn empty_panels<T: Real>(depth: usize, columns: usize) -> Vec<PanelRow<T>> {
    vec![PanelRow([T::default(); WIDTH]); depth * columns.div_ceil(WIDTH)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::seed::Rng;

    fn numbers(count: usize, seed: u64) -> Vec<f32> {
        let mut rng = Rng::new(seed, "matrix", "product");
        (0..count).map(|_| rng.normal() as f32).collect()
    }

    fn transposed(numbers: &[f32], [rows, columns]: [usize; 2]) -> Vec<f32> {
        (0..columns).flat_map(|j| (0..rows).map(move |i| numbers[i * columns + j])).collect()
    }

    /// The definition, term by term.
    fn product(a: &[f32], b: &[f32], [rows, depth, columns]: [usize; 3]) -> Vec<f32> {
        let number = |i: usize, j: usize| {
            (0..depth).fold(0.0_f32, |sum, k| a[i * depth + k].mul_add(b[k * columns + j], sum))
        };
        (0..rows).flat_map(|i| (0..columns).map(move |j| number(i, j))).collect()
    }

    #[test]
    fn products_of_every_size_have_the_bits_of_the_definition() {
        for rows in [1, 2, 5, 6, 7, 12, 13] {
            for columns in [1, 3, 15, 16, 17, 32, 33] {
                for depth in [1, 2, 7, 8, 9, 40] {
                    let shape = [rows, depth, columns];
                    let (a, b) = (numbers(rows * depth, 1), numbers(depth * columns, 2));
                    let expected = product(&a, &b, shape);
                    let mut out = vec![f32::NAN; rows * columns];
                    times(&mut out, Rows::new(&a, [rows, depth]), Rows::new(&b, [depth, columns]));
                    assert_eq!(out, expected, "{shape:?}");
                    out.fill(f32::NAN);
                    let turned = transposed(&a, [rows, depth]);
                    transposed_times(
                        &mut out,
                        Rows::new(&turned, [depth, rows]),
                        Rows::new(&b, [depth, columns]),
                    );
                    assert_eq!(out, expected, "{shape:?}");
                    let (bias, turned) = (numbers(columns, 3), transposed(&b, [depth, columns]));
                    relu_layer(
                        &mut out,
                        Rows::new(&a, [rows, depth]),
                        Rows::new(&turned, [columns, depth]),
                        &bias,
                    );
                    let biased = expected.iter().zip(bias.iter().cycle());
                    let expected: Vec<f32> = biased.map(|(x, b)| (x + b).max(0.0)).collect();
                    assert_eq!(out, expected, "{shape:?}");
                }
            }
        }
    }

    #[test]
    fn the_positive_part_of_nan_is_nan() {
        let mut out = [0.0_f64; 2];
        relu_layer(&mut out, Rows::new(&[1.0], [1, 1]), Rows::new(&[f64::NAN, -1.0], [2, 1]), &[0.0, 0.5]);
        assert!(out[0].is_nan());
        assert_eq!(out[1], 0.0);
    }
}
