//! Help texts: sections of options, and groups of commands.

use clap::{Arg, ArgAction, Command, builder::StyledStr};

use super::brief_help;

/// Headings of the sections of options.
pub(super) const SCENE: &str = "Scene";
pub(super) const DRIVER: &str = "Driver";
pub(super) const SEARCH: &str = "Search";
pub(super) const RATE: &str = "Rate";
pub(super) const ATTACK: &str = "Attack";
pub(super) const SELECTION: &str = "Selection";
pub(super) const PREDICTION: &str = "Prediction";
pub(super) const SCORE: &str = "Score";
pub(super) const PICTURE: &str = "Picture";
pub(super) const CLAIMS: &str = "Claims";
pub(super) const DIAGNOSTICS: &str = "Diagnostics";
pub(super) const TRAINING: &str = "Training";
pub(super) const STUDY: &str = "Study";
pub(super) const OUTPUT: &str = "Output";
pub(super) const RUN: &str = "Run";

/// All headings, in the order of the sections.
const HEADINGS: [&str; 15] = [
    CLAIMS,
    DIAGNOSTICS,
    SCENE,
    DRIVER,
    SEARCH,
    RATE,
    ATTACK,
    SELECTION,
    PREDICTION,
    SCORE,
    PICTURE,
    TRAINING,
    STUDY,
    OUTPUT,
    RUN,
];

/// Most options, --threads and --help not counted, that are shown without sections.
const FEW: usize = 5;

/// Id of the option --threads.
const THREADS: &str = "threads";

/// Groups of the commands in `sage --help`.
const GROUPS: [(&str, &[&str]); 8] = [
    ("Make scenes", &["demo", "scenes", "generate", "convert"]),
    ("Look at scenes", &["inspect", "draw", "explain", "predict"]),
    ("Drive and test", &["studio", "simulate", "search", "rate", "report", "suite", "test"]),
    ("Measure and compare", &["score", "bench"]),
    ("Run on a cluster", &["status", "join"]),
    ("Train", &["pretrain", "finetune", "calibrate", "merge", "train-ego", "train-adversary"]),
    ("Research", &["theory", "analyse"]),
    ("Other", &["list", "completions"]),
];

/// The command line with its help texts in sections and groups.
pub(super) fn arranged(command: Command) -> Command {
    let threads = command.get_arguments().find(|arg| arg.get_id() == THREADS).cloned();
    let command = in_sections(command, threads.as_ref());
    let header = *command.get_styles().get_header();
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{{before-help}}{header}Options:{header:#}\n{{options}}{{after-help}}"
    );
    let groups = groups(&command);
    command
        .help_template(template)
        .before_help(groups)
        .after_help("`sage COMMAND --help` describes a command with examples. Start with `sage demo`.")
}

/// The commands by group, each with the first line of its description.
fn groups(command: &Command) -> StyledStr {
    let (header, literal) = (command.get_styles().get_header(), command.get_styles().get_literal());
    let width = command.get_subcommands().map(|sub| sub.get_name().len()).max().unwrap_or(0);
    let line = |sub: &Command| {
        let (name, about) = (sub.get_name(), sub.get_about().cloned().unwrap_or_default());
        format!("\n  {literal}{name}{literal:#}{:1$}  {about}", "", width - name.len())
    };
    let group = |(heading, names): &(&str, &[&str])| {
        let lines: String = names.iter().filter_map(|name| command.find_subcommand(name)).map(line).collect();
        format!("{header}{heading}:{header:#}{lines}")
    };
    GROUPS.iter().map(group).collect::<Vec<_>>().join("\n\n").into()
}

