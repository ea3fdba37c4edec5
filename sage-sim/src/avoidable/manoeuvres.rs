//! The manoeuvres that are tried from a start, the likeliest to succeed first.

use super::limits::AvoidanceOptions;

/// Accelerations as shares of the limits, brake below 0; sidesteps, metres, positive to the left. Each finer grid
/// holds the coarser one.
const ACCELERATIONS: [f64; 7] = [-1.0, -0.75, -0.5, -0.25, 0.0, 0.5, 1.0];
const SIDESTEPS: [f64; 7] = [-3.5, -2.0, -1.0, 0.0, 1.0, 2.0, 3.5];
/// Times at which a manoeuvre of two phases changes its acceleration, seconds.
const SWITCHES: [f64; 3] = [0.3, 0.6, 1.2];
/// Accelerations of the phases, as shares.
const PHASES: [f64; 3] = [-1.0, 0.0, 1.0];

/// What the driver does from the start on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Manoeuvre {
    /// Acceleration up to the switch, and after it, m/s².
    pub(super) accelerations: [f64; 2],
    /// When it changes, seconds from the start.
    pub(super) switch: f64,
    /// Change of the offset from the line, metres; `None` follows the recorded path itself.
    pub(super) sidestep: Option<f64>,
}

impl Manoeuvre {
    fn held(acceleration: f64, sidestep: Option<f64>) -> Self {
        Self { accelerations: [acceleration; 2], switch: 0.0, sidestep }
    }

    /// Commanded acceleration at a time from the start, seconds.
    pub(super) fn acceleration(&self, time: f64) -> f64 {
        self.accelerations[usize::from(time + 1e-9 >= self.switch)]
    }

    /// Whether it brakes on the recorded path.
    pub(super) fn brakes(&self) -> bool {
        self.sidestep.is_none()
    }

    /// Whether it steers with its speed unchanged.
    pub(super) fn steers(&self) -> bool {
        self.sidestep.is_some_and(|sidestep| sidestep != 0.0) && self.accelerations == [0.0; 2]
    }

    /// Largest deceleration, m/s².
    pub(super) fn deceleration(&self) -> f64 {
        self.accelerations.iter().fold(0.0, |most, a| f64::max(most, -a))
    }
}

/// All manoeuvres of a search.
pub(super) fn manoeuvres(options: &AvoidanceOptions) -> Vec<Manoeuvre> {
    let scaled = |share: f64| share * if share < 0.0 { options.brake } else { options.accelerate };
    let halvings = options.refinement.saturating_sub(1);
    let (accelerations, sidesteps) = (halved(&ACCELERATIONS, halvings), halved(&SIDESTEPS, halvings));
    let brakes = accelerations.iter().filter(|share| **share < 0.0);
    let mut all: Vec<Manoeuvre> = brakes.map(|share| Manoeuvre::held(scaled(*share), None)).collect();
    let held = accelerations
        .iter()
        .flat_map(|share| sidesteps.iter().map(|side| Manoeuvre::held(scaled(*share), Some(*side))));
    all.extend(held);
    if options.refinement >= 1 {
        for switch in SWITCHES {
            for first in PHASES {
                for then in PHASES.iter().filter(|then| **then != first) {
                    let accelerations = [first, *then].map(scaled);
                    let sidesteps = sidesteps.iter();
                    all.extend(sidesteps.map(|side| Manoeuvre {
                        accelerations,
                        switch,
                        sidestep: Some(*side),
                    }));
                }
            }
        }
    }
    all
}

/// A grid with the middle of each cell added, several times.
fn halved(grid: &[f64], times: u32) -> Vec<f64> {
    let mut all = grid.to_vec();
    for _ in 0..times {
        let middles: Vec<f64> = all.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
        all.extend(middles);
        all.sort_by(f64::total_cmp);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_search_holds_the_coarser_ones() {
        let of = |refinement| manoeuvres(&AvoidanceOptions { refinement, ..AvoidanceOptions::default() });
        let counts: Vec<usize> = (0..4).map(|refinement| of(refinement).len()).collect();
        assert_eq!(counts, [4 + 49, 4 + 49 + 126, 8 + 169 + 234, 16 + 625 + 450]);
        for refinement in 0..4 {
            let (coarse, fine) = (of(refinement), of(refinement + 1));
            assert!(coarse.iter().all(|manoeuvre| fine.contains(manoeuvre)), "{refinement}");
        }
        let all = of(1);
        assert_eq!(all.iter().filter(|m| m.brakes()).count(), 4);
        assert_eq!(all.iter().filter(|m| m.steers()).count(), 6);
        assert!(all.iter().all(|m| m.deceleration() <= 8.0));
        let switching = all.iter().find(|m| m.switch == 0.6 && m.accelerations == [-8.0, 3.0]).unwrap();
        assert_eq!((switching.acceleration(0.5), switching.acceleration(0.6)), (-8.0, 3.0));
    }
}
