//! When a nominal plan is where: shifts along the path of its trajectory.
//!
//! A prior gives a goal one trajectory, and recorded cars keep to its path at other times. A plan shifted by a (metres) has driven
//!
//! `s'(t) = s(t) + a · 6.75 τ² (1 − τ)`, τ = t / 8 s,
//!
//! of it: like the trajectory *now* and at its end, and a metres further where the difference is largest, at 5.3 s. It never drives
//! backwards, or beyond the end.

use sage_core::{
    Error,
    geometry::{Point, distance, dot, sub},
    motion::{HORIZON, Trajectory},
};

/// A trajectory by the way along its path.
#[derive(Clone, Debug)]
pub struct TimedPath {
    /// *Now* and the steps.
    points: Vec<Point>,
    /// Way to each, metres.
    ways: Vec<f64>,
}

impl TimedPath {
    /// A trajectory that starts at a point.
    pub fn new(start: Point, trajectory: &Trajectory) -> Self {
        let points: Vec<Point> = std::iter::once(start).chain(trajectory.points().iter().copied()).collect();
        let mut ways = vec![0.0];
        for pair in points.windows(2) {
            ways.push(ways[ways.len() - 1] + distance(pair[0], pair[1]));
        }
        Self { points, ways }
    }

    /// The trajectory shifted by so many metres.
    ///
    /// *Errors*: none where the trajectory itself is one.
    ///
    /// ```
    /// use sage_core::motion::Trajectory;
    /// use sage_generators::TimedPath;
    ///
    /// let even = Trajectory::new("plan", (1..=80).map(|step| [f64::from(step), 0.0]).collect())?;
    /// let path = TimedPath::new([0.0, 0.0], &even);
    /// let later = path.shifted(-2.0)?;
    /// assert!((later.points()[52][0] - 51.0).abs() < 0.001);
    /// assert_eq!(later.points()[79], [80.0, 0.0]);
    /// assert!((path.shift_of(later.points()) + 2.0).abs() < 1e-9);
    /// # Ok::<(), sage_core::Error>(())
    /// ```
    pub fn shifted(&self, metres: f64) -> Result<Trajectory, Error> {
        let mut way: f64 = 0.0;
        let end = self.ways[HORIZON];
        let mut k = 0;
        let point = |step: usize| {
            way = way.max((self.ways[step] + metres * shift_share(step)).min(end));
            while k + 1 < HORIZON && self.ways[k + 1] < way {
                k += 1;
            }
            let length = self.ways[k + 1] - self.ways[k];
            let along = if length > 0.0 { ((way - self.ways[k]) / length).min(1.0) } else { 1.0 };
            let [from, to] = [self.points[k], self.points[k + 1]];
            [0, 1].map(|axis| from[axis] + along * (to[axis] - from[axis]))
        };
        Trajectory::new("shifted plan", (1..=HORIZON).map(point).collect())
    }

    /// How much further along the path than the trajectory another motion is at each of its steps, metres.
    pub fn further(&self, steps: &[Point]) -> Vec<f64> {
        let ahead = |(k, point): (usize, &Point)| self.way_of(*point) - self.ways[k + 1];
        steps.iter().take(HORIZON).enumerate().map(ahead).collect()
    }

    /// The shift that is nearest to another motion (least squares), metres.
    pub fn shift_of(&self, steps: &[Point]) -> f64 {
        let further = self.further(steps);
        let shares = || (1..=further.len()).map(shift_share);
        let product: f64 = shares().zip(&further).map(|(share, ahead)| share * ahead).sum();
        let squares: f64 = shares().map(|share| share * share).sum();
        if squares > 0.0 { product / squares } else { 0.0 }
    }

    /// Way along the path to the point of it that is nearest.
    fn way_of(&self, point: Point) -> f64 {
        let mut nearest = (f64::INFINITY, 0.0);
        for (pair, ways) in self.points.windows(2).zip(self.ways.windows(2)) {
            let step = sub(pair[1], pair[0]);
            let squared = dot(step, step);
            let along =
                if squared > 0.0 { (dot(sub(point, pair[0]), step) / squared).clamp(0.0, 1.0) } else { 0.0 };
            let from = distance(point, [pair[0][0] + along * step[0], pair[0][1] + along * step[1]]);
            if from < nearest.0 {
                nearest = (from, ways[0] + along * (ways[1] - ways[0]));
            }
        }
        nearest.1
    }
}

/// Share of a shift at a step: 1 at 5.3 s, 0 *now* and at the end.
pub fn shift_share(step: usize) -> f64 {
    let tau = step as f64 / HORIZON as f64;
    6.75 * tau * tau * (1.0 - tau)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bend, driven ever slower.
    fn braking() -> Trajectory {
        let at = |step: i32| {
            let t = 0.1 * f64::from(step);
            let way = 9.0 * t - 0.5 * t * t;
            [30.0 * (way / 30.0).sin(), 30.0 - 30.0 * (way / 30.0).cos()]
        };
        Trajectory::new("plan", (1..=80).map(at).collect()).unwrap()
    }

    #[test]
    fn shifts_keep_the_path_and_the_end_and_never_go_back() {
        let plan = braking();
        let path = TimedPath::new([0.0, 0.0], &plan);
        assert!(
            plan.points()
                .iter()
                .zip(path.shifted(0.0).unwrap().points())
                .all(|(a, b)| distance(*a, *b) < 1e-9)
        );
        for metres in [-40.0, -4.0, -0.5, 0.8, 3.0, 40.0] {
            let shifted = path.shifted(metres).unwrap();
            assert!(distance(shifted.points()[79], plan.points()[79]) < 1e-9 || metres < -20.0, "{metres}");
            let ways: Vec<f64> = shifted.points().iter().map(|point| path.way_of(*point)).collect();
            assert!(ways.windows(2).all(|pair| pair[1] >= pair[0] - 1e-9), "{metres}");
            // No corner is cut: all points lie on the path of the plan.
            let circle = |point: &Point| (distance(*point, [0.0, 30.0]) - 30.0).abs();
            assert!(shifted.points().iter().all(|point| circle(point) < 0.01), "{metres}");
            // 3 m further is beyond the end, for a car that is slow there.
            if (-5.0..1.0).contains(&metres) {
                assert!((path.shift_of(shifted.points()) - metres).abs() < 0.01, "{metres}");
            }
        }
    }

    #[test]
    fn a_car_that_stands_has_one_timing() {
        let standing = Trajectory::new("plan", vec![[1.0, 2.0]; 80]).unwrap();
        let path = TimedPath::new([1.0, 2.0], &standing);
        assert_eq!(path.shifted(3.0).unwrap(), standing);
        assert_eq!(path.shift_of(standing.points()), 0.0);
    }
}
