//! What is known of a stage's inputs before anything runs: the labels of fan-ins. A kind checks the labels that its parameters name
//! against them, so that a misspelt one is an error of the pipeline file and not of a stage at the end of a long run.

use std::collections::{BTreeMap, BTreeSet};

use crate::Labels;
use crate::params::{ParamProblem, Problems};

/// An artifact at an input that takes many.
#[derive(Clone, Copy, Debug)]
pub struct Incoming<'a> {
    /// Its labels, as [`crate::InputItem::labels`] will have them.
    pub labels: &'a Labels,
    /// Every column that it can have; `None` where that is not known, as of a file from outside.
    pub columns: Option<&'a [&'static str]>,
}

/// The artifacts at the inputs that take many, each in matrix order. Inputs that are not connected, or wrongly, are absent.
#[derive(Clone, Debug, Default)]
pub struct FanIns<'a>(BTreeMap<&'a str, Vec<Incoming<'a>>>);

impl<'a> FromIterator<(&'a str, Vec<Incoming<'a>>)> for FanIns<'a> {
    fn from_iter<I: IntoIterator<Item = (&'a str, Vec<Incoming<'a>>)>>(ports: I) -> Self {
        Self(ports.into_iter().collect())
    }
}

impl<'a> FanIns<'a> {
    /// True without any artifact: then there is nothing to check.
    pub fn is_empty(&self) -> bool {
        self.0.values().all(Vec::is_empty)
    }

    /// The artifacts at an input.
    pub fn at(&self, port: &str) -> &[Incoming<'a>] {
        self.0.get(port).map(Vec::as_slice).unwrap_or_default()
    }

    /// Reports `label`, which the parameter at `path` names, unless every artifact at `port` has it.
    pub fn require(&self, port: &str, label: &str, path: &str, problems: &mut Problems) {
        let lacks = self.at(port).iter().find(|incoming| !incoming.labels.contains_key(label));
        let Some(lacks) = lacks else { return };
        if !self.has(port, label) {
            return self.unknown(port, label, path, problems);
        }
        let seen: Vec<String> =
            lacks.labels.iter().map(|(axis, value)| format!("`{axis}={value}`")).collect();
        let seen = if seen.is_empty() { "none".to_owned() } else { seen.join(", ") };
        let message = format!("an artifact at `{port}` has no label `{label}`; its labels are {seen}");
        let hint =
            "every artifact there needs it: add the axis to the matrix of its stage, or connect it elsewhere";
        problems.push(ParamProblem { hint: Some(hint.to_owned()), ..ParamProblem::new(path, message) });
    }

    /// True where an artifact at `port` has the label.
    pub fn has(&self, port: &str, label: &str) -> bool {
        self.at(port).iter().any(|incoming| incoming.labels.contains_key(label))
    }

    /// Reports `label`, which the parameter at `path` names and no artifact at `port` has.
    pub fn unknown(&self, port: &str, label: &str, path: &str, problems: &mut Problems) {
        let labels: BTreeSet<&str> =
            self.at(port).iter().flat_map(|incoming| incoming.labels.keys().map(String::as_str)).collect();
        let labels: Vec<&str> = labels.into_iter().collect();
        if labels.is_empty() {
            let hint = Some(format!("the artifacts at `{port}` have no labels"));
            problems
                .push(ParamProblem { hint, ..ParamProblem::new(path, format!("unknown label `{label}`")) });
        } else {
            problems.unknown(path, "label", label, &format!("the labels at `{port}`"), &labels);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(pairs: &[(&str, &str)]) -> Labels {
        pairs.iter().map(|(axis, value)| ((*axis).to_owned(), (*value).to_owned())).collect()
    }

    fn required(label: &str, all: &[Labels]) -> Vec<ParamProblem> {
        let incoming = |labels| Incoming { labels, columns: None };
        let inputs: FanIns<'_> = [("scores", all.iter().map(incoming).collect())].into_iter().collect();
        let mut problems = Problems::default();
        inputs.require("scores", label, "keys.0", &mut problems);
        problems.into_vec()
    }

    #[test]
    fn a_label_that_no_artifact_has_is_reported_with_those_that_there_are() {
        let all =
            [labels(&[("policy", "beta"), ("seed", "1")]), labels(&[("policy", "gaussian"), ("seed", "1")])];
        assert_eq!(required("policy", &all), []);
        let found = required("polcy", &all);
        assert_eq!(
            (found[0].path.join("."), found[0].message.as_str()),
            ("keys.0".into(), "unknown label `polcy`")
        );
        let hint = found[0].hint.as_deref();
        assert_eq!(hint, Some("did you mean `policy`? the labels at `scores` are `policy`, `seed`"));
        let hint = required("polcy", &[labels(&[])])[0].hint.clone();
        assert_eq!(hint.as_deref(), Some("the artifacts at `scores` have no labels"));
        // An input that is not connected is reported elsewhere.
        assert_eq!(required("polcy", &[]), []);
    }

    #[test]
    fn a_label_that_some_artifacts_lack_is_reported_with_the_labels_of_the_first() {
        let all = [labels(&[("policy", "beta"), ("seed", "1")]), labels(&[("policy", "gaussian")])];
        let found = required("seed", &all);
        let message = "an artifact at `scores` has no label `seed`; its labels are `policy=gaussian`";
        assert_eq!((found.len(), found[0].message.as_str()), (1, message));
    }
}
