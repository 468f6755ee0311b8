//! "Did you mean": the nearest known name to a misspelt one, for the errors of the engine and of parameters alike.

/// Longer names than this are not compared: the time grows with the square.
const LONGEST: usize = 64;
/// The number of names that a hint lists.
const LISTED: usize = 12;

/// The known name that is nearest to `seen`, whatever its case, or of which `seen` is the only abbreviation; `None` where all are far.
pub fn nearest<'a>(seen: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    if seen.len() > LONGEST {
        return None;
    }
    let plain = |name: &str| name.to_lowercase().replace('_', "-");
    let wanted = plain(seen);
    let known: Vec<&str> = known.into_iter().collect();
    let close = known.iter().copied().filter_map(|name| {
        let allowed = 1 + name.len() / 4;
        let far = name.len().abs_diff(seen.len()) > allowed || name.len() > LONGEST;
        let distance = if far { usize::MAX } else { strsim::damerau_levenshtein(&wanted, &plain(name)) };
        // A single letter is near to every other one, which means nothing.
        (distance <= allowed && distance < seen.chars().count()).then_some((distance, name))
    });
    let closest = close.min().map(|(_, name)| name);
    // A unique abbreviation.
    let long = || known.iter().copied().filter(|name| seen.len() >= 3 && plain(name).starts_with(&wanted));
    closest.or_else(|| long().next().filter(|_| long().count() == 1))
}

/// "did you mean `a`? known are `a`, `b`", or as much of it as can be said. `what` names the known ones: "its inputs".
pub fn hint<'a>(seen: &str, what: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    let known: Vec<&str> = known.into_iter().collect();
    match (nearest(seen, known.iter().copied()), known.len()) {
        (_, 0) => format!("there are no {}", what.trim_start_matches("the ").trim_start_matches("its ")),
        (Some(name), _) => format!("did you mean `{name}`? {what} are {}", list(&known)),
        (None, _) => format!("{what} are {}", list(&known)),
    }
}

/// "`a`, `b` and 7 more".
pub fn list(names: &[&str]) -> String {
    let mut text = names.iter().take(LISTED).map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    if names.len() > LISTED {
        text.push_str(&format!(" and {} more", names.len() - LISTED));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_name_is_found_and_a_far_one_is_not() {
        let known = ["demonstrations", "policy", "total_steps"];
        assert_eq!(nearest("demonstration", known), Some("demonstrations"));
        assert_eq!(nearest("Policy", known), Some("policy"));
        assert_eq!(nearest("total-steps", known), Some("total_steps"));
        assert_eq!(nearest("ploicy", known), Some("policy"));
        assert_eq!(nearest("demo", known), Some("demonstrations"));
        assert_eq!(nearest("dem", ["demand", "demonstrations"]), None);
        assert_eq!(nearest("reward", known), None);
        assert_eq!(nearest("b", ["a"]), None);
        assert_eq!(nearest(&"x".repeat(10_000), known), None);
    }

    #[test]
    fn long_lists_of_names_are_cut() {
        let names: Vec<String> = (0..20).map(|n| format!("n{n}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        assert!(list(&names).ends_with("`n11` and 8 more"));
    }
}
