//! The page: what it shows of a pipeline, what it never does, and how large it grows.

use std::collections::BTreeMap;

use dril_report::html::{MARK, page};
use dril_report::{Figure, Findings, Table};
use dril_stage_api::Artifact;
use dril_stage_api::outcome::{InputOutcome, State};
use serde_json::json;

use crate::fakes;
use crate::lab::{Lab, losses, noise, scores};

/// Something like the thesis: 48 evaluations around its values, tables, findings, figures.
fn thesis(profile: &str, episodes: usize) -> Lab {
    let mut lab = Lab::new(profile);
    let reference = fakes::reference("table22.csv");
    let mut ensembles = Vec::new();
    for (n, (expert, laps)) in
        [("clipped", "1"), ("clipped", "20"), ("bounded", "1"), ("bounded", "20")].into_iter().enumerate()
    {
        let labels = [("expert", expert), ("demonstrations", laps)];
        ensembles.push((
            lab.stage("ensemble", "ensemble", &labels, &[("log", Artifact::TRAINING_LOG, "csv", &losses(n))]),
            "log",
        ));
    }
    let mut evaluations = Vec::new();
    for (n, labels) in fakes::matrix().iter().enumerate() {
        let (mean, std) = fakes::reported(labels);
        let bytes = scores(mean + 60.0 * noise(n + 7), std, n, episodes);
        evaluations.push((
            lab.stage("evaluate", "evaluate", labels, &[("scores", Artifact::SCORES, "csv", &bytes)]),
            "scores",
        ));
    }
    let keys = json!(["expert", "method", "mode", "policy", "demonstrations"]);
    let table = json!({
        "title": "Table 22: all policies", "profile": profile, "full_profile": "thesis", "keys": keys, "columns": ["demonstrations", "policy"],
    });
    lab.run::<Table>("table22", "table", &table, "scores", &evaluations, Some(&reference));
    let of = |lab: &Lab, fits: &dyn Fn(&str) -> bool| -> Vec<(usize, &'static str)> {
        let all = evaluations.iter().filter(|(at, _)| fits(&lab.outcome.stages[*at].id));
        all.copied().collect()
    };
    let clones = of(&lab, &|id| id.contains("[clipped, bc, deterministic, gaussian"));
    let small = json!({ "title": "Table 12: behaviour cloning", "profile": profile, "full_profile": "thesis", "keys": keys, "columns": ["demonstrations"] });
    lab.run::<Table>("table12", "table", &small, "scores", &clones, Some(&reference));
    let claims = json!([
        { "claim": "DRIL drives better at its peak than after its last step", "is": "greater", "left": { "method": "dril-peak" }, "right": { "method": "dril-final" } },
        { "claim": "Twenty laps teach more than one", "is": "greater", "left": { "demonstrations": 20 }, "right": { "demonstrations": 1 } },
        { "claim": "Gaussian clones drive worse with sampled actions", "is": "greater", "where": { "method": "bc", "policy": "gaussian" }, "left": { "mode": "deterministic" }, "right": { "mode": "stochastic" } },
        { "claim": "Beta clones of bounded actions equal Gaussian peak DRIL on clipped ones", "is": "equal", "margin": 50, "where": { "mode": "stochastic", "demonstrations": 20 }, "left": { "expert": "bounded", "method": "bc", "policy": "beta" }, "right": { "expert": "clipped", "method": "dril-peak", "policy": "gaussian" } },
        { "claim": "Final DRIL beats behaviour cloning", "is": "greater", "left": { "method": "dril-final" }, "right": { "method": "bc" } },
    ]);
    let findings = json!({ "title": "What the thesis found", "profile": profile, "full_profile": "thesis", "claims": claims });
    lab.run::<Findings>("findings", "findings", &findings, "scores", &evaluations, Some(&reference));
    let intervals = json!({
        "title": "Table 22 as intervals", "preset": "interval", "columns": ["expert"], "colour": ["method"],
        "categories": ["policy", "demonstrations", "mode"], "rules": [{ "x": 900, "label": "solved" }], "profile": profile, "full_profile": "thesis",
    });
    lab.run::<Figure>("figure-table22", "figure", &intervals, "data", &evaluations, Some(&reference));
    let scatter = json!({
        "title": "Figure A.2 b-d, f-h: 100 laps, clipped actions, Gaussian policies", "preset": "scores",
        "rows": ["mode"], "columns": ["demonstrations", "method"], "range": { "y": [-300, 1000] }, "profile": profile, "full_profile": "thesis",
    });
    let gaussian = of(&lab, &|id| id.contains("[clipped") && id.contains("gaussian"));
    lab.run::<Figure>("figure-a2", "figure", &scatter, "data", &gaussian, None);
    let losses = json!({
        "title": "Figure 35: training the ensemble, clipped actions", "preset": "losses", "columns": ["demonstrations"],
        "profile": profile, "full_profile": "thesis",
    });
    lab.run::<Figure>("figure35", "figure", &losses, "data", &ensembles[..2], None);
    lab
}

