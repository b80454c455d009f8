//! Parsing and quoting of the words of text formats.

/// Parses a decimal number; also `nan`, `inf` and the forms that Microsoft's C library printed for them.
pub(crate) fn parse_number(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    if let Ok(number) = text.parse() {
        return Some(number);
    }
    let (sign, rest) = match text.strip_prefix('-') {
        Some(rest) => (-1.0, rest),
        None => (1.0, text.strip_prefix('+').unwrap_or(text)),
    };
    match rest.strip_prefix("1.#")?.get(..3)? {
        "INF" => Some(sign * f64::INFINITY),
        "IND" | "QNA" | "SNA" => Some(f64::NAN),
        _ => None,
    }
}

/// Quotes a word of a file for a message: shortened, on one line.
pub(crate) fn quoted(word: &[u8]) -> String {
    let shown = String::from_utf8_lossy(&word[..word.len().min(48)]);
    if word.len() > 48 {
        format!("\"{}…\"", shown.escape_debug())
    } else {
        format!("\"{}\"", shown.escape_debug())
    }
}
