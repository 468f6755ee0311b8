//! The two lists of learning kinds, that of the engine and that of the worker, name the same kinds.

use dril_stage_api::Kind;

fn names(kinds: &[Kind]) -> Vec<(&'static str, u32)> {
    let mut names: Vec<_> = kinds.iter().map(|kind| (kind.name(), kind.revision())).collect();
    names.sort_unstable();
    names
}

#[test]
fn every_described_kind_has_a_worker_and_every_worker_a_description() {
    assert_eq!(names(&dril_kinds::KINDS), names(&dril_learn::KINDS));
    for kind in &dril_kinds::KINDS {
        assert_eq!(kind.worker(), Some(dril_kinds::WORKER), "{}", kind.name());
    }
    for kind in &dril_learn::KINDS {
        assert_eq!(kind.worker(), None, "{} runs in this process", kind.name());
    }
}
