//! `dril-pipe explain`: why stages are stale, or why they ran last time, traced back to the first cause.

use std::collections::VecDeque;
use std::process::ExitCode;

use dril_stage_api::Registry;
use serde_json::{Value, json};

use super::{age, epoch, overview, pick_stages};
use crate::cli::args::ExplainArgs;
use crate::cli::terminal::{Style, Terminal, print, printable};
use crate::cli::{pipeline, why};
use crate::error::Error;
use crate::plan::{self, Explanation, Explanations, Plan, Reason, Verdict};
use crate::resolve::StageIndex;
use crate::store::{Digest, Store};

/// The number of upstream stages that are listed per input; `--json` has all.
const MAX_CAUSES: usize = 3;
/// The number of reasons that are listed per stage.
const MOST_REASONS: usize = 12;
/// The number of stages in a row that are listed although nothing in them differs.
const MOST_PASSED: usize = 3;
/// The deepest indentation.
const DEEPEST_INDENT: usize = 12;
/// The depth of nested lists in the JSON.
const DEEPEST: usize = 20;

pub(in crate::cli) fn main(args: &ExplainArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let graph = pipeline::source(&args.look.pipeline).load(registry)?;
    let store = pipeline::store(&args.look.store)?;
    let picked = pick_stages(&graph, &args.look.stages)?;
    let plan = plan::plan(&graph, &store, &pipeline::source(&args.look.pipeline).base())?;
    let is_explained = |stage: &StageIndex| {
        !args.look.stages.is_empty() || !matches!(plan.verdict(*stage), Some(Verdict::Cached { .. }))
    };
    let asked: Vec<StageIndex> = picked.into_iter().filter(is_explained).collect();
    if args.look.stages.is_empty() && !args.look.json {
        let text = if asked.is_empty() {
            "every stage is up to date; name one to see why it ran last time\n".to_owned()
        } else {
            overview::text(&plan, Terminal::stdout())
        };
        print(&text)?;
        return Ok(ExitCode::SUCCESS);
    }
    let explained = plan::explain(&plan, &store, &asked)?;
    let mut teller = Printer {
        plan: &plan,
        store: &store,
        terminal: Terminal::stdout(),
        printed: vec![false; explained.all.len()],
        explained: &explained,
    };
    if args.look.json {
        print(&format!("{:#}\n", teller.all_as_json()?))?;
    } else {
        let texts = (0..explained.asked).map(|at| teller.text(at)).collect::<Result<Vec<_>, _>>()?;
        print(&texts.join("\n"))?;
    }
    Ok(ExitCode::SUCCESS)
}

struct Printer<'a> {
    plan: &'a Plan<'a>,
    store: &'a Store,
    terminal: Terminal,
    explained: &'a Explanations,
    /// The stages that are in the output already.
    printed: Vec<bool>,
}

