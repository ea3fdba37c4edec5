//! Metrics of drives: without attack, under attack, in the published evaluation, and of the search for evasive
//! manoeuvres.

use sage_core::{
    Error,
    metric::{Metric, Metrics},
    objective::SideHit,
};

use crate::{
    attack_test::AttackOutcome, avoidable::Avoidable, episode::EpisodeContact, evaluation::EpisodeRow,
    unattacked::UnattackedDrive,
};

/// Metrics of a drive in the unchanged scene.
///
/// *Errors*: two have the same name.
pub fn drive_metrics() -> Result<Metrics<UnattackedDrive>, Error> {
    type D = UnattackedDrive;
    Metrics::default().with_all([
        Metric::share("contact", |d: &D| Some(!d.contacts.is_empty()))
            .about("any contact")
            .with_note(|d| (!d.contacts.is_empty()).then(|| contacts(d)))
            .less_is_better(),
        Metric::share("at-fault contact", |d: &D| Some(d.is_at_fault()))
            .about("nuPlan's rule gives the first contact to the ego")
            .less_is_better(),
        Metric::share("off the road", D::is_off_road)
            .about("a road edge touched or a sidewalk entered before any contact")
            .less_is_better(),
        Metric::share("comfortable", |d: &D| d.is_comfortable)
            .about("within nuPlan's bounds of acceleration, jerk and turning, up to the first contact")
            .more_is_better(),
        Metric::share("over red", |d: &D| d.over_red.as_ref().map(|frames| !frames.is_empty()))
            .about("of the drives with a light ahead, those that cross its stop point while it is red")
            .less_is_better(),
        Metric::share("wrong way", |d: &D| d.wrong_way)
            .about("against all lanes within 2.5 m for half a second before any contact, where the recording is not")
            .less_is_better(),
        Metric::median("completion", |d: &D| d.completion)
            .about("progress along the logged route by that of the log")
            .more_is_better(),
        Metric::mean("on its plan", |d: &D| d.on_plan)
            .about("share of the steps in which the car is within 0.3 m of its newest plan, of drivers that show plans")
            .more_is_better(),
        Metric::mean("off its plan", |d: &D| d.off_plan)
            .unit("m")
            .about("largest distance of the car from its newest plan, of drivers that show plans")
            .less_is_better(),
        Metric::mean("step time", |d: &D| d.again?.step_time)
            .unit("ms")
            .about("mean time of a step of the driver")
            .less_is_better()
            .varying(),
        Metric::share("same again", |d: &D| Some(d.again?.is_same))
            .about("driven once more in the same scene it drives the same, bit for bit")
            .more_is_better(),
        Metric::mean("steps", |d: &D| Some(d.steps as f64)).unit("steps"),
        Metric::mean("off-road frame", |d: &D| d.off_road.step().map(|step| step as f64)).unit("frames"),
        Metric::mean("over-red frame", |d: &D| first(d.over_red.as_ref())).unit("frames"),
    ])
}

/// First contacts as `frame:track:class`.
fn contacts(drive: &UnattackedDrive) -> String {
    let word = |(frame, track, class): &(usize, String, _)| {
        let class = serde_json::to_value(class).unwrap_or_default();
        format!("{frame}:{track}:{}", class.as_str().unwrap_or("?"))
    };
    drive.contacts.iter().map(word).collect::<Vec<_>>().join(" ")
}

fn first(frames: Option<&Vec<usize>>) -> Option<f64> {
    frames?.first().map(|frame| *frame as f64)
}

/// An attack on a driver with what was measured of it.
pub struct MeasuredAttack {
    /// What the driver did.
    pub outcome: AttackOutcome,
    /// The search for an evasive manoeuvre in the attacked drive; `None` if the attack does not work, or without search.
    pub avoidable: Option<Avoidable>,
    /// Whether the search was made.
    pub is_searched: bool,
    /// Frames at which the driver runs over red; `None` without a light ahead on its route.
    pub over_red: Option<Vec<usize>>,
    /// The published reward of the ego's path up to the end of the episode, and whether the plan meets this path.
    pub reward_cut: (f64, bool),
}

