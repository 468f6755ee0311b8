//! The matrix of a stage as written: `[expert, seed]`, `{ k: [1, 2] }`, or a list that mixes names and such maps. Among
//! the names of a map, `zip`, `include` and `exclude` are words of the language.

use super::fields::{placed, value_name};
use super::model::{MatrixAxis, Rules};
use super::node::{Key, Node, Value};
use super::problem::{Problem, ProblemList};

const HINT: &str = "write `matrix: [expert, seed]`, or `matrix: { k: [1, 2] }` for values of this stage only";

/// Reads a matrix.
pub(super) fn read(node: Node, problems: &mut ProblemList) -> (Vec<MatrixAxis>, Rules) {
    let mut reader = Reader { axes: Vec::new(), rules: Rules::default(), groups: 0, problems };
    match node.value {
        Value::Null => {}
        Value::List(items) => items.into_iter().for_each(|item| reader.item(item, None)),
        Value::Map(_) => reader.item(node, None),
        _ => reader.problems.add(|| {
            Problem::new(node.span, format!("`matrix` is {}, expected a list of axes", node.describe()))
                .hint(HINT)
        }),
    }
    (reader.distinct(), reader.rules)
}

struct Reader<'p> {
    axes: Vec<MatrixAxis>,
    rules: Rules,
    /// Zips so far.
    groups: usize,
    problems: &'p mut ProblemList,
}

impl Reader<'_> {
    fn item(&mut self, item: Node, group: Option<usize>) {
        match item.value {
            Value::Text(text) => {
                self.axes.push(MatrixAxis { name: Key { text, span: item.span }, values: None, group });
            }
            Value::Map(entries) => entries.into_iter().for_each(|(key, node)| self.entry(key, node, group)),
            _ => self.problems.add(|| {
                Problem::new(
                    item.span,
                    format!("found {} in a matrix, expected the name of an axis", item.describe()),
                )
                .hint("for values of this stage only, write `matrix: { k: [1, 2] }`")
            }),
        }
    }

    fn entry(&mut self, key: Key, node: Node, group: Option<usize>) {
        match &*key.text {
            "zip" | "include" | "exclude" if group.is_some() => self.problems.add(|| {
                Problem::new(key.span, format!("found `{}` inside `zip`, expected axes only", key.text))
            }),
            "zip" => self.zip(key, node),
            "include" => self.rule(key, node, |rules| &mut rules.include),
            "exclude" => self.rule(key, node, |rules| &mut rules.exclude),
            _ if value_name(&key, "axis", self.problems) => {
                self.axes.push(MatrixAxis { values: Some(placed(key.clone(), node)), name: key, group });
            }
            _ => {}
        }
    }

    fn zip(&mut self, key: Key, node: Node) {
        self.groups += 1;
        let (group, before) = (Some(self.groups), self.axes.len());
        match node.value {
            Value::List(items) => items.into_iter().for_each(|item| self.item(item, group)),
            Value::Map(_) => self.item(node, group),
            _ => {}
        }
        if self.axes.len() < before + 2 {
            self.problems.add(|| {
                Problem::new(key.span, "`zip` has less than two axes, expected those that go together")
                    .hint("as in `matrix: [{ zip: [steps, rate] }]`, or with values, `{ zip: { steps: [1, 2], rate: [3, 4] } }`")
            });
        }
    }

    fn rule(&mut self, key: Key, node: Node, of: impl FnOnce(&mut Rules) -> &mut Option<Node>) {
        let slot = of(&mut self.rules);
        let twice = slot.is_some();
        *slot = Some(placed(key.clone(), node));
        if twice {
            self.problems.add(|| {
                Problem::new(key.span, format!("`{}` is in this matrix twice", key.text))
                    .hint("put all of its maps into one list")
            });
        }
    }

    /// The axes; one that is listed twice is reported.
    fn distinct(&mut self) -> Vec<MatrixAxis> {
        let mut seen: Vec<MatrixAxis> = Vec::new();
        for axis in std::mem::take(&mut self.axes) {
            match seen.iter().find(|earlier| earlier.name.text == axis.name.text) {
                Some(earlier) => self.problems.add(|| {
                    Problem::new(
                        axis.name.span,
                        format!("the axis `{}` is in this matrix twice", axis.name.text),
                    )
                    .related(earlier.name.span, "first")
                    .hint("remove one of the two")
                }),
                None => seen.push(axis),
            }
        }
        seen
    }
}
