//! `when`: which instances of a stage exist. A value that can never be there is an error: a typo would remove the stage silently.

use std::sync::Arc;

use super::axes::{Axis, AxisValue};
use super::choices::DEFAULT;
use super::context::ResolveContext;
use super::elsewhere;
use super::rules::{maps, one_or_more, value_hint};
use super::scope::{Filler, Scope};
use super::template::{self, Path};
use crate::spec::model::Stage;
use crate::spec::node::{Key, Node, Value};
use crate::spec::problem::Problem;
use crate::spec::suggest;

/// The numbers of the instances for which one of the maps matches; there may be none. `instances` are those of the matrix, whose
/// axes are `axes`.
pub(super) fn kept<'g>(
    node: &Node,
    stage: &Stage,
    axes: &[Axis],
    instances: impl Iterator<Item = Vec<(&'g str, &'g AxisValue)>>,
    context: &ResolveContext<'_>,
    filler: &mut Filler<'_>,
) -> Option<Vec<usize>> {
    let place = format!("stage `{}`", stage.name.text);
    let maps = maps(node, "when", filler)?;
    let reports = filler.problems.reports();
    for (key, expected) in maps.iter().copied().flatten() {
        check(key, expected, stage, axes, context, filler);
    }
    let mut kept = Vec::new();
    for (number, axes) in instances.enumerate() {
        let scope = Scope { globals: context.globals, axes, all_axes: context.axis_places, place: &place };
        let mut holds = false;
        for entries in &maps {
            let mut all = true;
            for (key, expected) in *entries {
                all &= condition(key, expected, &scope, filler)?;
            }
            holds |= all;
        }
        if holds {
            kept.push(number);
        }
    }
    (filler.problems.reports() == reports).then_some(kept)
}

/// The name that a key of `when` asks for: the `$` is optional.
fn name_of(key: &Key) -> &str {
    key.text.strip_prefix('$').unwrap_or(&key.text)
}

/// The profiles that can be chosen.
fn profiles<'a>(context: &ResolveContext<'a>) -> Vec<&'a str> {
    let known: Vec<&str> = context.spec.profiles().collect();
    if known.is_empty() { vec![DEFAULT] } else { known }
}

/// Reports values that the name has in no profile. What is not a plain value is left to [`condition`].
fn check(
    key: &Key,
    expected: &Node,
    stage: &Stage,
    axes: &[Axis],
    context: &ResolveContext<'_>,
    filler: &mut Filler<'_>,
) {
    let name = name_of(key);
    let mut path = name.split('.');
    let axis = path.next().and_then(|first| axes.iter().find(|axis| &*axis.name == first));
    let path: Vec<&str> = path.collect();
    let has = |text: &str| match axis {
        Some(axis) if path.is_empty() => axis.position(text).is_some() || axis.is_gone(text),
        Some(axis) => axis.values().iter().any(|value| value.text(&path).is_some_and(|own| *own == *text)),
        // A param can have any value, by `--set`.
        None => name != "profile" || profiles(context).contains(&text),
    };
    let wanted = expected.get("not").map_or(expected, |(_, node)| node);
    for value in one_or_more(wanted) {
        let Some(text) = value.scalar_text().filter(|text| !text.contains('$') && !has(text)) else {
            continue;
        };
        let Some(axis) = axis else {
            filler.problems.add(|| {
                let shown = crate::spec::node::shorten(&text);
                let problem = Problem::new(value.span, format!("`when`: there is no profile `{shown}`"));
                problem.hint(suggest::hint(&text, "the profiles", profiles(context)))
            });
            continue;
        };
        let known = elsewhere::values(axis, &path, stage, context);
        if known.iter().any(|own| **own == *text) {
            continue;
        }
        filler.problems.add(|| {
            let known: Vec<&str> = known.iter().map(|text: &Arc<str>| &**text).collect();
            let message = if path.is_empty() {
                format!("`when`: axis `{}` has no value that is {}", axis.name, value.describe())
            } else {
                format!("`when`: `{name}` is {} for no value of the axis", value.describe())
            };
            Problem::new(value.span, message).hint(value_hint(&text, "its values", &known))
        });
    }
}

fn condition(key: &Key, expected: &Node, scope: &Scope<'_>, filler: &mut Filler<'_>) -> Option<bool> {
    let name = name_of(key);
    if !template::is_path(name) {
        filler.problems.add(|| {
            let shown = crate::spec::node::shorten(&key.text);
            Problem::new(
                key.span,
                format!("`when` asks for `{shown}`, expected the name of an axis or a param"),
            )
            .hint("as in `when: { expert: clipped, profile: [desk, thesis] }`")
        });
        return None;
    }
    let value = filler.value(&Path { text: name, range: 0..key.text.len() }, key.span, scope)?;
    let Some(seen) = value.scalar_text() else {
        filler.problems.add(|| {
            Problem::new(
                key.span,
                format!(
                    "`when`: `{name}` is {}, expected a text, a number, `true` or `false`",
                    value.describe()
                ),
            )
        });
        return None;
    };
    let expected = filler.fill(expected, scope)?;
    let (wanted, negated) = match expected.get("not") {
        Some((_, node)) => (node, true),
        None => (&expected, false),
    };
    if let Value::Map(entries) = &expected.value
        && let Some((other, _)) = entries.iter().find(|(key, _)| negated && &*key.text != "not")
    {
        filler.problems.add(|| {
            let other_name = crate::spec::node::shorten(&other.text);
            let message = format!("`when`: found `{other_name}` beside `not`, expected `not` alone");
            Problem::new(other.span, message)
                .hint(format!("write `{name}: {{ not: value }}` or `{name}: {{ not: [one, other] }}`"))
        });
        return None;
    }
    let texts: Option<Vec<_>> = one_or_more(wanted).iter().map(Node::scalar_text).collect();
    let Some(texts) = texts else {
        filler.problems.add(|| {
            Problem::new(expected.span, format!("`when`: `{name}` is compared with {}", expected.describe()))
                .hint(format!("write `{name}: value`, `{name}: [one, other]` or `{name}: {{ not: value }}`"))
        });
        return None;
    };
    Some(texts.iter().any(|text| **text == *seen) != negated)
}