impl MeasuredAttack {
    fn contact(&self) -> Option<&EpisodeContact> {
        self.outcome.episode.first_contacts().next()
    }

    /// Track of the road user of the first contact.
    fn met(&self) -> Option<String> {
        self.contact().map(|contact| self.outcome.track(contact.contact.other.track).to_owned())
    }

    fn hit(&self) -> Option<&EpisodeContact> {
        self.contact().filter(|_| self.outcome.verdict.attack)
    }
}

/// Metrics of an attack on a driver.
///
/// *Errors*: two have the same name.
pub fn attack_metrics() -> Result<Metrics<MeasuredAttack>, Error> {
    type A = MeasuredAttack;
    let searched = |of: fn(&Avoidable) -> Option<f64>| move |a: &A| a.avoidable.as_ref().and_then(of);
    Metrics::default().with_all([
        Metric::share("attack", |a: &A| Some(a.outcome.verdict.attack))
            .about("the first contact is with the adversary, the plan is feasible, and there was none without the attack")
            .more_is_better(),
        Metric::share("at-fault attack", |a: &A| Some(a.outcome.verdict.at_fault))
            .about("an attack in whose contact nuPlan's rule gives the fault to the ego")
            .more_is_better(),
        Metric::share("avoidable attack", |a: &A| match &a.avoidable {
            Some(found) => found.avoidable,
            None => a.is_searched.then_some(false),
        })
        .about("an attack for which a search found an evasive manoeuvre")
        .more_is_better()
        .costly(),
        Metric::share("avoidable, of the attacks", |a: &A| a.avoidable.as_ref()?.avoidable)
            .about("the same, of the attacks alone")
        .with_note(|a| a.avoidable.as_ref()?.avoidable_reason.clone())
            .more_is_better()
        .costly(),
        Metric::share("solid attack", |a: &A| Some(a.outcome.verdict.solid))
            .about("an attack in which the boxes overlap by 0.5 m or more")
            .more_is_better(),
        Metric::share("attack, feasible or not", |a: &A| Some(a.outcome.meets_adversary()))
            .about("the first contact is with the adversary"),
        Metric::share("any vehicle", |a: &A| Some(a.outcome.verdict.any_vehicle))
            .about("the published flag: the first contact is with any vehicle"),
        Metric::share("over red", |a: &A| a.over_red.as_ref().map(|frames| !frames.is_empty()))
            .about("of the drives with a light ahead, those that cross its stop point while it is red")
            .less_is_better(),
        Metric::mean("progress", |a: &A| a.outcome.episode.completion.map(|c| c.min(1.0)))
            .about("share of the logged route at the end, at most 1"),
        Metric::mean("R_adv", |a: &A| Some(a.outcome.reward()))
            .about("the paper's reward with the contact of the simulation")
            .more_is_better(),
        Metric::share("attack, path cut", |a: &A| Some(a.reward_cut.1))
            .about("the published success: the plan meets the ego's path up to its contact, feasible or not"),
        Metric::mean("R_adv, path cut", |a: &A| Some(a.reward_cut.0))
            .about("the published reward: the ego's path ends at its contact"),
        Metric::mean("impact", |a: &A| a.hit().map(|c| c.impact_speed)).unit("m/s").about("of the attacks"),
        Metric::mean("latest start", searched(|found| found.latest_start))
            .unit("s")
            .about("how late before the contact an evasive manoeuvre can begin, of the attacks that have one")
        .costly(),
        Metric::mean("latest start, braking", searched(|found| found.latest_brake)).unit("s").about("the same by braking")
        .costly(),
        Metric::mean("latest start, steering", searched(|found| found.latest_steer)).unit("s").about("the same by steering")
        .costly(),
        Metric::share("avoidable, nobody behind", |a: &A| a.avoidable.as_ref()?.avoidable_unhit)
            .about("avoidable without being touched from behind, of the attacks")
        .costly(),
        Metric::share("hit from behind", |a: &A| a.avoidable.as_ref()?.hit_from_behind)
        .costly(),
        Metric::share("hit by a reactive follower", |a: &A| a.avoidable.as_ref()?.hit_by_reactive_follower)
        .costly(),
        Metric::mean("completion", |a: &A| a.outcome.episode.completion).about("progress, not cut at 1"),
        Metric::mean("contact step", |a: &A| a.contact().map(|c| c.contact.step as f64 - sage_core::motion::NOW as f64))
            .unit("steps")
            .with_note(A::met),
        Metric::mean("overlap", |a: &A| a.contact().map(|c| c.overlap)).unit("m").about("at the first contact"),
        Metric::mean("contact speed", |a: &A| a.contact().map(|c| c.impact_speed))
            .unit("m/s")
            .about("of any first contact"),
        Metric::share("at fault", |a: &A| a.contact()?.class.is_at_fault()).about("of the first contacts"),
        Metric::mean("fault rule", |a: &A| a.contact().map(|c| f64::from(c.class.rule()))).about("nuPlan's rule, 1 to 5"),
        Metric::mean("over-red frame", |a: &A| first(a.over_red.as_ref())).unit("frames"),
    ])?
    .with_all(SideHit::ALL.map(|side| {
        Metric::share(format!("hit at the {}", side.name()), move |a: &A| Some(a.contact()?.side_hit == side))
    }))
}

