//! The page about results: when it is written, what it receives, and whose files it leaves alone. What stands in it is
//! the business of the package that writes it; here a stand-in prints what it was handed.

use crate::cli::WORDS;
use crate::sealed::{Sealed, ended};

/// Runs the program with the stand-in.
fn run(sealed: &Sealed, args: &str) -> crate::sealed::Ended {
    let mut command = sealed.command(args);
    command.env("DRIL_FAKES_PAGE", "1");
    ended(command)
}

#[test]
fn a_run_ends_with_a_page_and_says_where() {
    let sealed = Sealed::with(WORDS);
    let first = run(&sealed, "run p.yaml");
    assert!(first.stdout.ends_with("report: results/words-full/report.html\n"), "{first:?}");
    let page = sealed.read("results/words-full/report.html");
    assert!(page.contains("words full of full, p.yaml"), "{page}");
    assert!(page.contains("count[word=two]: Done to=2 reads say[word=two].text"), "{page}");
    assert!(page.contains("gather: Done") && page.contains("file gather.md"), "{page}");
    // Neither who looks nor when is in it, so a second look writes the same.
    assert_eq!(run(&sealed, "report p.yaml --out again.html").code, 0);
    assert_eq!(sealed.read("again.html").replace(" file gather.md", ""), page.replace(" file gather.md", ""));
    let quick = run(&sealed, "report p.yaml --profile quick");
    assert_eq!(quick.stdout, "report: results/words-quick/report.html\n");
    let page = sealed.read("results/words-quick/report.html");
    assert!(
        page.contains("words quick of full, p.yaml --profile quick")
            && page.contains("count[word=one]: Stale"),
        "{page}"
    );
    assert!(page.contains("gather: Waiting"), "{page}");
}

#[test]
fn a_page_tells_of_what_failed_and_a_run_with_failures_has_one() {
    let pipeline = "name: p\nstages:\n  a:\n    kind: count\n    with: { mishap: fail, at: 2 }\n";
    let sealed = Sealed::with(pipeline);
    let failed = run(&sealed, "run p.yaml");
    assert_eq!(failed.code, 1, "{failed:?}");
    let page = sealed.read("results/p-default/report.html");
    assert!(page.contains("Failed(\"fails as configured at 2"), "{page}");
}

#[test]
fn a_failure_in_a_report_names_no_folder_of_this_machine() {
    let pipeline = "name: p\nstages:\n  say: { kind: emit, with: { text: x } }\n  a:\n    kind: count\n    \
                    with: { mishap: refuse }\n    inputs: { start: say }\n";
    let sealed = Sealed::with(pipeline);
    let elsewhere = tempfile::tempdir().unwrap();
    for cache in ["cache", elsewhere.path().to_str().unwrap()] {
        let failed = run(&sealed, &format!("run p.yaml --cache {cache}"));
        assert_eq!(failed.code, 1, "{failed:?}");
        let page = sealed.read("results/p-default/report.html");
        assert!(
            page.contains("input `start`, <cache>/blobs-v1/") && page.contains("set up to refuse …/it"),
            "{page}"
        );
        for folder in [sealed.path("").as_path(), elsewhere.path()] {
            assert!(!page.contains(folder.to_str().unwrap().trim_end_matches('/')), "{page}");
        }
    }
}

#[test]
fn a_report_of_another_program_is_left_alone() {
    let sealed = Sealed::with(WORDS);
    sealed.write("results/words-full/report.html", "mine");
    let done = run(&sealed, "run p.yaml");
    assert_eq!(done.code, 0);
    assert!(
        done.stderr.contains("warning: no report was written") && done.stderr.contains("--out"),
        "{done:?}"
    );
    let refused = run(&sealed, "report p.yaml");
    assert_eq!(refused.code, 4, "{refused:?}");
    assert_eq!(sealed.read("results/words-full/report.html"), "mine");
}

#[test]
fn a_program_without_the_package_that_writes_pages_says_so() {
    let sealed = Sealed::with(WORDS);
    let ended = sealed.run("report p.yaml");
    assert!(ended.code == 2 && ended.stderr.contains("built without the stage packages"), "{ended:?}");
}

#[test]
fn a_report_compares_with_an_earlier_run_or_with_an_archive() {
    let sealed = Sealed::with(WORDS);
    assert_eq!(run(&sealed, "run p.yaml").code, 0);
    assert_eq!(run(&sealed, "cache export last --out run.zip").code, 0);
    let of = |word: &str| {
        let done = run(&sealed, &format!("report p.yaml --against {word}"));
        assert_eq!(done.code, 0, "{done:?}");
        let page = sealed.read("results/words-full/report.html");
        let (_, other) = page.split_once("against ").unwrap();
        let (name, stages) = other.split_once('\n').unwrap();
        let mut stages: Vec<&str> = stages.lines().collect();
        stages.sort_unstable();
        (name.to_owned(), stages.join("\n"))
    };
    let (run_name, stages) = of("last");
    assert!(run_name.len() > 8, "{run_name}");
    assert!(stages.contains("count[word=two]: [(\"word\", \"two\")]"), "{stages}");
    let (archive, exported) = of("run.zip");
    assert_eq!((archive.as_str(), exported), ("run.zip", stages));
}

#[test]
fn an_archive_has_the_names_of_its_run_and_not_those_of_the_stages_that_ran_first() {
    let stages = |names: [&str; 2]| {
        let stage = |name| format!("  {name}: {{ kind: emit, with: {{ text: x }} }}\n");
        format!("name: p\nstages:\n{}", names.map(stage).concat())
    };
    let sealed = Sealed::with(&stages(["first", "second"]));
    assert_eq!(run(&sealed, "run p.yaml").code, 0);
    // Two stages with one key; then another name for one of them, which runs nothing.
    for (names, args) in [(["first", "second"], ""), (["premier", "second"], " --force second")] {
        sealed.write("p.yaml", &stages(names));
        assert_eq!(run(&sealed, &format!("run p.yaml{args}")).code, 0);
        assert_eq!(run(&sealed, "cache export last --out run.zip").code, 0);
        assert_eq!(run(&sealed, "report p.yaml --against run.zip").code, 0);
        let page = sealed.read("results/p-default/report.html");
        let (_, other) = page.split_once("against run.zip\n").unwrap();
        let expected = names.map(|name| format!("{name}: [] [1]\n")).concat();
        assert_eq!(other, expected);
    }
}

#[test]
fn a_report_against_a_run_that_is_not_there_says_how_to_find_one() {
    let sealed = Sealed::with(WORDS);
    assert_eq!(run(&sealed, "run p.yaml").code, 0);
    let ended = run(&sealed, "report p.yaml --against 1999");
    assert!(ended.code == 2 && ended.stderr.contains("dril-pipe runs"), "{ended:?}");
}