#[test]
fn a_table_that_waits_for_evaluations_is_shown_as_far_as_it_is_known() {
    let mut lab = thesis("thesis", 100);
    let at = lab.outcome.stages.iter().position(|stage| stage.name == "table22").unwrap();
    for stage in &mut lab.outcome.stages[at..] {
        (stage.state, stage.outputs) = (State::Waiting, Vec::new());
    }
    lab.outcome.stages[at].inputs.push(InputOutcome {
        port: "reference".into(),
        stage: None,
        from: "reference/table22.csv".into(),
        labels: BTreeMap::new(),
        path: Some(fakes::reference("table22.csv")),
    });
    // Only behaviour cloning is done, so that the method varies among what is missing only.
    for stage in lab.outcome.stages.iter_mut().filter(|stage| stage.name == "evaluate") {
        if !stage.id.contains("bc") {
            (stage.state, stage.outputs) = (State::Stale, Vec::new());
        }
    }
    let text = lab.page("so-far");
    let section = text.split("id=\"so-far\"").nth(1).unwrap().split("</section>").next().unwrap();
    assert!(section.contains("16 of 48 evaluations are done."), "{section}");
    assert_eq!(section.matches("class=\"ref\"").count(), 16, "{section}");
    assert_eq!(section.matches("<tr>").count(), 1 + 12, "all rows of the table are there: {section}");
    // A figure that waits draws nothing, so its scores have the default one.
    assert!(text.contains("<code>evaluate.scores</code>"));
    assert!(!thesis("thesis", 100).page("thesis").contains("id=\"so-far\""));
}

#[test]
fn the_page_shows_results_first_and_says_what_they_are_not() {
    let lab = thesis("smoke", 100);
    let text = lab.page("thesis-smoke");
    assert!(text.starts_with(MARK));
    let at = |part: &str| text.find(part).unwrap_or_else(|| panic!("{part} is not there"));
    let order = [
        "Profile smoke, not thesis: sizes are reduced",
        "One training per cell",
        "Table 22: all policies",
        "What the thesis found",
        "Table 22 as intervals",
        "Table 12: behaviour cloning",
        "The graph of the stages",
        "libtorch",
    ];
    at(order[7]);
    for pair in order[..7].windows(2) {
        assert!(at(pair[0]) < at(pair[1]), "{pair:?}");
    }
    assert!(text.contains("dril-pipe run pipelines/thesis.yaml --profile smoke"));
    assert_eq!(text, page(&lab.outcome, None).unwrap(), "equal stores give equal bytes");
    assert!(text.len() < 700_000, "{}", text.len());
    let few = thesis("thesis", 20).page("thesis-few");
    assert!(few.contains("few\"") && !few.contains("sizes are reduced"));
}

