//! The adversary's path as a NURBS: a rational B-spline of degree 3 with five control points.
//!
//! The ends of the curve are the first and the last control point. There is one interior knot; a fit puts it between the
//! parameters of the two middle points, and finds the three inner control points by least squares (Piegl and Tiller, The
//! NURBS Book, 1997, section 9.4.1). Parameters of the points are their shares of the length of the path.

use nalgebra::{DMatrix, Matrix3x2};
use sage_core::geometry::{Point, distance};

use super::ACTION;

const DEGREE: usize = 3;
/// Number of control points.
pub const CONTROL_POINTS: usize = 5;
/// Knots that bound the interior one: each control point keeps a part of the curve, also where a car stands half the time.
const KNOT_RANGE: [f64; 2] = [0.05, 0.95];
/// Range of weights.
const WEIGHTS: [f64; 2] = [0.1, 1000.0];
/// Paths shorter than this have no shape, metres.
const SHORTEST: f64 = 1e-6;

/// A curve. Its parameter runs from 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// The interior knot.
    pub knot: f64,
    /// Weights of the control points.
    pub weights: [f64; CONTROL_POINTS],
    /// Control points, metres.
    pub points: [Point; CONTROL_POINTS],
}

impl Curve {
    /// The curve nearest to a path, with equal weights; `None` for a path without points.
    pub fn fit(path: &[Point]) -> Option<Self> {
        let (&first, &last) = (path.first()?, path.last()?);
        let parameters = parameters(path);
        // The published library's knot: d = n / 2 points belong to each of the two spans.
        let share = path.len() as f64 / (CONTROL_POINTS - DEGREE) as f64;
        let whole = (share as usize).max(1);
        let part = share - share.trunc();
        let after = parameters[whole.min(path.len() - 1)];
        let knot = (1.0 - part) * parameters[whole - 1] + part * after;
        let knot = knot.clamp(KNOT_RANGE[0], KNOT_RANGE[1]);
        // Control points are sought as changes of equal steps from end to end, so that the least change is found where
        // the points do not determine them.
        let line: [Point; CONTROL_POINTS] = std::array::from_fn(|k| {
            let share = k as f64 / (CONTROL_POINTS - 1) as f64;
            [0, 1].map(|axis| first[axis] + share * (last[axis] - first[axis]))
        });
        let mut curve = Self { knot, weights: [1.0; CONTROL_POINTS], points: line };
        let inner = &path[1..path.len().max(2) - 1];
        let bases: Vec<_> = parameters.iter().skip(1).take(inner.len()).map(|u| curve.basis(*u)).collect();
        let rows = DMatrix::from_fn(inner.len(), CONTROL_POINTS - 2, |row, k| bases[row][k + 1]);
        let errors = DMatrix::from_fn(inner.len(), 2, |row, axis| {
            let on_line: f64 = bases[row].iter().zip(&line).map(|(b, p)| b * p[axis]).sum();
            inner[row][axis] - on_line
        });
        const TOLERANCE: f64 = 1e-12;
        let changes = match inner.len() {
            0 => None,
            // The decomposition is asked for both of its factors, so it can solve.
            _ => rows.svd(true, true).solve(&errors, TOLERANCE).ok(),
        };
        let changes = changes.map_or_else(Matrix3x2::zeros, |x| x.fixed_view::<3, 2>(0, 0).into_owned());
        for k in 0..CONTROL_POINTS - 2 {
            for axis in 0..2 {
                curve.points[k + 1][axis] += changes[(k, axis)];
            }
        }
        Some(curve)
    }

    /// The point at a parameter.
    pub fn at(&self, parameter: f64) -> Point {
        let basis = self.basis(parameter);
        let shares: [f64; CONTROL_POINTS] = std::array::from_fn(|k| basis[k] * self.weights[k]);
        let sum: f64 = shares.iter().sum();
        [0, 1].map(|axis| shares.iter().zip(&self.points).map(|(s, p)| s * p[axis]).sum::<f64>() / sum)
    }

    /// The curve after an action: changes of the weights of all control points but the first, then of their x, then of
    /// their y, metres.
    pub fn changed(&self, action: &[f64; ACTION]) -> Self {
        const CHANGED: usize = CONTROL_POINTS - 1;
        let mut curve = self.clone();
        for k in 0..CHANGED {
            curve.weights[k + 1] += action[k];
            curve.points[k + 1][0] += action[CHANGED + k];
            curve.points[k + 1][1] += action[2 * CHANGED + k];
        }
        curve.weights = curve.weights.map(|weight| weight.clamp(WEIGHTS[0], WEIGHTS[1]));
        curve
    }

