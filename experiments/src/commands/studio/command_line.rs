//! The command line that makes what the page shows.

use std::{borrow::Cow, path::Path};

use anyhow::Result;
use sage_data::Format;
use sage_run::input;

use super::{choice::Choice, method::value, workshop::Workshop};

/// Words of a command.
struct Words(Vec<Cow<'static, str>>);

impl Words {
    fn of(command: &'static str) -> Self {
        Self(vec!["sage".into(), command.into()])
    }

    fn word(mut self, word: impl Into<Cow<'static, str>>) -> Self {
        self.0.push(word.into());
        self
    }

    fn option(self, option: &'static str, value: impl Into<Cow<'static, str>>) -> Self {
        self.word(option).word(value)
    }

    fn option_if(self, option: &'static str, value: Option<String>) -> Self {
        match value {
            Some(value) => self.option(option, value),
            None => self,
        }
    }
}

impl Workshop<'_> {
    /// The commands that make the drives of a choice.
    ///
    /// *Errors*: a scene whose file has no name.
    pub(super) fn command(&self, choice: &Choice) -> Result<String> {
        let name = &*self.names[choice.scene];
        let file = match self.procedural {
            None => name.to_owned(),
            Some(_) => format!("invented/{name}.{}", Format::Native.ending()),
        };
        let method = &self.methods[choice.generator];
        let changed = |words: Words, without: &[String]| {
            let without = Some(without.join(",")).filter(|ids| !ids.is_empty());
            words.option_if("--adversary", choice.adversary.clone()).option_if("--without", without)
        };
        let seed = Some(self.seed.to_string()).filter(|_| self.seed != 0);
        let drivers = |words: Words| {
            choice
                .drivers
                .iter()
                .fold(words, |words, driver| words.option("--ego", self.drivers[*driver].label.clone()))
        };
        let mut lines = Vec::new();
        if let Some(seed) = self.procedural {
            let count = choice.scene + 1;
            lines.push(format!("sage scenes --count {count} --seed {seed} --out invented --force"));
        }
        let simulate = drivers(Words::of("simulate").word(file.clone()));
        let simulate = match &choice.found {
            Some(found) => {
                let first = self.drivers[choice.drivers[0]].label.clone();
                let search = Words::of("search").word(file.clone()).option("--ego", first);
                let search = search.option_if("--weights", method.weights.clone());
                let search = changed(search, &found.without).option("--budget", self.budget.to_string());
                let search = search.option_if("--seed", seed.clone()).option("--out", "found");
                lines.push(quoted(search));
                let scene = input::scene_name(Path::new(&file))?;
                let row = format!("found/{scene}-failure{}.json", found.number + 1);
                changed(simulate, &choice.without).option("--attack", row)
            }
            None => {
                let simulate = simulate.option("--method", method.part.to_string());
                let simulate = simulate.option_if("--weights", method.weights.clone());
                let place = Some(value(choice.step).to_string()).filter(|_| method.has_dial());
                let goal = choice.goal.map(|[x, y]| format!("{x},{y}"));
                let simulate = simulate.option_if(choice.dial.option(), place);
                changed(simulate, &choice.without).option_if("--goal", goal)
            }
        };
        lines.push(quoted(simulate.option_if("--seed", seed).option("--out", "drives")));
        Ok(lines.join("\n"))
    }
}

/// Words as a shell of Unix reads them; a word that no shell can pass on is left out, for none holds a zero.
fn quoted(Words(words): Words) -> String {
    let quote = |word: Cow<str>| shlex::try_quote(&word).ok().map(Cow::into_owned);
    words.into_iter().filter_map(quote).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::{Words, quoted};

    #[test]
    fn a_shell_reads_every_word_as_it_was() {
        let words =
            ["$(touch x)", "a'b\"c", "line\nnext", "`id`", "", "-", "é {\"a\": 1}", "\\", "*", "~", "!x"];
        let printf = ["printf", "%s\\0"].into_iter().chain(words).map(Into::into);
        let line = quoted(Words(printf.collect()));
        let output = Command::new("sh").args(["-c", &line]).output();
        let Ok(output) = output else { return };
        let printed = String::from_utf8(output.stdout).unwrap_or_default();
        assert_eq!(printed.split_terminator('\0').collect::<Vec<_>>(), words);
    }
}
