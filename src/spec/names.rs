//! Valid names of stages, axes, params, profiles and axis values.

/// Words with a special meaning in profiles and `--set`, which stages cannot have as names.
pub(crate) const RESERVED_STAGES: [&str; 8] =
    ["params", "axes", "defaults", "seed", "name", "profile", "profiles", "stages"];

/// Names that `$` has in every pipeline, and the label of a named fan-in.
pub(crate) const RESERVED_VALUES: [&str; 3] = ["profile", "pipeline", "name"];

/// A letter, then letters, digits, `-` and `_`.
pub(crate) fn is_identifier(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_alphabetic())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
        && name.len() <= 100
}

/// Lower-case words with `-` between them: a valid folder name on every system.
pub(crate) fn is_kebab(name: &str) -> bool {
    name.len() <= 100
        && name.split('-').all(|word| {
            !word.is_empty() && word.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit())
        })
}

/// Characters that a value on an axis must not contain, because they have a meaning in `stage[axis=a|b]`.
pub(crate) const NOT_IN_LABELS: &str = "[],=|*$";

/// True where the text can name a value on an axis.
pub(crate) fn is_label(text: &str) -> bool {
    !text.is_empty()
        && text.trim() == text
        && text.chars().count() <= 100
        && !text.contains(|c: char| c.is_control() || NOT_IN_LABELS.contains(c))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_checked() {
        assert!(is_identifier("train-expert") && is_identifier("gae_lambda") && is_identifier("Table22"));
        assert!(!is_identifier("") && !is_identifier("2nd") && !is_identifier("a.b") && !is_identifier("ä"));
        assert!(is_kebab("thesis") && is_kebab("lunar-lander-2"));
        assert!(!is_kebab("Thesis") && !is_kebab("a--b") && !is_kebab("../up") && !is_kebab(""));
        assert!(is_label("dril-peak") && is_label("0.98") && is_label("-1") && is_label("two words"));
        assert!(is_label(&"語".repeat(100)) && !is_label(&"語".repeat(101)), "characters count, not bytes");
        assert!(!is_label("") && !is_label("a|b") && !is_label(" a") && !is_label("a\nb") && !is_label("$a"));
    }
}
