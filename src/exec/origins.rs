//! Names the inputs in a stage's error as the pipeline file does: the stage itself knows only the paths of blobs.

use std::collections::BTreeMap;

use dril_stage_api::Job;

use super::failure::Failure;
use crate::store::Record;

/// What a path is, as input and origin.
struct Named<'a> {
    port: &'a str,
    from: &'a str,
    /// Further inputs with the same content, and so with the same path.
    others: usize,
}

/// Replaces the path of an input by its origin.
pub(super) fn name_inputs(failure: Failure, job: &Job, record: &Record) -> Failure {
    let Failure::Stage(error) = failure else { return failure };
    let mut known: BTreeMap<&str, Named<'_>> = BTreeMap::new();
    for (port, items) in &job.inputs {
        let origins = record.inputs.iter().find(|input| input.port == *port);
        for (item, origin) in items.iter().zip(origins.iter().flat_map(|input| &input.items)) {
            let Some(path) = item.path.to_str().filter(|path| error.contains(*path)) else { continue };
            known.entry(path).and_modify(|named| named.others += 1).or_insert(Named {
                port,
                from: &origin.from,
                others: 0,
            });
        }
    }
    Failure::Stage(replaced(&error, &known))
}

/// The text with each path replaced once, so that what was put in its place stays as it is.
fn replaced(text: &str, known: &BTreeMap<&str, Named<'_>>) -> String {
    let mut done = String::new();
    let mut rest = text;
    loop {
        let found = known.iter().filter_map(|(path, named)| Some((rest.find(path)?, *path, named)));
        // Of two at one place the longer one: `…/parts-1` is also the beginning of `…/parts-12`.
        let first = found.min_by_key(|(at, path, _)| (*at, std::cmp::Reverse(path.len())));
        let Some((at, path, Named { port, from, others })) = first else { break };
        let more = match others {
            0 => String::new(),
            1 => " and 1 other with the same content".to_owned(),
            others => format!(" and {others} others with the same content"),
        };
        done.push_str(&format!("{}{from}{more} (input `{port}`, {path})", &rest[..at]));
        rest = &rest[at + path.len()..];
    }
    done + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named<'a>(port: &'a str, from: &'a str, others: usize) -> Named<'a> {
        Named { port, from, others }
    }

    #[test]
    fn a_path_is_replaced_once_however_many_inputs_have_its_content() {
        let known = BTreeMap::from([
            ("/store/ab", named("scores", "s[seed=1].o", 4)),
            ("/store/cd", named("start", "data.csv", 0)),
        ]);
        let text = "cannot join `/store/ab` and `/store/cd` (/store/ab)";
        let expected = "cannot join `s[seed=1].o and 4 others with the same content (input `scores`, /store/ab)` and \
                        `data.csv (input `start`, /store/cd)` \
                        (s[seed=1].o and 4 others with the same content (input `scores`, /store/ab))";
        assert_eq!(replaced(text, &known), expected);
    }

    #[test]
    fn a_path_that_begins_like_another_is_not_mistaken_for_it() {
        let known = BTreeMap::from([("/s/p-1", named("p", "one", 0)), ("/s/p-12", named("p", "twelve", 0))]);
        assert_eq!(replaced("/s/p-12", &known), "twelve (input `p`, /s/p-12)");
    }
}
