//! File names from the content of files.

/// Length limit of a part of a file name that comes from the content of a file, bytes.
const LONGEST_NAME: usize = 64;

/// A text from the content of a file as a file name: any character other than a letter, digit, `.`, `_` or `-`
/// becomes `-`. A text that had others, was too long, or begins with `-` like a flag, gets a hash, so that different texts
/// have different names.
pub(crate) fn plain_name(text: &str) -> String {
    let plain = replaced(text, |c| c == '_');
    // Names of dots are folders.
    if plain == text && !plain.bytes().all(|byte| byte == b'.') && !plain.starts_with('-') {
        return plain;
    }
    let start = match plain.trim_matches('.').trim_start_matches('-') {
        "" => "scene",
        start => start,
    };
    format!("{start}-{}", &blake3::hash(text.as_bytes()).to_hex()[..8])
}

/// The same where an underscore separates parts, without a hash.
pub(crate) fn plain(text: &str) -> String {
    replaced(text, |_| false)
}

fn replaced(text: &str, is_also_plain: impl Fn(char) -> bool) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '.' || c == '-' || is_also_plain(c);
    let plain: String = text.chars().map(|c| if is_plain(c) { c } else { '-' }).take(LONGEST_NAME).collect();
    if plain.is_empty() { "unknown".to_owned() } else { plain }
}
