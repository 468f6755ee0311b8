//! The learning kinds as the engine plans with them: parameters, ports and resource needs, without libtorch.
//!
//! Each module describes one kind; `dril-learn` runs them. Defaults are literal values; the pipelines state those of the
//! thesis's experiments. Where the thesis's text and its code differ, the field's documentation states how.

pub mod artifacts;
mod bc;
mod choices;
mod collect;
mod columns;
mod dataset;
mod default;
mod dril;
mod ensemble;
mod evaluate;
mod on_policy;
mod ppo;
mod probe;
mod replay;
mod trace;
mod update;

pub use bc::{Bc, BcParams, Split, Validation};
pub use choices::{Algorithm, Device, Mode, Network, OnDivergence, PolicyFamily};
pub use collect::{Collect, CollectParams};
pub use columns::{DRIL_COLUMNS, EPISODE_COLUMNS, EPOCH_COLUMNS, UPDATE_COLUMNS};
pub use dataset::{ActionRange, Dataset, DatasetParams};
pub use dril::{Dril, DrilParams, RewardScheme, Thresholds};
pub use ensemble::{Bootstrap, Ensemble, EnsembleParams};
pub use evaluate::{Counted, Evaluate, EvaluateParams};
pub use on_policy::OnPolicyParams;
pub use ppo::{Ppo, PpoParams};
pub use probe::{Probe, ProbeParams};
pub use replay::REPLAY;
pub use trace::{Trace, TraceParams};
pub use update::UpdateParams;

use dril_stage_api::Kind;

/// The executable that runs these kinds; it is installed in the same folder as `dril-pipe`.
pub const WORKER: &str = "dril-pipe-learn";

/// All learning kinds, for planning. A new kind is registered here and in `dril_learn::KINDS`.
pub const KINDS: [Kind; 9] = [
    Kind::run_by::<Ppo>(WORKER),
    Kind::run_by::<Evaluate>(WORKER),
    Kind::run_by::<Collect>(WORKER),
    Kind::run_by::<Dataset>(WORKER),
    Kind::run_by::<Bc>(WORKER),
    Kind::run_by::<Ensemble>(WORKER),
    Kind::run_by::<Dril>(WORKER),
    Kind::run_by::<Trace>(WORKER),
    Kind::run_by::<Probe>(WORKER),
];

#[cfg(test)]
mod tests;
