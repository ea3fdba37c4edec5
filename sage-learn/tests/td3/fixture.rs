//! `td3_update.safetensors`: the values of PyTorch after 1, 2 and 5 updates.

use std::{collections::BTreeMap, path::Path};

use safetensors::SafeTensors;
use sage_learn::{Real, Td3Learner, TransitionBatch};
use sage_sim::actor::SingleRow;

pub struct Fixture(BTreeMap<String, Vec<f64>>);

impl Fixture {
    pub fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).expect("the fixture");
        let file = SafeTensors::deserialize(&bytes).expect("safetensors");
        let numbers = |data: &[u8], is_wide: bool| -> Vec<f64> {
            if is_wide {
                data.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().expect("8 bytes"))).collect()
            } else {
                data.chunks_exact(4)
                    .map(|b| f64::from(f32::from_le_bytes(b.try_into().expect("4 bytes"))))
                    .collect()
            }
        };
        let tensors = file.tensors().into_iter();
        Self(tensors.map(|(n, t)| (n, numbers(t.data(), t.dtype() == safetensors::Dtype::F64))).collect())
    }

    fn get(&self, name: &str) -> &[f64] {
        self.0.get(name).unwrap_or_else(|| panic!("no tensor {name}"))
    }

    /// Runs five updates and compares every tensor.
    pub fn check<T: Real>(&self, precision: &str, learner: &mut Td3Learner<T>, bound: f64) {
        let mut start = BTreeMap::new();
        for tensor in learner.tensors() {
            let from = match tensor.name.strip_prefix("target.") {
                Some(name) => format!("init_target.{name}"),
                None => format!("init.{}", tensor.name),
            };
            let numbers: Vec<T> = match tensor.name.split_once('.') {
                Some(("m" | "v", _)) => vec![T::of(0.0); tensor.numbers.len()],
                _ => self.get(&from).iter().map(|x| T::of(*x)).collect(),
            };
            start.insert(tensor.name, numbers);
        }
        learner.set_tensors(&start, 0).expect("tensors of this shape");
        let (mut compared, mut actor_losses) = (0, 0);
        for update in 0..5 {
            let part = |name: &str| -> Vec<T> {
                let all = self.get(&format!("batch.{name}"));
                let one = all.len() / 5;
                all[update * one..][..one].iter().map(|x| T::of(*x)).collect()
            };
            let report = learner.update(&TransitionBatch {
                observations: part("state"),
                actions: part("action"),
                rewards: part("reward"),
                next_observations: part("next_state"),
                not_terminal: part("not_done"),
                noise: part("noise"),
            });
            let near = |what: &str, found: f64, expected: f64, scale: f64| {
                let gap = (found - expected).abs() / scale;
                assert!(gap <= bound, "{precision} {what}, update {update}: {found} and {expected}");
            };
            let expected = self.get(&format!("{precision}.critic_loss"))[update];
            near("critic loss", report.critic_loss, expected, expected.abs());
            if let Some(loss) = report.actor_loss {
                let expected = self.get(&format!("{precision}.actor_loss"))[actor_losses];
                near("actor loss", loss, expected, expected.abs().max(1.0));
                actor_losses += 1;
            }
            let targets = self.get(&format!("{precision}.target"));
            let scale = targets.iter().fold(1.0_f64, |m, x| m.max(x.abs()));
            for (y, expected) in learner.last_targets().iter().zip(&targets[32 * update..]) {
                near("target", y.wide(), *expected, scale);
            }
            for tensor in learner.tensors() {
                let name = format!("{precision}.after{}.{}", update + 1, tensor.name);
                let Some(expected) = self.0.get(&name) else { continue };
                compared += 1;
                for (x, y) in tensor.numbers.iter().zip(expected) {
                    near(&name, x.wide(), *y, 1.0);
                }
            }
        }
        // Three networks of six tensors, online, target, m and v, after three updates; the actor has no moments
        // after the first.
        assert_eq!(compared, 3 * 72 - 12);
        assert_eq!(actor_losses, 2);
        let (mut memory, mut action) = (SingleRow::default(), [T::of(0.0); 2]);
        let rows = self.get("batch.state")[..32 * 7].chunks_exact(7);
        for (row, expected) in rows.zip(self.get(&format!("{precision}.policy5")).chunks_exact(2)) {
            let row: Vec<T> = row.iter().map(|x| T::of(*x)).collect();
            learner.act(&row, &mut memory, &mut action);
            for (x, y) in action.iter().zip(expected) {
                assert!((x.wide() - y).abs() <= bound, "{precision} policy: {x:?} and {y}");
            }
        }
    }
}
