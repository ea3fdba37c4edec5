//! What `--help` leaves to `--help-all`: options that few people need who test a driver.

use clap::{Arg, ArgAction, Command};

/// The option that shows all others.
pub(super) const OPTION: &str = "--help-all";

/// How files are read, in every command: most files need none of it.
const READING: [&str; 7] = ["ego_track", "now", "rate", "resample", "strict", "trust", "without"];

/// What a study varies, in the commands that attack: other dials than `--aggression`, parts and their options.
const RESEARCH: [&str; 15] = [
    "options",
    "lambda",
    "mu",
    "mix",
    "merger",
    "selection",
    "feasibility",
    "goal",
    "latest_start",
    "avoidable",
    "order",
    "plans",
    "fault",
    "standard",
    "scenario_ego",
];

/// The commands that attack.
const ATTACKING: [&str; 5] = ["generate", "simulate", "search", "rate", "explain"];

/// The command line whose help texts show what most people need.
pub(super) fn brief(command: Command) -> Command {
    let is_attacking = ATTACKING.contains(&command.get_name());
    let is_rare = |arg: &Arg| {
        let id = arg.get_id().as_str();
        READING.contains(&id) || (is_attacking && RESEARCH.contains(&id))
    };
    command.mut_subcommands(brief).mut_args(|arg| {
        let is_rare = is_rare(&arg);
        arg.hide(is_rare)
    })
}

/// The option `--help-all` of a command; `None` if `--help` shows all.
pub(super) fn option(command: &Command) -> Option<Arg> {
    let hidden = brief(command.clone()).get_arguments().filter(|arg| arg.is_hide_set()).count();
    let option = Arg::new("help_all").long(&OPTION[2..]).action(ArgAction::HelpLong).display_order(1000);
    (hidden > 0).then(|| option.help(format!("Print help with {hidden} more options")))
}