impl<'a> Printer<'a> {
    fn at(&self, at: usize) -> &'a Explanation {
        &self.explained.all[at]
    }

    fn text(&mut self, at: usize) -> Result<String, Error> {
        let explanation = self.at(at);
        let mut text = self.terminal.paint(Style::Strong, self.id(explanation.stage));
        text += &format!(": {}\n", self.standing(explanation.stage)?);
        let fresh = matches!(self.plan.verdict(explanation.stage), Some(Verdict::Cached { .. }));
        match (explanation.against, fresh) {
            (None, true) => text += "  there is no earlier record to compare with\n",
            (None, false) => {}
            (Some(key), _) => {
                let made = self.store.made_at(&key)?.map(age).unwrap_or_default();
                text += &format!("  compared with its record from {made} (key {})\n", key.short());
            }
        }
        self.below(at, &mut text);
        Ok(text)
    }

    /// What differs in a stage, and the stages behind it. The deepest is not deeper than the program's own stack: what is
    /// to be printed next is kept in a list, the next one last.
    fn below(&mut self, at: usize, text: &mut String) {
        let mut next = vec![Next::Below { at, depth: 1 }];
        while let Some(step) = next.pop() {
            match step {
                Next::Line(line) => *text += &line,
                Next::Below { at, .. } if std::mem::replace(&mut self.printed[at], true) => {
                    // Its reasons are listed at its first occurrence.
                    let end = text.trim_end().len();
                    text.insert_str(end, " (as above)");
                }
                Next::Below { at, depth } => {
                    *text += &self.own(at, depth);
                    self.behind(at, depth, &mut next);
                }
            }
        }
    }

    /// What differs in a stage itself.
    fn own(&self, at: usize, depth: usize) -> String {
        let (explanation, indent) = (self.at(at), indent(depth));
        let has_more = explanation.against.is_some() || !explanation.causes.is_empty();
        let reasons: Vec<&Reason> = explanation
            .reasons
            .iter()
            .filter(|reason| !(has_more && matches!(reason, Reason::New)))
            .collect();
        let mut text = String::new();
        for reason in reasons.iter().take(MOST_REASONS) {
            text += &format!("{indent}{}\n", self.reason(reason));
        }
        if let Some(more) = reasons.len().checked_sub(MOST_REASONS).filter(|more| *more > 0) {
            text += &format!("{indent}and {more} more\n");
        }
        if reasons.is_empty() && explanation.causes.is_empty() {
            text += &format!("{indent}nothing differs\n");
        }
        text
    }

    /// The stages behind one, put onto `next`. Of those that only pass on what is behind them, many in a row are counted.
    fn behind(&self, at: usize, depth: usize, next: &mut Vec<Next>) {
        let indent = indent(depth);
        let mut steps = Vec::new();
        let mut port = "";
        let mut shown = 0;
        let causes = &self.at(at).causes;
        for cause in causes {
            if cause.port != port {
                (port, shown) = (&cause.port, 0);
            }
            shown += 1;
            if shown <= MAX_CAUSES {
                let stage = self.at(cause.at).stage;
                let line = format!("{indent}input `{port}` from {}: {}", self.id(stage), self.verdict(stage));
                steps.push(Next::Line(line + "\n"));
                let (end, passed) = self.passed(cause.at);
                if passed > MOST_PASSED {
                    let stage = self.at(end).stage;
                    let line = format!(
                        "{indent}  through {passed} more stages, from {}: {}",
                        self.id(stage),
                        self.verdict(stage)
                    );
                    steps.push(Next::Line(line + "\n"));
                    steps.push(Next::Below { at: end, depth: depth + 2 });
                } else {
                    steps.push(Next::Below { at: cause.at, depth: depth + 1 });
                }
            } else if shown == MAX_CAUSES + 1 {
                let all = causes.iter().filter(|other| other.port == port).count();
                let line = format!("{indent}input `{port}` from {} more such stages\n", all - MAX_CAUSES);
                steps.push(Next::Line(line));
            }
        }
        next.extend(steps.into_iter().rev());
    }

    /// The first stage behind `at` in which something differs itself or that has several causes, and how many lie between.
    fn passed(&self, at: usize) -> (usize, usize) {
        let (mut end, mut passed) = (at, 0);
        // What was never made differs in nothing.
        let differs = |at: usize| self.at(at).reasons.iter().any(|reason| *reason != Reason::New);
        while let ([only], false) = (self.at(end).causes.as_slice(), differs(end)) {
            (end, passed) = (only.at, passed + 1);
        }
        (end, passed.max(1) - 1)
    }

    fn reason(&self, reason: &Reason) -> String {
        let short = |digest: &Option<Digest>| digest.map_or("(nothing)".to_owned(), |digest| digest.short());
        match reason {
            Reason::Input { port, from, old, new } if old.is_some() || new.is_some() => {
                format!("input `{port}` differs ({}): {} -> {}", printable(from), short(old), short(new))
            }
            Reason::New => "new: there is no earlier record".to_owned(),
            other => why::text(std::slice::from_ref(other)),
        }
    }

    fn id(&self, stage: StageIndex) -> &str {
        self.plan.graph.stages.node_weight(stage).map_or("", |stage| &stage.id)
    }

    fn verdict(&self, stage: StageIndex) -> &'static str {
        match self.plan.verdict(stage) {
            Some(Verdict::Cached { .. }) => "up to date, but its content differs from then",
            Some(Verdict::Run { .. }) => "will run",
            _ => "depends on stages that will run",
        }
    }

    /// What will become of it, or what became.
    fn standing(&self, stage: StageIndex) -> Result<String, Error> {
        Ok(match self.plan.verdict(stage) {
            Some(Verdict::Cached { key, .. }) => {
                let made = self.store.made_at(key)?.map(age).unwrap_or_default();
                format!("up to date since {made} (key {}); compared with the record before:", key.short())
            }
            Some(Verdict::Run { key, .. }) => format!("will run (key {})", key.short()),
            _ => "runs after the stages upstream, if its inputs change".to_owned(),
        })
    }

    /// Those that were asked for, each with what is behind it. What is deeper than a program that reads it may like stands
    /// behind them, as what it is: not asked for.
    fn all_as_json(&mut self) -> Result<Value, Error> {
        let mut all = Vec::new();
        let mut open: VecDeque<usize> = (0..self.explained.asked).collect();
        while let Some(at) = open.pop_front() {
            if at < self.explained.asked || !self.printed[at] {
                let mut json = self.json(at, 0, &mut open)?;
                json["asked"] = json!(at < self.explained.asked);
                all.push(json);
            }
        }
        Ok(Value::Array(all))
    }

    fn json(&mut self, at: usize, depth: usize, open: &mut VecDeque<usize>) -> Result<Value, Error> {
        let explanation = self.at(at);
        let verdict = match self.plan.verdict(explanation.stage) {
            Some(Verdict::Cached { .. }) => "cached",
            Some(Verdict::Run { .. }) => "run",
            _ => "depends-on",
        };
        let asked_elsewhere = depth > 0 && at < self.explained.asked;
        let repeated = asked_elsewhere || depth > 0 && self.printed[at];
        let mut json = json!({
            "stage": self.id(explanation.stage), "verdict": verdict, "key": explanation.key, "repeated": repeated,
            "against": Value::Null, "why": [], "causes": [],
        });
        if repeated {
            return Ok(json);
        }
        if depth > DEEPEST {
            json["repeated"] = json!(true);
            open.push_back(at);
            return Ok(json);
        }
        self.printed[at] = true;
        if let Some(key) = explanation.against {
            json["against"] = json!({ "key": key, "made": self.store.made_at(&key)?.map(epoch) });
        }
        json["why"] = explanation.reasons.iter().map(why::json).collect();
        let mut causes = Vec::new();
        for cause in &explanation.causes {
            let mut json = self.json(cause.at, depth + 1, open)?;
            json["port"] = json!(cause.port);
            causes.push(json);
        }
        json["causes"] = causes.into();
        Ok(json)
    }
}

/// What is to be printed next of a tree.
enum Next {
    Line(String),
    Below { at: usize, depth: usize },
}

/// Deeper lines are indented no further.
fn indent(depth: usize) -> String {
    "  ".repeat(depth.min(DEEPEST_INDENT))
}
