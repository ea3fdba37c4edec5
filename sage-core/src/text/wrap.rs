//! Text in lines that fit a terminal.

/// Most characters of a line.
pub const COLUMNS: usize = 100;

/// A line in lines of at most [`COLUMNS`] characters, broken between words; further ones are indented. A word that is
/// longer, such as a path, stays whole.
pub fn wrapped(line: &str, indent: usize) -> String {
    if line.chars().count() <= COLUMNS {
        return line.to_owned();
    }
    let mut out = String::new();
    let (mut used, mut is_first) = (0, true);
    for word in line.split(' ') {
        let length = word.chars().count();
        if is_first {
            is_first = false;
        } else if used + 1 + length > COLUMNS && used > indent {
            out = format!("{}\n{}", out.trim_end(), " ".repeat(indent));
            used = indent;
        } else {
            out.push(' ');
            used += 1;
        }
        out += word;
        used += length;
    }
    out
}

/// All lines of a text, [`wrapped`].
pub fn wrapped_lines(text: &str) -> String {
    text.split('\n').map(|line| wrapped(line, 0)).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lines_are_broken_between_words() {
        let line = format!("  name   {} `{}` end", "word ".repeat(30).trim_end(), "path/".repeat(30));
        let lines = wrapped(&line, 9);
        assert_eq!(lines.split_whitespace().collect::<Vec<_>>(), line.split_whitespace().collect::<Vec<_>>());
        assert!(lines.starts_with("  name   word"));
        for line in lines.lines().skip(1) {
            assert!(line.starts_with("         ") && !line.starts_with("          "), "{line}");
            assert!(line.contains("path/") || line.chars().count() <= COLUMNS, "{line}");
        }
        assert_eq!(wrapped("short", 4), "short");
        assert_eq!(wrapped_lines("one\n\ntwo\n"), "one\n\ntwo\n");
    }
}