    /// What a policy sees of it: weights and then x, y of all control points but the first.
    pub fn state(&self) -> [f64; ACTION] {
        const CHANGED: usize = CONTROL_POINTS - 1;
        std::array::from_fn(|k| match k.checked_sub(CHANGED) {
            None => self.weights[k + 1],
            Some(k) => self.points[k / 2 + 1][k % 2],
        })
    }

    /// Values of the basis functions at a parameter, by the recursion of Cox and de Boor.
    fn basis(&self, parameter: f64) -> [f64; CONTROL_POINTS] {
        const KNOTS: usize = CONTROL_POINTS + DEGREE + 1;
        let knots: [f64; KNOTS] = std::array::from_fn(|k| match k {
            0..=DEGREE => 0.0,
            CONTROL_POINTS.. => 1.0,
            _ => self.knot,
        });
        let u = parameter.clamp(0.0, 1.0);
        // At 1 the last span counts: elsewhere spans do not contain their end.
        let span = if u < self.knot { DEGREE } else { DEGREE + 1 };
        let mut values = [0.0; KNOTS - 1];
        values[span] = 1.0;
        let ratio = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
        for degree in 1..=DEGREE {
            for k in 0..KNOTS - 1 - degree {
                let rising = ratio(u - knots[k], knots[k + degree] - knots[k]);
                let end = knots[k + degree + 1];
                let falling = ratio(end - u, end - knots[k + 1]);
                values[k] = rising * values[k] + falling * values[k + 1];
            }
        }
        std::array::from_fn(|k| values[k])
    }
}

