//! The ensemble's network: for images, an encoder shared by all members and a separate head for each; for vectors, fully
//! separate members (thesis section 4.2.5 and its code).

use std::path::Path;

use dril_envs::{ActionSpace, ObservationSpace};
use dril_stage_api::{StageError, StreamRng};
use serde::{Deserialize, Serialize};

use crate::nn::{
    Activation, Batch, Builder, Gradients, LayerInit, Network, NodeId, Parameters, Sequential, Tape, Wanted,
    weights,
};
use crate::policy::{check_frames, file::ObservationV1};

/// Width of all fully connected layers.
const HIDDEN: usize = 512;

/// The architecture of an ensemble; determines the layout of its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EnsembleArchitecture {
    /// Observation space.
    pub observation: ObservationSpace,
    /// Action space: members output actions, or the logits of discrete actions.
    pub actions: ActionSpace,
    /// Number of members.
    pub members: usize,
}

/// Several policies, each of which outputs an action; their disagreement is DRIL's cost.
#[derive(Debug)]
pub struct Ensemble {
    architecture: EnsembleArchitecture,
    heads: Vec<NodeId>,
    network: Network,
}

impl Ensemble {
    /// A new ensemble with weights drawn from the stream (PyTorch's default distribution).
    ///
    /// # Errors
    /// Fewer than two members (no covariance), no action dimension, or frames of a size that the convolutions do not support.
    pub fn new(architecture: EnsembleArchitecture, stream: &mut StreamRng) -> Result<Self, StageError> {
        Self::build(architecture, Some(stream))
    }

    /// With weights from the stream, or zeros.
    fn build(architecture: EnsembleArchitecture, stream: Option<&mut StreamRng>) -> Result<Self, StageError> {
        check(architecture)?;
        let init = LayerInit::Default;
        let mut build = Builder::new();
        let (encoder, features) = match architecture.observation {
            ObservationSpace::Image { height, width, stack } => {
                let (mut encoder, pixels) =
                    build.convolutions("conv", (stack, height, width), [32, 64, 64], init);
                build.linear(&mut encoder, "shared", (pixels, HIDDEN), init, Activation::Relu);
                (Some(build.node(None, encoder)), HIDDEN)
            }
            ObservationSpace::Vector { len } => (None, len),
        };
        let heads = (0..architecture.members).map(|member| {
            let mut head = Sequential::default();
            let mut layer = |layer: usize, shape, activation| {
                build.linear(&mut head, &format!("member.{member}.{layer}"), shape, init, activation);
            };
            layer(0, (features, HIDDEN), Activation::Relu);
            layer(1, (HIDDEN, HIDDEN), Activation::Relu);
            layer(2, (HIDDEN, architecture.actions.outputs()), Activation::Linear);
            build.node(encoder, head)
        });
        let heads = heads.collect();
        Ok(Self { architecture, heads, network: Network::new(build.finish(stream)) })
    }

    /// The architecture.
    pub fn architecture(&self) -> EnsembleArchitecture {
        self.architecture
    }

    /// The weights of encoder and heads.
    pub fn params(&self) -> &Parameters {
        &self.network.params
    }

    /// The weights, mutable.
    pub fn params_mut(&mut self) -> &mut Parameters {
        &mut self.network.params
    }

    /// The network.
    pub fn network_mut(&mut self) -> &mut Network {
        &mut self.network
    }

    /// Outputs of all members for all observations, `[member][row][output]`, not clipped. The encoder runs once.
    pub fn answers(&self, observations: &Batch) -> Vec<f32> {
        let wanted = self.heads.iter().map(|node| Wanted { node: *node, rows: 0..observations.rows() });
        self.network.infer(observations, &wanted.collect::<Vec<_>>()).concat()
    }

    /// The output of each member for its own slice of the batch, [rows of the slice, outputs] each: member k gets the k-th
    /// of consecutive, equal slices. The batch size is a multiple of the number of members.
    pub(super) fn forward_slices(&self, observations: &Batch) -> (Vec<Vec<f32>>, Tape) {
        self.network.forward(observations, &self.slices(observations.rows()))
    }

    /// Writes the gradients of the parameters, given those of the outputs for the slices.
    pub(super) fn backward(
        &self,
        observations: &Batch,
        tape: Tape,
        by_slice: Vec<Vec<f32>>,
        gradients: &mut Gradients,
    ) {
        let arrived = self.slices(observations.rows()).into_iter().zip(by_slice).collect();
        self.network.backward(observations, tape, arrived, gradients);
    }

    fn slices(&self, rows: usize) -> Vec<Wanted> {
        let len = rows / self.heads.len();
        let slice = |(at, node): (usize, &NodeId)| Wanted { node: *node, rows: at * len..(at + 1) * len };
        self.heads.iter().enumerate().map(slice).collect()
    }
}

fn check(architecture: EnsembleArchitecture) -> Result<(), StageError> {
    let EnsembleArchitecture { observation, actions, members } = architecture;
    if members < 2 {
        return Err(StageError::failed(format!(
            "an ensemble of {members} members has no covariance, expected at least 2 members"
        )));
    }
    if actions.outputs() == 0 {
        return Err(StageError::failed("the action space has no dimension, expected at least one"));
    }
    check_frames(observation)
}

