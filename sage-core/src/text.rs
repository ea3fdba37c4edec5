//! Characters in the words of strangers that must reach no terminal, page or drawing.

/// True for control characters, and for characters that change the direction of text, are not seen, or are none.
pub fn is_hidden(c: char) -> bool {
    let code = u32::from(c);
    c.is_control()
        || code & 0xfffe == 0xfffe
        || matches!(
            c,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{206f}' | '\u{fdd0}'..='\u{fdef}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}'
                | '\u{e0000}'..='\u{e007f}'
        )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_seen_and_marks_are_not() {
        assert!("aé漢ا😀 -_.".chars().all(|c| !is_hidden(c)));
        assert!(
            "\u{1b}\n\u{9b}\u{202e}\u{2066}\u{fffe}\u{1ffff}\u{200b}\u{feff}\u{e0041}".chars().all(is_hidden)
        );
    }
}
