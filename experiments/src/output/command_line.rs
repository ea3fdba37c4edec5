//! The command as files keep it, and the program that ran it.

/// Flags that say how a command was run, not what came of it, and whether a value follows each. Files keep
/// the command without them, so that equal results are equal bytes.
const HOW: [(&str, bool); 5] =
    [("--threads", true), ("--out", true), ("--force", false), ("--json", false), ("--shard", true)];

/// The command that this process runs, without the path of the program and without flags that change
/// nothing of the result.
pub(crate) fn command() -> String {
    told(std::env::args_os().skip(1).map(|argument| argument.to_string_lossy().into_owned()))
}

fn told(arguments: impl Iterator<Item = String>) -> String {
    let mut words = vec!["sage".to_owned()];
    let mut is_value = false;
    for argument in arguments {
        if std::mem::take(&mut is_value) {
            continue;
        }
        let (flag, value) = argument.split_once('=').map_or((&argument[..], None), |(f, v)| (f, Some(v)));
        match HOW.iter().find(|(name, _)| *name == flag) {
            Some((_, takes_value)) => is_value = *takes_value && value.is_none(),
            None => words.push(quoted(argument)),
        }
    }
    words.join(" ")
}

fn quoted(argument: String) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:=+".contains(c);
    if !argument.is_empty() && argument.chars().all(plain) {
        argument
    } else {
        format!("'{}'", argument.replace('\'', r"'\''"))
    }
}

/// What tells this build of the program from others: a run is gone on with by the same one only.
pub(crate) fn program() -> String {
    // A program is a file of its own size, whatever that is: the system has loaded it already.
    let bytes = std::env::current_exe().and_then(|path| sage_core::files::read(&path, u64::MAX - 1));
    bytes.map_or_else(
        |_| env!("CARGO_PKG_VERSION").to_owned(),
        |bytes| blake3::hash(&bytes).to_hex()[..16].to_owned(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> String {
        told(text.split(' ').map(str::to_owned))
    }

    #[test]
    fn what_decides_the_result_is_kept_and_nothing_else() {
        let plain = "sage generate scenes/ --lambda 1";
        assert_eq!(of("generate scenes/ --lambda 1"), plain);
        for how in ["--force", "--out x", "--out=x", "--threads 2", "--threads=2", "--json", "--shard 1/2"] {
            assert_eq!(of(&format!("generate scenes/ {how} --lambda 1")), plain);
        }
        assert_eq!(told(["list".to_owned(), "a b'c".to_owned()].into_iter()), r"sage list 'a b'\''c'");
    }
}
