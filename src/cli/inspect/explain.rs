//! `dril-pipe explain`: why stages are stale, or ran the last time, back to the first cause.

use std::process::ExitCode;

use dril_stage_api::Registry;
use serde_json::{Value, json};

use super::super::args::ExplainArgs;
use super::super::terminal::{Style, Terminal, print, printable};
use super::super::{pipeline, why};
use super::{age, epoch, pick_stages};
use crate::error::Error;
use crate::plan::{self, Explanation, Plan, Reason, Verdict};
use crate::resolve::StageIndex;
use crate::store::{Digest, Store};

/// At most so many stages behind one input are told to people; `--json` has all.
const MOST_CAUSES: usize = 3;
/// At most so many reasons of one stage.
const MOST_REASONS: usize = 12;

pub(in crate::cli) fn main(args: &ExplainArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let graph = pipeline::load(&args.look.pipeline, registry)?;
    let store = pipeline::store(&args.look.store)?;
    let picked = pick_stages(&graph, &args.look.stages)?;
    let plan = plan::plan(&graph, &store, &pipeline::base(&args.look.pipeline))?;
    let is_told = |stage: &StageIndex| {
        !args.look.stages.is_empty() || !matches!(plan.verdict(*stage), Some(Verdict::Cached { .. }))
    };
    let mut told = Vec::new();
    for stage in picked.into_iter().filter(is_told) {
        told.push(plan::explain(&plan, &store, stage)?);
    }
    let teller = Teller { plan: &plan, store: &store, terminal: Terminal::stdout() };
    if args.look.json {
        let all = told.iter().map(|explanation| teller.json(explanation)).collect::<Result<Vec<_>, _>>()?;
        print(&format!("{:#}\n", Value::Array(all)))?;
    } else if told.is_empty() {
        print("every stage is up to date; name one to see what made it run the last time\n")?;
    } else {
        let texts = told.iter().map(|explanation| teller.text(explanation)).collect::<Result<Vec<_>, _>>()?;
        print(&texts.join("\n"))?;
    }
    Ok(ExitCode::SUCCESS)
}

struct Teller<'a> {
    plan: &'a Plan<'a>,
    store: &'a Store,
    terminal: Terminal,
}

impl Teller<'_> {
    fn text(&self, explanation: &Explanation) -> Result<String, Error> {
        let mut text = self.terminal.paint(Style::Strong, self.id(explanation.stage));
        text += &format!(": {}\n", self.standing(explanation.stage)?);
        let fresh = matches!(self.plan.verdict(explanation.stage), Some(Verdict::Cached { .. }));
        match (explanation.against, fresh) {
            (None, true) => text += "  no earlier record of it to compare with\n",
            (None, false) => {}
            (Some(key), _) => {
                let made = self.store.made_at(&key)?.map(age).unwrap_or_default();
                text += &format!("  compared with what was made {made} (key {})\n", key.short());
            }
        }
        self.below(explanation, 1, &mut text);
        Ok(text)
    }

    fn below(&self, explanation: &Explanation, depth: usize, text: &mut String) {
        let indent = "  ".repeat(depth);
        if explanation.repeated {
            *text += &format!("{indent}(as above)\n");
            return;
        }
        let has_more = explanation.against.is_some() || !explanation.causes.is_empty();
        let reasons: Vec<&Reason> = explanation
            .reasons
            .iter()
            .filter(|reason| !(has_more && matches!(reason, Reason::New)))
            .collect();
        for reason in reasons.iter().take(MOST_REASONS) {
            *text += &format!("{indent}{}\n", self.reason(reason));
        }
        if let Some(more) = reasons.len().checked_sub(MOST_REASONS).filter(|more| *more > 0) {
            *text += &format!("{indent}and {more} more\n");
        }
        if reasons.is_empty() && explanation.causes.is_empty() {
            *text += &format!("{indent}nothing differs\n");
        }
        let mut port = "";
        let mut shown = 0;
        for cause in &explanation.causes {
            if cause.port != port {
                (port, shown) = (&cause.port, 0);
            }
            shown += 1;
            if shown <= MOST_CAUSES {
                let stage = cause.explanation.stage;
                *text += &format!(
                    "{indent}input `{port}` comes from {}: {}\n",
                    self.id(stage),
                    self.verdict(stage)
                );
                self.below(&cause.explanation, depth + 1, text);
            } else if shown == MOST_CAUSES + 1 {
                let all = explanation.causes.iter().filter(|other| other.port == port).count();
                *text +=
                    &format!("{indent}input `{port}` comes from {} more such stages\n", all - MOST_CAUSES);
            }
        }
    }

    fn reason(&self, reason: &Reason) -> String {
        let short = |digest: &Option<Digest>| digest.map_or("(nothing)".to_owned(), |digest| digest.short());
        match reason {
            Reason::Input { port, from, old, new } if old.is_some() || new.is_some() => {
                format!("input `{port}` differs ({}): {} -> {}", printable(from), short(old), short(new))
            }
            Reason::New => "new: there is no earlier record of it".to_owned(),
            other => why::text(std::slice::from_ref(other)),
        }
    }

    fn id(&self, stage: StageIndex) -> &str {
        self.plan.graph.stages.node_weight(stage).map_or("", |stage| &stage.id)
    }

    fn verdict(&self, stage: StageIndex) -> &'static str {
        match self.plan.verdict(stage) {
            Some(Verdict::Cached { .. }) => "up to date, but another content than then",
            Some(Verdict::Run { .. }) => "will run",
            _ => "depends on others that will run",
        }
    }

    /// What will become of it, or what became.
    fn standing(&self, stage: StageIndex) -> Result<String, Error> {
        Ok(match self.plan.verdict(stage) {
            Some(Verdict::Cached { key, .. }) => {
                let made = self.store.made_at(key)?.map(age).unwrap_or_default();
                format!("up to date, made {made} (key {}); against the one before:", key.short())
            }
            Some(Verdict::Run { key, .. }) => format!("will run (key {})", key.short()),
            _ => "runs once others have run, unless its inputs come out as before".to_owned(),
        })
    }

    fn json(&self, explanation: &Explanation) -> Result<Value, Error> {
        let verdict = match self.plan.verdict(explanation.stage) {
            Some(Verdict::Cached { .. }) => "cached",
            Some(Verdict::Run { .. }) => "run",
            _ => "depends-on",
        };
        let mut causes = Vec::new();
        for cause in &explanation.causes {
            let mut json = self.json(&cause.explanation)?;
            json["port"] = json!(cause.port);
            causes.push(json);
        }
        let against = match explanation.against {
            Some(key) => json!({ "key": key, "made": self.store.made_at(&key)?.map(epoch) }),
            None => Value::Null,
        };
        let why: Vec<Value> = explanation.reasons.iter().map(why::json).collect();
        Ok(json!({
            "stage": self.id(explanation.stage), "verdict": verdict, "key": explanation.key, "against": against,
            "why": why, "causes": causes, "repeated": explanation.repeated,
        }))
    }
}
