//! Products of matrices, over flat row-major slices, on one thread.
//!
//! A number of the product is the sum of its terms in the order of their index, each added with one rounding (a fused
//! multiply-add). Its bits are the same on every processor, with vectors of any width. [`WIDTH`] columns
//! of the second factor at a time are copied into a panel; with it, [`HEIGHT`] rows of the first factor at a time give a
//! tile of the product, whose sums stay in registers. A processor without fused multiply-add takes many times as long.

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
    let (first, second) = (Factor::Plain(a), Factor::Transposed(b));
    pulp::Arch::new().dispatch(Product { out, first, second, bias: Some(bias) });
}

/// `out = a b`.
pub(super) fn times<T: Real>(out: &mut [T], a: Rows<T>, b: Rows<T>) {
    let (first, second) = (Factor::Plain(a), Factor::Plain(b));
    pulp::Arch::new().dispatch(Product { out, first, second, bias: None });
}

/// `out = aᵀ b`.
pub(super) fn transposed_times<T: Real>(out: &mut [T], a: Rows<T>, b: Rows<T>) {
    let (first, second) = (Factor::Transposed(a), Factor::Plain(b));
    pulp::Arch::new().dispatch(Product { out, first, second, bias: None });
}

#[derive(Clone, Copy)]
enum Factor<'a, T> {
    Plain(Rows<'a, T>),
    Transposed(Rows<'a, T>),
}

impl<T> Factor<'_, T> {
    /// Rows and columns of the factor.
    #[inline(always)]
    fn shape(&self) -> [usize; 2] {
        match self {
            Self::Plain(rows) => rows.shape,
            Self::Transposed(rows) => [rows.shape[1], rows.shape[0]],
        }
    }
}

/// A product, with a bias and the positive part after it if there is one. Without closures: one that is not inlined is
/// compiled without fused multiply-add.
struct Product<'a, T> {
    out: &'a mut [T],
    first: Factor<'a, T>,
    second: Factor<'a, T>,
    bias: Option<&'a [T]>,
}

impl<T: Real> pulp::NullaryFnOnce for Product<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { out, first, second, bias } = self;
        let ([rows, _], [depth, columns]) = (first.shape(), second.shape());
        let rows_of_first = match first {
            Factor::Plain(_) => Vec::new(),
            Factor::Transposed(a) => columns_as_rows(a),
        };
        // One panel at a time: it stays in the first cache.
        let mut panel = vec![PanelRow([T::default(); WIDTH]); depth];
        for j in (0..columns).step_by(WIDTH) {
            match second {
                Factor::Plain(b) => fill(&mut panel, b, j),
                Factor::Transposed(b) => fill_transposed(&mut panel, b, j),
            }
            let width = WIDTH.min(columns - j);
            for i in (0..rows).step_by(HEIGHT) {
                let mut tile = match first {
                    Factor::Plain(a) => tile(a, i, &panel),
                    Factor::Transposed(_) => {
                        tile_of_rows(&rows_of_first[i / HEIGHT * depth..][..depth], &panel)
                    }
                };
                if let Some(bias) = bias {
                    add_bias_relu(&mut tile, &bias[j..j + width]);
                }
                for (row, numbers) in tile.iter().enumerate().take(rows - i) {
                    let to = &mut out[(i + row) * columns + j..][..width];
                    if let Some(to) = to.first_chunk_mut() {
                        *to = *numbers;
                    } else {
                        // In a copy of slices the compiler would join both cases to one of unknown length.
                        to.iter_mut().zip(numbers).for_each(|(to, x)| *to = *x);
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn add_bias_relu<T: Real>(tile: &mut Tile<T>, bias: &[T]) {
    let zero = T::default();
    for row in tile {
        for (x, b) in row.iter_mut().zip(bias) {
            let y = *x + *b;
            *x = if y < zero { zero } else { y };
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

/// [`HEIGHT`] rows of the first factor, one number of each at a time, times a panel.
#[inline(always)]
fn tile_of_rows<T: Real>(rows: &[[T; HEIGHT]], panel: &[PanelRow<T>]) -> Tile<T> {
    let mut sums = [[T::default(); WIDTH]; HEIGHT];
    for (a, PanelRow(b)) in rows.iter().zip(panel) {
        add_products(&mut sums, *a, b);
    }
    sums
}

/// Columns of `a` for [`tile_of_rows`], [`HEIGHT`] after [`HEIGHT`]; columns after the last repeat it.
#[inline(always)]
fn columns_as_rows<T: Real>(a: Rows<T>) -> Vec<[T; HEIGHT]> {
    let [depth, columns] = a.shape;
    let mut all = Vec::with_capacity(depth * columns.div_ceil(HEIGHT));
    for first in (0..columns).step_by(HEIGHT) {
        for row in a.numbers.chunks_exact(columns) {
            all.push(match row[first..].first_chunk() {
                Some(numbers) => *numbers,
                None => array::from_fn(|k| row[(first + k).min(columns - 1)]),
            });
        }
    }
    all
}

#[inline(always)]
fn add_products<T: Real>(sums: &mut Tile<T>, a: [T; HEIGHT], b: &[T; WIDTH]) {
    for (sums, a) in sums.iter_mut().zip(a) {
        for (sum, b) in sums.iter_mut().zip(b) {
            *sum = a.times_plus(*b, *sum);
        }
    }
}

/// Fills a panel with columns of `b` from `first` on; those after the last are not read.
#[inline(always)]
fn fill<T: Real>(panel: &mut [PanelRow<T>], b: Rows<T>, first: usize) {
    for (to, row) in panel.iter_mut().zip(b.numbers.chunks_exact(b.shape[1])) {
        if let Some(row) = row[first..].first_chunk() {
            to.0 = *row;
        } else {
            to.0.iter_mut().zip(&row[first..]).for_each(|(to, x)| *to = *x);
        }
    }
}

/// Fills a panel with rows of `b` from `first` on, as columns.
#[inline(always)]
fn fill_transposed<T: Real>(panel: &mut [PanelRow<T>], b: Rows<T>, first: usize) {
    for k in 0..WIDTH.min(b.shape[0] - first) {
        for (to, x) in panel.iter_mut().zip(b.row(first + k)) {
            to.0[k] = *x;
        }
    }
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
