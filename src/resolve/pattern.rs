//! Patterns that select stages on the command line: `table22`, `table*`, `evaluate[policy=beta, seed=1|2]`.

use std::collections::BTreeSet;

use super::graph::{Graph, StageIndex, StageInstance};
use crate::spec::suggest;

/// A pattern that matches no stage.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct NoStage {
    /// What was seen and what was expected.
    pub message: String,
    /// How to fix it.
    pub hint: String,
}

/// `name[axis=value|value, axis=value]`, with `*` and `?` in names and values.
#[derive(Clone, Debug)]
pub struct Pattern<'t> {
    text: &'t str,
    name: &'t str,
    axes: Vec<(&'t str, Vec<&'t str>)>,
}

impl<'t> Pattern<'t> {
    /// Parses a pattern.
    ///
    /// # Errors
    /// It is not a valid pattern.
    pub fn parse(text: &'t str) -> Result<Self, NoStage> {
        let bad = || NoStage {
            message: format!("`{}` is not a valid stage pattern", crate::spec::node::shorten(text)),
            hint: "write `table22`, `table*` or `evaluate[policy=beta, seed=1|2]`".to_owned(),
        };
        let (name, rest) = match text.split_once('[') {
            Some((name, rest)) => (name, Some(rest.trim_end().strip_suffix(']').ok_or_else(bad)?)),
            None => (text, None),
        };
        let mut axes = Vec::new();
        for part in rest.iter().flat_map(|rest| rest.split(',')) {
            let (axis, values) = part.split_once('=').ok_or_else(bad)?;
            axes.push((axis.trim(), values.split('|').map(str::trim).collect()));
        }
        let name = name.trim();
        if name.is_empty() || name.contains([']', '=']) { Err(bad()) } else { Ok(Self { text, name, axes }) }
    }

    /// The stages that it matches, in node order.
    ///
    /// # Errors
    /// It matches none.
    pub fn stages(&self, graph: &Graph) -> Result<Vec<StageIndex>, NoStage> {
        let all = graph.stages.node_indices();
        let found: Vec<StageIndex> = all.filter(|index| self.means(&graph.stages[*index])).collect();
        if found.is_empty() { Err(self.explain(graph)) } else { Ok(found) }
    }

    /// True where it matches the stage with this id, as in `dril[expert=clipped, policy=beta]`.
    pub fn means_id(&self, id: &str) -> bool {
        let (name, rest) = match id.strip_suffix(']').and_then(|id| id.split_once('[')) {
            Some((name, rest)) => (name, rest),
            None => (id, ""),
        };
        let pairs = rest.split(',').filter_map(|pair| pair.split_once('='));
        self.fits(name, &pairs.map(|(axis, value)| (axis.trim(), value.trim())).collect::<Vec<_>>())
    }

    fn means(&self, stage: &StageInstance) -> bool {
        let pairs = stage.coordinates.iter().map(|(axis, value)| (axis.as_str(), value.as_str()));
        self.fits(&stage.name, &pairs.collect::<Vec<_>>())
    }

    fn fits(&self, name: &str, coordinates: &[(&str, &str)]) -> bool {
        glob(self.name, name)
            && self.axes.iter().all(|(axis, values)| {
                let coordinate = coordinates.iter().find(|(name, _)| name == axis);
                coordinate.is_some_and(|(_, value)| values.iter().any(|pattern| glob(pattern, value)))
            })
    }