/// A command, and all commands under it, with the options in sections if they are more than a few.
fn in_sections(command: Command, threads: Option<&Arg>) -> Command {
    let command = command.mut_subcommands(|sub| in_sections(sub, threads));
    let help = std::iter::once(help_option(&command)).chain(brief_help::option(&command));
    let mut args: Vec<Arg> = command.get_arguments().cloned().collect();
    let has_sections = args.iter().filter(|arg| !arg.is_positional()).count() > FEW;
    let has_threads = args.iter().any(|arg| arg.get_id() == THREADS);
    // clap shows the sections in the order of their first options.
    args.sort_by_key(|arg| HEADINGS.iter().position(|heading| Some(*heading) == arg.get_help_heading()));
    let mut args = args.into_iter();
    let command = command.mut_args(|arg| {
        let arg = args.next().unwrap_or(arg);
        if has_sections { arg } else { arg.help_heading(None::<&str>) }
    });
    let common = threads.filter(|_| !has_threads).cloned().into_iter().chain(help);
    let section = has_sections.then_some(RUN);
    command.disable_help_flag(true).args(common.map(|arg| arg.help_heading(section)))
}

/// The option --help of a command; clap's own cannot stand in a section.
fn help_option(command: &Command) -> Arg {
    let is_long = |arg: &Arg| {
        arg.get_long_help().is_some()
            || arg.get_possible_values().iter().any(|value| value.get_help().is_some())
    };
    let help = Arg::new("help").short('h').long("help").action(ArgAction::Help).display_order(999);
    if command.get_long_about().is_some() || command.get_arguments().any(is_long) {
        help.help("Print help (see more with '--help')").long_help("Print help (see a summary with '-h')")
    } else {
        help.help("Print help")
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

    use super::*;
    use crate::Cli;

    /// Widest line of the examples, so that an ordinary terminal wraps none.
    const EXAMPLE_WIDTH: usize = 80;

    /// All commands, with the words that name them.
    fn all() -> Vec<(String, Command)> {
        let mut open = vec![("sage".to_owned(), Cli::described())];
        let mut found = Vec::new();
        while let Some((words, command)) = open.pop() {
            open.extend(
                command.get_subcommands().map(|sub| (format!("{words} {}", sub.get_name()), sub.clone())),
            );
            found.push((words, command));
        }
        found
    }

    #[test]
    fn every_command_is_in_one_group_with_its_description() {
        let mut command = Cli::described().term_width(100);
        let mut names: Vec<&str> = command.get_subcommands().map(Command::get_name).collect();
        let mut grouped: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        names.sort_unstable();
        grouped.sort_unstable();
        assert_eq!(grouped, names);
        let about = |sub: &Command| (sub.get_name().to_owned(), sub.get_about().unwrap().to_string());
        let described: Vec<(String, String)> = command.get_subcommands().map(about).collect();
        let help = command.render_help().to_string();
        for (name, about) in described {
            let lines = help.lines().filter_map(|line| line.strip_prefix("  ")?.strip_prefix(name.as_str()));
            let described = lines.filter(|rest| rest.starts_with("  ") && rest.trim_start() == about);
            assert_eq!(described.count(), 1, "{name}");
        }
    }

    #[test]
    fn many_options_are_in_sections_and_few_are_not() {
        for (words, command) in all() {
            let args = command.get_arguments().filter(|arg| !arg.is_positional());
            let (common, own): (Vec<&Arg>, Vec<&Arg>) =
                args.partition(|arg| ["help", "help_all", THREADS].contains(&arg.get_id().as_str()));
            let has_sections = own.len() > FEW;
            assert!(matches!(common.len(), 2 | 3), "{words}");
            for arg in common.into_iter().chain(own) {
                let heading = arg.get_help_heading();
                let is_known = heading.is_some_and(|heading| HEADINGS.contains(&heading));
                assert_eq!(
                    (heading.is_some(), is_known),
                    (has_sections, has_sections),
                    "{words} {arg}: {heading:?}"
                );
            }
            assert!(command.get_positionals().all(|arg| arg.get_help_heading().is_none()), "{words}");
        }
    }

    #[test]
    fn examples_fit_an_ordinary_terminal() {
        for (words, command) in all() {
            let examples = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            for line in examples.lines() {
                assert!(line.chars().count() <= EXAMPLE_WIDTH, "{words}: {line}");
            }
        }
    }
}
