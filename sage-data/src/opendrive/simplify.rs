//! Removal of points that hardly change a line (Douglas and Peucker).

/// Longest stretch that is simplified as a whole, points. The search is quadratic in the worst case, and this
/// bounds it.
const STRETCH: usize = 1024;

/// Indices of the points that stay, in order, of a line of `count` points. `deviation(a, b, k)` is the
/// distance of point `k` from the chord from `a` to `b`; removed points deviate by at most `tolerance`.
pub(super) fn kept(
    count: usize,
    tolerance: f64,
    deviation: impl Fn(usize, usize, usize) -> f64,
) -> Vec<usize> {
    let Some(last) = count.checked_sub(1) else { return Vec::new() };
    let mut keeps = vec![false; count];
    keeps[last] = true;
    let mut stack: Vec<[usize; 2]> = Vec::new();
    for start in (0..count).step_by(STRETCH) {
        keeps[start] = true;
        stack.push([start, (start + STRETCH).min(last)]);
    }
    while let Some([a, b]) = stack.pop() {
        let farthest = (a + 1..b).map(|k| (k, deviation(a, b, k))).max_by(|x, y| x.1.total_cmp(&y.1));
        if let Some((k, distance)) = farthest
            && distance > tolerance
        {
            keeps[k] = true;
            stack.push([a, k]);
            stack.push([k, b]);
        }
    }
    (0..count).filter(|&k| keeps[k]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_stay_and_points_on_a_line_go() {
        let heights: Vec<f64> = (0..3000).map(|k: i32| f64::from((k - 1500).abs())).collect();
        let deviation = |a: usize, b: usize, k: usize| {
            let share = (k - a) as f64 / (b - a) as f64;
            (heights[a] + share * (heights[b] - heights[a]) - heights[k]).abs()
        };
        // The corner, the ends, and one point each 1024.
        assert_eq!(kept(heights.len(), 0.01, deviation), [0, 1024, 1500, 2048, 2999]);
        assert_eq!(kept(1, 0.01, deviation), [0]);
        assert!(kept(0, 0.01, deviation).is_empty());
    }
}