/// The metadata of the file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct About {
    /// Distinguishes ensembles from policies, and this layout from later ones.
    format: String,
    ensemble: EnsembleArchitectureV1,
}

/// An architecture as `ensemble-v1` stores it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct EnsembleArchitectureV1 {
    observation: ObservationV1,
    /// Action dimensions, or number of discrete actions.
    actions: usize,
    members: usize,
    /// True for discrete actions; left out if false.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    choices: bool,
}

impl From<EnsembleArchitecture> for EnsembleArchitectureV1 {
    fn from(architecture: EnsembleArchitecture) -> Self {
        let EnsembleArchitecture { observation, actions, members } = architecture;
        let choices = matches!(actions, ActionSpace::Discrete { .. });
        Self { observation: observation.into(), actions: actions.outputs(), members, choices }
    }
}

impl From<EnsembleArchitectureV1> for EnsembleArchitecture {
    fn from(stored: EnsembleArchitectureV1) -> Self {
        let EnsembleArchitectureV1 { observation, actions, members, choices } = stored;
        let actions = match choices {
            true => ActionSpace::Discrete { actions },
            false => ActionSpace::Continuous { dims: actions },
        };
        Self { observation: observation.into(), actions, members }
    }
}

const FORMAT: &str = "ensemble-v1";

impl Ensemble {
    /// The ensemble as a file.
    ///
    /// # Errors
    /// The metadata cannot be serialised.
    pub fn to_bytes(&self) -> Result<Vec<u8>, StageError> {
        let about = About { format: FORMAT.to_owned(), ensemble: self.architecture.into() };
        weights::to_bytes(&about, self.params())
    }

    /// Reads the ensemble at the input `port`.
    ///
    /// # Errors
    /// The file cannot be read, or is not an ensemble.
    pub fn load(port: &str, path: &Path) -> Result<Self, StageError> {
        let file = weights::read(port, path)?;
        let about: About = file.about(port, path)?;
        if about.format != FORMAT {
            let message = format!("has the format `{}`, expected `{FORMAT}`", about.format);
            return Err(StageError::input(port, path, message));
        }
        let mut ensemble = Self::build(about.ensemble.into(), None)?;
        file.fill(port, path, ensemble.params_mut())?;
        Ok(ensemble)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_stage_api::Seed;

    const ACTIONS: ActionSpace = ActionSpace::Continuous { dims: 2 };
    const VECTORS: EnsembleArchitecture = EnsembleArchitecture {
        observation: ObservationSpace::Vector { len: 3 },
        actions: ACTIONS,
        members: 4,
    };
    const IMAGES: EnsembleArchitecture = EnsembleArchitecture {
        observation: ObservationSpace::Image { height: 36, width: 36, stack: 2 },
        actions: ACTIONS,
        members: 3,
    };

    fn new(architecture: EnsembleArchitecture) -> Ensemble {
        Ensemble::new(architecture, &mut Seed(1).stream("init")).unwrap()
    }

    #[test]
    fn each_member_answers_to_its_slice_as_it_answers_to_all() {
        let ensemble = new(VECTORS);
        let numbers = (0..24).map(|at| (at as f32 * 0.37).sin()).collect();
        let batch = Batch::Vectors { rows: 8, numbers };
        let (all, (slices, _)) = (ensemble.answers(&batch), ensemble.forward_slices(&batch));
        assert_eq!((all.len(), slices.len()), (4 * 8 * 2, 4));
        for (member, slice) in slices.iter().enumerate() {
            assert_eq!(slice[..], all[member * 16 + member * 4..][..4]);
        }
    }

    #[test]
    fn members_begin_apart_and_share_the_encoder_for_images() {
        let ensemble = new(IMAGES);
        let bytes = (0..36 * 36 * 2).map(|at| (at % 251) as u8).collect();
        let answers = ensemble.answers(&Batch::Images { rows: 1, bytes });
        assert_eq!(answers.len(), 6);
        assert!((answers[0] - answers[2]).abs() > 1e-4);
        let params = ensemble.params();
        let names: Vec<&str> = params.ids().map(|id| params.spec(id).name.as_str()).collect();
        assert_eq!(names.iter().filter(|name| name.starts_with("conv.0")).count(), 2);
        assert_eq!(names.iter().filter(|name| name.starts_with("member.2")).count(), 6);
    }

    #[test]
    fn an_ensemble_survives_its_file_and_a_policy_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ensemble.safetensors");
        let ensemble = new(VECTORS);
        std::fs::write(&path, ensemble.to_bytes().unwrap()).unwrap();
        let read = Ensemble::load("ensemble", &path).unwrap();
        assert_eq!(read.architecture(), VECTORS);
        assert_eq!(read.params().values(), ensemble.params().values());
        let other = weights::to_bytes(&"policy", ensemble.params()).unwrap();
        std::fs::write(&path, other).unwrap();
        let message = Ensemble::load("ensemble", &path).unwrap_err().to_string();
        assert!(message.contains("other weights than expected"), "{message}");
    }

    #[test]
    fn one_member_is_refused_with_the_reason() {
        let lone = EnsembleArchitecture { members: 1, ..VECTORS };
        let message = Ensemble::new(lone, &mut Seed(1).stream("init")).unwrap_err().to_string();
        assert!(message.contains("at least 2 members"), "{message}");
    }
}
