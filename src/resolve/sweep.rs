//! How to try several values where `--set` takes only one.

use crate::spec::Spec;
use crate::spec::names;
use crate::spec::node::{Key, Node, Value};

/// What to write instead of several values for `keys`: a param is swept through a field that it fills, or as an axis.
pub(super) fn hint(spec: &Spec, keys: &[Key]) -> String {
    let allowed = "several values are allowed for a field of a stage, as in `--set dril.total_timesteps=8192,16384`, and for an axis";
    let [params, name] = keys else { return allowed.to_owned() };
    if &*params.text != "params" {
        return allowed.to_owned();
    }
    let name = &name.text;
    let wanted = [format!("${name}"), format!("${{{name}}}")];
    let field = spec.stages.iter().find_map(|stage| {
        let path = path_of(stage.with.as_ref()?, &wanted)?;
        Some(format!("set the field of a stage, as in `--set {}.{path}=...,...`, or ", stage.name.text))
    });
    format!(
        "several values are allowed for a field of a stage and for an axis: {}declare `{name}` under `axes` and add it to the `matrix` of its stages",
        field.unwrap_or_default()
    )
}

/// The path to a value that is one of these texts.
fn path_of(node: &Node, wanted: &[String; 2]) -> Option<String> {
    let Value::Map(entries) = &node.value else { return None };
    entries.iter().filter(|(key, _)| names::is_identifier(&key.text)).find_map(|(key, node)| {
        if node.scalar_text().is_some_and(|text| wanted.iter().any(|wanted| **wanted == *text)) {
            return Some(key.text.to_string());
        }
        Some(format!("{}.{}", key.text, path_of(node, wanted)?))
    })
}