    /// Why it matches nothing.
    fn explain(&self, graph: &Graph) -> NoStage {
        let stages = || graph.stages.node_weights();
        let distinct = |names: &mut dyn Iterator<Item = String>| names.collect::<BTreeSet<_>>();
        let shown = crate::spec::node::shorten(self.text);
        let named: Vec<&StageInstance> = stages().filter(|stage| glob(self.name, &stage.name)).collect();
        let left_out: Vec<&str> =
            graph.left_out.iter().map(|name| &**name).filter(|name| glob(self.name, name)).collect();
        if named.is_empty() && !left_out.is_empty() {
            let names = suggest::list(&left_out);
            let what = match left_out.len() {
                1 => format!("stage {names} is left out by its `when`"),
                _ => format!("the stages {names} are left out by their `when`"),
            };
            return NoStage {
                message: format!("{what} in profile `{}`", graph.profile),
                hint: "choose another profile, or change its `when`".to_owned(),
            };
        }
        if named.is_empty() {
            let known = distinct(&mut stages().map(|stage| stage.name.to_string()));
            let hint = suggest::hint(self.name, "the stages", known.iter().map(String::as_str));
            return NoStage { message: format!("there is no stage `{shown}`"), hint };
        }
        for (axis, values) in &self.axes {
            let on_axis = named.iter().flat_map(|stage| &stage.coordinates).filter(|(name, _)| name == axis);
            let known = distinct(&mut on_axis.map(|(_, value)| value.clone()));
            let known: Vec<&str> = known.iter().map(String::as_str).collect();
            if known.is_empty() {
                let axes = distinct(
                    &mut named.iter().flat_map(|stage| &stage.coordinates).map(|(name, _)| name.clone()),
                );
                let hint = suggest::hint(axis, "its axes", axes.iter().map(String::as_str));
                return NoStage { message: format!("`{shown}`: the stage has no axis `{axis}`"), hint };
            }
            if !known.iter().any(|value| values.iter().any(|pattern| glob(pattern, value))) {
                let value = values.join("|");
                let hint = suggest::hint(&value, "its values", known.iter().copied());
                return NoStage { message: format!("`{shown}`: no instance has `{axis}={value}`"), hint };
            }
        }
        NoStage {
            message: format!("`{shown}`: no instance has all of these values"),
            hint: "remove one of them; `dril-pipe plan --all` lists the instances".to_owned(),
        }
    }
}

/// True where `text` matches `pattern`: `*` matches any characters, `?` one.
fn glob(pattern: &str, text: &str) -> bool {
    let (pattern, text): (Vec<char>, Vec<char>) = (pattern.chars().collect(), text.chars().collect());
    let (mut p, mut t) = (0, 0);
    // The position of the last `*`, and how much of the text it has taken.
    let mut star: Option<(usize, usize)> = None;
    while t < text.len() {
        match pattern.get(p) {
            Some('*') => {
                star = Some((p, t));
                p += 1;
            }
            Some(c) if *c == '?' || *c == text[t] => (p, t) = (p + 1, t + 1),
            _ => match &mut star {
                Some((at, taken)) => {
                    *taken += 1;
                    (p, t) = (*at + 1, *taken);
                }
                None => return false,
            },
        }
    }
    pattern[p..].iter().all(|c| *c == '*')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stars_and_question_marks_stand_for_characters() {
        for (pattern, text, expected) in [
            ("table22", "table22", true),
            ("table*", "table22", true),
            ("*", "", true),
            ("*2", "table22", true),
            ("t*b*2", "table22", true),
            ("table?", "table22", false),
            ("table??", "table22", true),
            ("", "a", false),
            ("a*b", "a", false),
            ("*a*a*a*a*a*a*b", "aaaaaaaaaaaaaaaaaaaaaaaaaaaa", false),
        ] {
            assert_eq!(glob(pattern, text), expected, "{pattern} {text}");
        }
    }

    #[test]
    fn a_stage_is_named_by_id_name_coordinates_or_pattern() {
        let id = "dril[expert=clipped, policy=beta]";
        let means = |word: &str| Pattern::parse(word).is_ok_and(|pattern| pattern.means_id(id));
        for word in [
            "dril",
            id,
            "dril[policy=beta]",
            "dril[policy=beta,expert=clipped]",
            "dril[policy=gaussian|beta]",
            "d*",
            "dr?l",
            "*[policy=b*]",
        ] {
            assert!(means(word), "{word}");
        }
        for word in
            ["dri", "dril[policy=gaussian]", "dril[seed=1]", "", "e*", "dril[policy=bet?a]", "dril[beta]"]
        {
            assert!(!means(word), "{word}");
        }
    }

    #[test]
    fn a_pattern_of_many_stars_ends() {
        assert!(!glob(&"*a".repeat(200), &"a".repeat(150)));
        assert!(glob(&"*".repeat(200), "x"));
    }
}