#[test]
fn the_page_fetches_nothing_runs_nothing_and_names_no_folder() {
    let lab = thesis("smoke", 30);
    let text = page(&lab.outcome, None).unwrap();
    for (attribute, count) in [("src=", 0), ("<script", 0), ("<link", 0), ("url(", 0), ("@import", 0)] {
        assert_eq!(text.matches(attribute).count(), count, "{attribute}");
    }
    for address in text.split("href=\"").skip(1).map(|rest| rest.split('"').next().unwrap()) {
        assert!(address.starts_with('#') || address.starts_with("./"), "{address}");
        if let Some(anchor) = address.strip_prefix('#') {
            assert!(text.contains(&format!("id=\"{anchor}\"")), "{anchor}");
        }
    }
    assert!(!text.contains(lab.folder.path().to_str().unwrap()));
}

#[test]
fn any_pipeline_has_a_page_and_what_failed_stands_in_it() {
    let mut lab = Lab::new("thesis");
    lab.stage("words", "command", &[], &[("table", Artifact::TABLE, "csv", b"word,fox\n<b>the</b>,4\n")]);
    let svg = b"<svg xmlns=\"http://www.w3.org/2000/svg\"><script>alert(1)</script></svg>";
    lab.stage("error", "command", &[], &[("figure", Artifact::FIGURE, "svg", svg)]);
    lab.stage(
        "log",
        "command",
        &[("seed", "1")],
        &[("log", Artifact::TRAINING_LOG, "csv", b"step,loss\n1,2\n2,1\n3,0.5\n4,0.4\n")],
    );
    let failed = lab.stage("train", "ppo", &[("seed", "2")], &[]);
    lab.outcome.stages[failed].state = State::Failed("no such <device>".into());
    lab.outcome.stages[failed].seconds = None;
    let waiting = lab.stage("evaluate", "evaluate", &[("seed", "2")], &[]);
    lab.outcome.stages[waiting].state = State::Waiting;
    let text = lab.page("any");
    for part in [
        "&lt;b&gt;the&lt;/b&gt;",
        "no such &lt;device&gt;",
        "1 stage failed",
        "1 stage is not up to date",
        "src=\"data:image/svg+xml;base64,",
        "Scores and training logs",
    ] {
        assert!(text.contains(part), "{part}");
    }
    assert!(
        !text.contains("<script>") && !text.contains("<b>the"),
        "what others made is text or an image of its own"
    );
    let empty = Lab::new("thesis").page("empty");
    assert!(empty.contains("0 of 0"));
}

#[test]
fn a_thousand_stages_and_a_hundred_thousand_points_stay_small() {
    let mut lab = Lab::new("thesis");
    for n in 0..1000 {
        let labels = [("method", ["a", "b"][n % 2]), ("seed", &*(n / 2).to_string())];
        lab.stage(
            &format!("stage{}", n % 20),
            "evaluate",
            &labels,
            &[("scores", Artifact::SCORES, "csv", &scores(100.0, 50.0, n, 40))],
        );
    }
    let rows: String = (0..100_000).map(|n| format!("{n},{:.3}\n", 100.0 * noise(n))).collect();
    let log = lab.stage(
        "train",
        "ppo",
        &[],
        &[("log", Artifact::TRAINING_LOG, "csv", format!("step,score_mean_10\n{rows}").as_bytes())],
    );
    let params = json!({ "title": "All points", "x": "step", "y": ["score_mean_10"], "layers": { "points": {}, "line": { "smooth": 100 } } });
    lab.run::<Figure>("all-points", "figure", &params, "data", &[(log, "log")], None);
    let text = lab.page("large");
    // How long it takes is what `cargo bench -p dril-report` says.
    assert!(text.len() < 2_000_000, "{}", text.len());
}

