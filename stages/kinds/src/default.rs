//! Defaults that stand where the field stands: `#[serde(default = "default::int::<8>")]`.

/// The whole number `N`.
pub(crate) fn int<const N: u64>() -> u64 {
    N
}

/// The number `A / B`, rounded once: the same as the decimal literal.
pub(crate) fn ratio<const A: i64, const B: i64>() -> f64 {
    A as f64 / B as f64
}

/// True for a value that is its type's default. Fields that came after keys were in use are left out of the normalised
/// parameters where they say what was so before, so that no key changes.
pub(crate) fn is<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Yes.
pub(crate) fn yes() -> bool {
    true
}
