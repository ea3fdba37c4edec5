//! The command line that makes what the page shows.

use std::borrow::Cow;

/// Words as a shell of Unix reads them; a word that no shell can pass on is left out, for none holds a zero.
pub(super) fn quoted<'w>(words: impl IntoIterator<Item = Cow<'w, str>>) -> String {
    let quote = |word: Cow<'w, str>| shlex::try_quote(&word).ok().map(Cow::into_owned);
    words.into_iter().filter_map(quote).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use std::{borrow::Cow, process::Command};

    use super::quoted;

    #[test]
    fn a_shell_reads_every_word_as_it_was() {
        let words =
            ["$(touch x)", "a'b\"c", "line\nnext", "`id`", "", "-", "é {\"a\": 1}", "\\", "*", "~", "!x"];
        let line = quoted(["printf", "%s\\0"].into_iter().chain(words).map(Cow::Borrowed));
        let output = Command::new("sh").args(["-c", &line]).output();
        let Ok(output) = output else { return };
        let printed = String::from_utf8(output.stdout).unwrap_or_default();
        assert_eq!(printed.split_terminator('\0').collect::<Vec<_>>(), words);
    }
}