#[test]
fn an_episode_that_was_drawn_is_a_line_over_its_map_six_images_and_a_link_to_the_video() {
    let mut lab = Lab::new("thesis");
    let row = |n: usize| {
        let angle = n as f64 * 0.02;
        format!(
            "{n},0,2000001,{n},1,{},0.1,0,,,,{},{},{angle},{}\n",
            n,
            90.0 * angle.cos(),
            60.0 * angle.sin(),
            n % 70
        )
    };
    let header =
        "step,episode,seed,episode_step,reward,score,action_0,action_1,cost,limit,signal,x,y,angle,speed\n";
    let steps = format!("{header}{}", (0..300).map(row).collect::<String>());
    let side = |name: &str, size: f64| -> String {
        let point = |n: usize| (n % 40) as f64 * std::f64::consts::TAU / 40.0;
        (0..=40)
            .map(|n| format!("{name},{},{}\n", size * 90.0 * point(n).cos(), size * 60.0 * point(n).sin()))
            .collect()
    };
    let map = format!("line,x,y\n{}{}", side("left", 0.9), side("right", 1.1));
    lab.stage(
        "laps",
        "trace",
        &[],
        &[
            ("steps", Artifact::TRAINING_LOG, "csv", steps.as_bytes()),
            ("map", Artifact::FILE, "csv", map.as_bytes()),
            ("strip", Artifact::FIGURE, "png", ONE_PIXEL),
            ("video", Artifact::FIGURE, "gif", b"GIF89a"),
        ],
    );
    let text = lab.page("replay");
    for part in [
        "id=\"replays\"",
        "Seed 2000001: score 299.0 after 300 steps",
        "The driven line on the map",
        "src=\"data:image/png;base64,",
        "href=\"./laps.gif\"",
    ] {
        assert!(text.contains(part), "{part}");
    }
    assert!(
        !text.contains("id=\"figures\"") && !text.contains("id=\"curves\""),
        "what a replay shows is shown once"
    );
}

/// A PNG image of one black pixel.
const ONE_PIXEL: &[u8] = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x01\0\0\0\x01\x08\0\0\0\0:~\x9bU\0\0\0\nIDATx\x9cc`\0\0\0\x02\0\x01H\xaf\xa4q\0\0\0\0IEND\xaeB`\x82";

#[test]
fn two_runs_are_compared_by_changes_scores_and_curves() {
    let run = |mean: f64, rate: f64, extra: &str| {
        let mut lab = Lab::new("thesis");
        for (policy, mean) in [("gaussian", 100.0), ("beta", mean)] {
            let labels = [("policy", policy)];
            let bytes = scores(mean, 50.0, 3, 40);
            lab.stage("evaluate", "evaluate", &labels, &[("scores", Artifact::SCORES, "csv", &bytes)]);
            let at = lab.stage(
                "train",
                "ppo",
                &labels,
                &[("log", Artifact::TRAINING_LOG, "csv", &losses(mean as usize))],
            );
            lab.outcome.stages[at].params = json!({ "update": { "learning_rate": rate } });
        }
        lab.stage(extra, "evaluate", &[], &[]);
        // Equal contents have equal names, as in a store.
        for output in lab.outcome.stages.iter_mut().flat_map(|stage| &mut stage.outputs) {
            output.digest = format!(
                "{:?}",
                std::fs::read(&output.path).unwrap().iter().map(|b| u64::from(*b)).sum::<u64>()
            );
        }
        for stage in &mut lab.outcome.stages {
            stage.key = Some(format!("{} {mean} {rate}", stage.id));
        }
        lab
    };
    let (ours, theirs) = (run(200.0, 1e-3, "new"), run(150.0, 1e-4, "old"));
    let text = page(&ours.outcome, Some(("20261125-1", &theirs.outcome))).unwrap();
    for part in [
        "id=\"compared\"",
        "<code>20261125-1</code>",
        "update.learning_rate",
        "0.001",
        "0.0001",
        "+50.0 ± 0.0",
        "equal to the bit",
        "Only in A",
        "<code>old</code>",
        "<code>train.log</code>",
        // One colour for each run: curves lie over each other, and nothing is averaged.
        "side:",
    ] {
        assert!(text.contains(part), "{part}");
    }
    assert!(!text.contains("mean over 2 values"), "two runs are not repetitions");
    let same = page(&ours.outcome, Some(("itself", &ours.outcome))).unwrap();
    assert!(same.contains("0 of 2 evaluations differ") && same.contains("are equal."));
}