/// Share of the length of a path up to each point; equal steps for a path without length.
fn parameters(path: &[Point]) -> Vec<f64> {
    let mut length = 0.0;
    let mut lengths = vec![0.0];
    for pair in path.windows(2) {
        length += distance(pair[0], pair[1]);
        lengths.push(length);
    }
    if length < SHORTEST {
        let last = (path.len() - 1).max(1) as f64;
        return (0..path.len()).map(|k| k as f64 / last).collect();
    }
    lengths.iter().map(|part| part / length).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SciPy's `BSpline` (1.17.1): knot and control points of a least-squares fit with fixed ends, and values without and
    /// with weights. geomdl 5.4 (`approximate_curve`) gives the same control points.
    struct Golden {
        knot: f64,
        points: [Point; 5],
        at: [f64; 8],
        plain: [Point; 8],
        weighted: [Point; 8],
    }

    const WEIGHTED: [f64; 5] = [1.0, 1.5, 0.7, 2.0, 1.2];

    const ACCELERATES: Golden = Golden {
        knot: 0.42238069503303577,
        points: [
            [0.0, 0.0],
            [12.567530759100219, 1.3357049455660204],
            [42.51298446231607, 2.148445359099993],
            [72.33447688547494, -0.6605494154411619],
            [89.6, -1.1352037429618922],
        ],
        at: [0.0, 0.1, 0.25, 0.5, 0.4, 0.8, 0.99, 1.0],
        plain: [
            [0.0, 0.0],
            [8.938440206197356, 0.7864112592106068],
            [22.379149715652417, 1.4005362678225826],
            [44.80097926371623, 1.14943503241234],
            [35.83492281213365, 1.4187871048340548],
            [71.67652550199773, -0.32711849566464823],
            [88.70331055362198, -1.1095315688695107],
            [89.6, -1.1352037429618922],
        ],
        weighted: [
            [0.0, 0.0],
            [9.289715684159859, 0.8733736907119856],
            [20.104339977153003, 1.2738460457610015],
            [48.68492839860083, 0.6274196940794947],
            [36.02905731116824, 1.055497303072231],
            [73.1574230253166, -0.539776789732225],
            [88.1792920333046, -1.095569797043342],
            [89.6, -1.1352037429618922],
        ],
    };
    const TURNS: Golden = Golden {
        knot: 0.4944444444444443,
        points: [
            [0.0, 0.0],
            [5.944160103291462, -0.06116233365087801],
            [17.83091811324714, 5.732194418773627],
            [20.923966947035403, 18.635850225124518],
            [19.476952617563903, 24.544041893861742],
        ],
        at: [0.0, 0.1, 0.25, 0.5, 0.4, 0.8, 0.99, 1.0],
        plain: [
            [0.0, 0.0],
            [3.581137357989447, 0.31207994560862085],
            [8.695922117100517, 1.9975733226816046],
            [15.673828970256574, 7.561921553804371],
            [13.192220682057442, 4.96710622257771],
            [19.82797881654185, 17.393833882951675],
            [19.55929140879728, 24.19274248241971],
            [19.476952617563903, 24.544041893861742],
        ],
        weighted: [
            [0.0, 0.0],
            [3.8530343371787215, 0.20415613256520723],
            [7.799580635286667, 1.702756069689508],
            [15.511491480906027, 9.299924217808947],
            [12.256410245276262, 5.4886370539656175],
            [20.221161839914902, 18.350154502510417],
            [19.61015772457184, 23.99157171825866],
            [19.476952617563903, 24.544041893861742],
        ],
    };

    fn check(path: &[Point], golden: &Golden) {
        let close = |a: Point, b: Point| assert!(distance(a, b) < 1e-9, "{a:?} {b:?}");
        let curve = Curve::fit(path).unwrap();
        assert!((curve.knot - golden.knot).abs() < 1e-12);
        curve.points.iter().zip(&golden.points).for_each(|(a, b)| close(*a, *b));
        let weighted = Curve { weights: WEIGHTED, ..curve.clone() };
        for (k, u) in golden.at.iter().enumerate() {
            close(curve.at(*u), golden.plain[k]);
            close(weighted.at(*u), golden.weighted[k]);
        }
    }

    #[test]
    fn fits_and_values_equal_those_of_scipy() {
        let accelerates = |k: usize| {
            let t = 0.1 * k as f64;
            [8.0 * t + 0.4 * t * t, 1.5 * (0.5 * t).sin()]
        };
        check(&(0..81).map(accelerates).collect::<Vec<_>>(), &ACCELERATES);
        let turns = |k: usize| {
            let angle = 0.02 * k as f64;
            [20.0 * angle.sin(), 20.0 * (1.0 - angle.cos())]
        };
        check(&(0..91).map(turns).collect::<Vec<_>>(), &TURNS);
    }

    #[test]
    fn standing_cars_and_short_paths_have_a_curve() {
        assert!(Curve::fit(&[]).is_none());
        for path in [vec![[3.0, 4.0]], vec![[3.0, 4.0]; 81], vec![[3.0, 4.0]; 2]] {
            let curve = Curve::fit(&path).unwrap();
            assert!(curve.points.iter().all(|point| distance(*point, [3.0, 4.0]) < 1e-9), "{curve:?}");
        }
        // It stands for 5 s and then leaves: all its control points are on its path.
        let leaves = |k: usize| [0.05 * (k.saturating_sub(50) as f64).powi(2), 0.0];
        let path: Vec<Point> = (0..81).map(leaves).collect();
        let curve = Curve::fit(&path).unwrap();
        let within = |p: &Point| (-1.0..=46.0).contains(&p[0]) && p[1].abs() < 1e-9;
        assert!(curve.points.iter().all(within), "{curve:?}");
        assert_eq!((curve.at(0.0), curve.at(1.0)), (path[0], path[80]));
    }

    #[test]
    fn actions_move_all_control_points_but_the_first() {
        let curve = Curve::fit(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]]).unwrap();
        let action = std::array::from_fn(|k| 0.1 * k as f64 - 0.5);
        let changed = curve.changed(&action);
        assert_eq!(changed.points[0], curve.points[0]);
        assert_eq!(changed.weights[0], 1.0);
        assert!((changed.weights[4] - 0.8).abs() < 1e-12);
        assert!((changed.points[1][0] - curve.points[1][0] + 0.1).abs() < 1e-12);
        assert!((changed.points[4][1] - curve.points[4][1] - 0.6).abs() < 1e-12);
        let [weights, points] = [changed.state()[3], changed.state()[11]];
        assert_eq!([weights, points], [changed.weights[4], changed.points[4][1]]);
        let least = (0..30).fold(curve, |curve, _| curve.changed(&[-1.0; ACTION]));
        assert_eq!(least.weights, [1.0, 0.1, 0.1, 0.1, 0.1]);
    }
}