/// Metrics of the search for evasive manoeuvres from the ego's own drive, over the attacks alone.
///
/// *Errors*: two have the same name.
pub fn avoidable_metrics() -> Result<Metrics<Avoidable>, Error> {
    type A = Avoidable;
    let all = [
        Metric::share("avoidable", |a: &A| a.avoidable)
            .about("an evasive manoeuvre was found")
            .more_is_better(),
        Metric::share("avoidable, nobody behind", |a: &A| a.avoidable_unhit)
            .about("one on which nobody touches the ego from behind"),
        Metric::share("recovers", |a: &A| a.recovers).about("and the ego is back on its way"),
        Metric::mean("latest start", |a: &A| a.latest_start)
            .unit("s")
            .about("how late before the contact one can begin"),
        Metric::mean("latest start, braking", |a: &A| a.latest_brake).unit("s").about("the same by braking"),
        Metric::mean("latest start, steering", |a: &A| a.latest_steer)
            .unit("s")
            .about("the same by steering"),
    ];
    Metrics::default().with_all(all.map(Metric::costly))
}

/// Metrics of an episode of the published evaluation.
///
/// *Errors*: two have the same name.
pub fn episode_metrics() -> Result<Metrics<EpisodeRow>, Error> {
    type E = EpisodeRow;
    Metrics::default().with_all([
        Metric::mean("reward", |e: &E| Some(e.reward)).about("sum of the rewards").more_is_better(),
        Metric::mean("cost", |e: &E| Some(e.cost)).about("sum of the costs").less_is_better(),
        Metric::mean("completion", |e: &E| Some(e.completion))
            .about("share of the route at the end")
            .more_is_better(),
        Metric::share("contact", |e: &E| Some(e.contact)).about("contact with a vehicle").less_is_better(),
        Metric::mean("speed", |e: &E| Some(e.speed)).unit("m/s").weighted_by("steps"),
        Metric::mean("jerk", |e: &E| Some(e.jerk)).unit("m/s³").weighted_by("steps").less_is_better(),
        Metric::share("at fault", |e: &E| Some(e.at_fault))
            .about("a contact for which nuPlan's rule gives the fault to the ego")
            .less_is_better(),
        Metric::share("off road", |e: &E| e.off_road).about("off the road in the last step").less_is_better(),
        Metric::mean("completion recorded", |e: &E| Some(e.completion_recorded))
            .about("completion at frame 90"),
        Metric::share("adversary", |e: &E| Some(e.adversary)).about("contact with the adversary"),
        Metric::share("arrived", |e: &E| Some(e.arrived)),
        Metric::share("time limit", |e: &E| Some(e.time_limit)),
        Metric::share("failed", |e: &E| Some(e.failed.is_some())).about("no episode: counts as a failure"),
        Metric::mean("steps", |e: &E| Some(e.steps as f64)).unit("steps"),
        Metric::share("standing", |e: &E| Some(e.standing))
            .about(
                "stood for 3 s before its route's end with no road user and no red light within 15 m ahead",
            )
            .less_is_better(),
    ])
}
