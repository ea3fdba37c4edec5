//! The drives of a choice.

use std::sync::Arc;

use advsage::{
    planned_attack::PlannedAttack,
    rows::drive::{DriveRow, RowHead},
};
use anyhow::Result;
use sage_sim::{episode::Episode, traffic::Plan};
use sage_view::{
    player::{Panel, shown_part},
    studio::ShownDrives,
};
use serde::Serialize;
use serde_json::{Value, json};

use super::{
    choice::Choice,
    workshop::{Ready, Workshop},
};

/// One drive.
struct Driven<'w> {
    label: &'w str,
    ready: Arc<Ready<'w>>,
    plan: Plan,
    episode: Episode,
    row: DriveRow,
}

/// What is said of a drive, or why there is none.
#[derive(Serialize)]
struct Words<'d> {
    driver: &'d str,
    text: String,
    attack: bool,
    #[serde(rename = "isError")]
    is_error: bool,
}

impl<'w> Workshop<'w> {
    /// The drives of a choice; one driver that fails leaves the other. `check` is asked between the stages whether anybody still waits.
    ///
    /// *Errors*: a choice of what was not offered; a scene that cannot be driven or attacked so; those of `check`.
    pub(super) fn drive(&self, choice: &Choice, check: &dyn Fn() -> Result<()>) -> Result<Value> {
        choice.check()?;
        let (mut drives, mut words) = (Vec::new(), Vec::new());
        let mut failed = None;
        for &driver in &choice.drivers {
            check()?;
            match self.driven(choice, driver, check) {
                Ok(driven) => {
                    words.push(driven.words());
                    drives.push(driven);
                }
                Err(error) => {
                    check()?;
                    let label = self.drivers.get(driver).map_or("", |driver| &driver.label);
                    words.push(Words {
                        driver: label,
                        text: format!("{error:#}"),
                        attack: false,
                        is_error: true,
                    });
                    failed.get_or_insert(error);
                }
            }
        }
        if let Some(error) = failed.filter(|_| drives.is_empty()) {
            return Err(error);
        }
        let panels: Vec<Panel> = drives.iter().map(Driven::panel).collect();
        let scene = drives[0].ready.scene();
        Ok(json!({
            "drives": ShownDrives::of(scene, &panels),
            "words": words,
            "adversary": scene.adversary()?.id,
            "command": self.command(choice)?,
        }))
    }

    fn driven(&self, choice: &Choice, driver: usize, check: &dyn Fn() -> Result<()>) -> Result<Driven<'w>> {
        let ready = self.ready(choice, driver)?;
        check()?;
        let attack = self.attack(choice, &ready)?;
        let (test, ctx) = (&ready.driver.test, &ready.driver.ctx);
        attack.check(ctx.scene())?;
        let planned = PlannedAttack::of(ctx, test.path_of(&attack)?).extended(attack.extension);
        let outcome = test.attack_along(planned.path.clone(), planned.feasible)?;
        let plan = Plan::of_adversary(ready.scene(), &planned.path.trajectory)?;
        let row = planned.row(outcome.verdict, &outcome.episode, test.unattacked())?;
        let label = &*self.drivers[driver].label;
        let head = RowHead {
            run_hash: "",
            scene: &self.labels[choice.scene],
            ego: label,
            generated: None,
            source_hash: "",
            seed: self.seed,
        };
        let row = DriveRow::new(head, &outcome.episode, ready.scene(), Some(row));
        Ok(Driven { label, ready, plan, episode: outcome.episode, row })
    }
}

impl<'w> Driven<'w> {
    fn panel(&self) -> Panel<'_> {
        let unattacked = shown_part(self.ready.driver.test.unattacked());
        self.row.panel(self.label.to_owned(), &self.episode, Some(&self.plan.motion), Some(unattacked))
    }

    fn words(&self) -> Words<'w> {
        Words {
            driver: self.label,
            text: self.row.ending(),
            attack: self.row.verdict().is_some_and(|verdict| verdict.is_attack),
            is_error: false,
        }
    }
}