#[test]
fn two_runs_are_compared_with_one_decimal_more_than_the_stages_that_read_the_scores() {
    let run = |score: f64| {
        let mut lab = Lab::new("default");
        let rows: String = (0..40).map(|n| format!("{n},{n},{score},100,finished,\n")).collect();
        let text = format!("episode,seed,score,steps,outcome,diverged_at_step\n{rows}");
        let output = [("scores", Artifact::SCORES, "csv", text.as_bytes())];
        let all = [(lab.stage("evaluate", "evaluate", &[("rate", "1")], &output), "scores")];
        let with = json!({ "title": "T", "profile": "default", "keys": ["rate"], "decimals": 2 });
        lab.run::<Table>("table", "table", &with, "scores", &all, None);
        lab
    };
    let (ours, mut theirs) = (run(0.875), run(0.5));
    for stage in &mut theirs.outcome.stages {
        stage.key = None;
        stage.outputs.iter_mut().for_each(|output| output.digest.push('b'));
    }
    let text = page(&ours.outcome, Some(("other", &theirs.outcome))).unwrap();
    for part in [">0.875<", ">0.500<", "+0.375 ± 0.000"] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn findings_between_0_and_1_are_shown_with_their_decimals() {
    let mut lab = Lab::new("full");
    let mut all = Vec::new();
    for (method, score) in [("a", 0.5), ("b", 0.875)] {
        let rows: String = (0..40).map(|n| format!("{n},{n},{score},100,finished,\n")).collect();
        let text = format!("episode,seed,score,steps,outcome,diverged_at_step\n{rows}");
        let output = [("scores", Artifact::SCORES, "csv", text.as_bytes())];
        all.push((lab.stage("evaluate", "evaluate", &[("method", method)], &output), "scores"));
    }
    let claim = json!({ "claim": "b beats a", "is": "greater", "left": { "method": "b" }, "right": { "method": "a" } });
    let with = json!({ "title": "T", "profile": "full", "claims": [claim], "decimals": 2 });
    lab.run::<Findings>("findings", "findings", &with, "scores", &all, None);
    let text = lab.page("decimals-of-findings");
    assert!(text.contains("0.38 ± 0.00"), "{text}");
    // The bar uses the whole width: its scale is that of the differences, and not of points.
    assert!(text.contains("cx=\"174.0\""), "{text}");
}

#[test]
fn stages_are_compared_by_their_keys_whatever_they_are_called() {
    let run = |stages: &[(&str, &str)]| {
        let mut lab = Lab::new("thesis");
        for (name, key) in stages {
            let output = ("scores", Artifact::SCORES, "csv", &*scores(100.0, 50.0, key.len(), 40));
            let at = lab.stage(name, "evaluate", &[], &[output]);
            (lab.outcome.stages[at].key, lab.outcome.stages[at].params) =
                (Some((*key).to_owned()), json!({ "key": key }));
            lab.outcome.stages[at].outputs[0].digest = (*key).to_owned();
        }
        lab
    };
    let compared = |ours: &[(&str, &str)], theirs: &[(&str, &str)]| {
        let text = page(&run(ours).outcome, Some(("other", &run(theirs).outcome))).unwrap();
        text.split("id=\"compared\"").nth(1).unwrap().split("</section>").next().unwrap().to_owned()
    };
    let renamed = compared(&[("first", "k"), ("second", "k")], &[("premier", "k"), ("second", "k")]);
    assert!(!renamed.contains("Only in"), "{renamed}");
    assert!(
        renamed.contains("0 of 2 evaluations differ") && renamed.contains("Other names in B"),
        "{renamed}"
    );
    assert!(renamed.contains("<code>premier</code>"), "{renamed}");
    // Two stages of A have the key of one in B.
    let shared = compared(&[("first", "k"), ("second", "k")], &[("second", "k")]);
    assert!(!shared.contains("Only in") && shared.contains("0 of 2 evaluations differ"), "{shared}");
    let shared = compared(&[("second", "k")], &[("first", "k"), ("second", "k")]);
    assert!(!shared.contains("Only in") && !shared.contains("Other names"), "{shared}");
    // An equal key goes before an equal name, and a name decides where keys differ.
    let changed = compared(&[("first", "k"), ("second", "k")], &[("first", "k"), ("second", "kk")]);
    assert!(changed.contains("1 of 2 evaluations differ") && !changed.contains("Only in"), "{changed}");
    let moved = compared(&[("a", "k"), ("b", "kkk")], &[("a", "kk"), ("c", "k")]);
    assert!(moved.contains("Only in A") && moved.contains("Only in B"), "{moved}");
    assert!(moved.contains("0 of 1 evaluation"), "{moved}");
}

#[test]
fn a_cell_whose_training_diverged_is_marked() {
    let mut lab = Lab::new("thesis");
    let mut evaluations = Vec::new();
    for (method, diverged) in [("bc", ""), ("dril", "8192")] {
        let rows: String = (0..40).map(|n| format!("{n},{n},{},100,finished,{diverged}\n", 10 * n)).collect();
        let text = format!("episode,seed,score,steps,outcome,diverged_at_step\n{rows}");
        let output = [("scores", Artifact::SCORES, "csv", text.as_bytes())];
        evaluations.push((lab.stage("evaluate", "evaluate", &[("method", method)], &output), "scores"));
    }
    let with = json!({ "title": "T", "profile": "thesis", "keys": ["method"] });
    lab.run::<Table>("table", "table", &with, "scores", &evaluations, None);
    let claims =
        json!([{ "claim": "c", "is": "greater", "left": { "method": "dril" }, "right": { "method": "bc" } }]);
    let with = json!({ "title": "F", "profile": "thesis", "claims": claims });
    lab.run::<Findings>("findings", "findings", &with, "scores", &evaluations, None);
    let text = lab.page("diverged");
    let section = |anchor: &str| {
        let rest = text.split(&format!("id=\"{anchor}\"")).nth(1).unwrap();
        rest.split("</section>").next().unwrap().to_owned()
    };
    for anchor in ["results", "findings"] {
        let section = section(anchor);
        // One cell or claim, and the sentence that explains the mark.
        assert_eq!(section.matches('†').count(), 2, "{section}");
        assert!(section.contains("training diverged"), "{section}");
    }
    lab.outcome.stages.truncate(1);
    assert!(!lab.page("sound").contains('†'));
}

#[test]
fn a_table_of_scores_between_0_and_1_is_shown_with_its_decimals() {
    let mut lab = Lab::new("default");
    let mut evaluations = Vec::new();
    for (rate, score) in [("0.1", 0.125), ("0.01", 0.25)] {
        let rows: String = (0..40).map(|n| format!("{n},{n},{score},100,finished,\n")).collect();
        let text = format!("episode,seed,score,steps,outcome,diverged_at_step\n{rows}");
        let output = [("scores", Artifact::SCORES, "csv", text.as_bytes())];
        evaluations.push((lab.stage("evaluate", "evaluate", &[("rate", rate)], &output), "scores"));
    }
    let reference = lab.folder.path().join("published.csv");
    std::fs::write(&reference, "rate,mean,std\n0.1,0.1234567,0.5\n").unwrap();
    let with = json!({ "title": "T", "profile": "default", "keys": ["rate"], "decimals": 3 });
    lab.run::<Table>("table", "table", &with, "scores", &evaluations, Some(&reference));
    let text = lab.page("decimals");
    for part in ["0.125 ± 0.000", "0.250 ± 0.000", "0.1234567 ± 0.5"] {
        assert!(text.contains(part), "{part}: {text}");
    }
}
