//! The ensemble's network: for images one encoder that all members share, then a head of its own for each member; for
//! vectors fully separate members (thesis section 4.2.5 and the code it used).
//!
//! The members' heads are separate layers, one after the other. Five small matrix products take 7.5 ms of a training
//! step where torch's batched product over stacked weights takes 11 ms (one thread, 5 × 20 samples).

use std::path::Path;

use dril_kinds::Precision;
use dril_stage_api::{StageError, StreamRng};
use serde::{Deserialize, Serialize};
use tch::Tensor;

use crate::fast::memory;
use crate::net::{
    Activation, Builder, ByParameter, Gradients, LayerInit, Observation, ParamId, Parameters, Pass,
    Sequential, weights,
};
use crate::spaces::Actions;

/// Width of all fully connected layers.
const HIDDEN: usize = 512;

/// All that determines the layout of an ensemble's parameters; stands in the metadata of its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Architecture {
    /// The input.
    pub observation: Observation,
    /// How many action dimensions there are, or choices.
    pub actions: usize,
    /// How many members there are.
    pub members: usize,
    /// True where members answer with the logits of choices; left out of the file where not.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub choices: bool,
}

impl Architecture {
    /// Of an ensemble for these observations and actions.
    pub fn new(observation: Observation, actions: Actions, members: usize) -> Self {
        let choices = matches!(actions, Actions::Choices(_));
        Self { observation, actions: actions.count(), members, choices }
    }

    /// What its answers are about.
    pub fn kind(&self) -> Actions {
        if self.choices { Actions::Choices(self.actions) } else { Actions::Numbers(self.actions) }
    }
}

/// What each member answered to its slice of a batch.
#[derive(Debug)]
pub struct Slices {
    /// The answers in the order of the batch, [batch, actions], not clipped.
    pub answers: Tensor,
    /// The ways through encoder and heads; none where libtorch's graph reaches down to the weights.
    passes: Option<(Pass, Vec<Pass>)>,
}

/// Several policies that answer with an action each; how far they are apart is DRIL's cost.
#[derive(Debug)]
pub struct Ensemble {
    architecture: Architecture,
    encoder: Sequential,
    heads: Vec<Sequential>,
    /// The weights of encoder and heads.
    pub params: Parameters,
}

impl Ensemble {
    /// A new ensemble with weights drawn from the stream (PyTorch's default distribution).
    ///
    /// # Errors
    /// Fewer than two members (their covariance would not exist), no action, or frames that the convolutions cannot
    /// take.
    pub fn new(architecture: Architecture, stream: &mut StreamRng) -> Result<Self, StageError> {
        Self::build(architecture, Some(stream))
    }

    /// With weights from the stream, or zeros.
    fn build(architecture: Architecture, stream: Option<&mut StreamRng>) -> Result<Self, StageError> {
        check(architecture)?;
        let init = LayerInit::Default;
        let mut build = Builder::new();
        let (encoder, features) = match architecture.observation {
            Observation::Images { height, width, stack } => {
                let (mut encoder, pixels) =
                    build.convolutions("conv", (stack, height, width), [32, 64, 64], init);
                build.linear(&mut encoder, "shared", (pixels, HIDDEN), init, Activation::Relu);
                (encoder, HIDDEN)
            }
            Observation::Vector { len } => (Sequential::default(), len),
        };
        let heads = (0..architecture.members).map(|member| {
            let mut head = Sequential::default();
            let mut layer = |layer: usize, shape, activation| {
                build.linear(&mut head, &format!("member.{member}.{layer}"), shape, init, activation);
            };
            layer(0, (features, HIDDEN), Activation::Relu);
            layer(1, (HIDDEN, HIDDEN), Activation::Relu);
            layer(2, (HIDDEN, architecture.actions), Activation::Linear);
            head
        });
        let heads = heads.collect();
        let params = match stream {
            Some(stream) => build.finish(stream),
            None => build.finish_blank(),
        };
        Ok(Self { architecture, encoder, heads, params })
    }

    /// What determines the layout of its parameters.
    pub fn architecture(&self) -> Architecture {
        self.architecture
    }

    /// What every member answers to every observation: [members, batch, actions], not clipped. The encoder runs once.
    pub fn forward(&self, observations: &Tensor) -> Tensor {
        let features = self.layers(&self.encoder, observations);
        let answers: Vec<Tensor> = self.heads.iter().map(|head| self.layers(head, &features)).collect();
        Tensor::stack(&answers, 0)
    }

    fn layers(&self, layers: &Sequential, input: &Tensor) -> Tensor {
        match self.params.precision() {
            Precision::Fp32 => layers.pass(&self.params, input).output().shallow_clone(),
            Precision::Bf16 => layers.torch_forward(&self.params, input),
        }
    }

    /// What each member answers to its own slice of the batch, whose length is a multiple of the members: member k sees
    /// the k-th of as many consecutive slices.
    pub fn forward_slices(&self, observations: &Tensor) -> Slices {
        if self.params.precision() == Precision::Bf16 {
            let features = self.encoder.torch_forward(&self.params, observations);
            let slices = features.chunk(self.heads.len() as i64, 0);
            let heads = self.heads.iter().zip(&slices);
            let answers: Vec<Tensor> =
                heads.map(|(head, slice)| head.torch_forward(&self.params, slice)).collect();
            return Slices { answers: Tensor::cat(&answers, 0), passes: None };
        }
        let encoder = self.encoder.pass(&self.params, observations);
        let slices = encoder.output().chunk(self.heads.len() as i64, 0);
        let heads = self.heads.iter().zip(&slices);
        let heads: Vec<Pass> = heads.map(|(head, slice)| head.pass(&self.params, slice)).collect();
        let outputs: Vec<&Tensor> = heads.iter().map(Pass::output).collect();
        let answers = Tensor::cat(&outputs, 0).set_requires_grad(true);
        Slices { answers, passes: Some((encoder, heads)) }
    }

    /// The gradients of a scalar that was made of the answers to slices, for the parameters asked for, in that order.
    pub fn gradients(&self, slices: Slices, loss: &Tensor, ids: &[ParamId]) -> Gradients {
        let Some((encoder, heads)) = slices.passes else {
            return self.params.torch_gradients(loss, ids);
        };
        let mut gradients = ByParameter::new(&self.params);
        let arrived = Tensor::run_backward(&[loss], &[&slices.answers], false, false);
        let wants = !self.encoder.is_empty();
        let mut back = Vec::new();
        for gradient in arrived.iter().filter(|gradient| gradient.defined()) {
            let parts = gradient.chunk(self.heads.len() as i64, 0);
            for ((head, pass), part) in self.heads.iter().zip(&heads).zip(parts) {
                // Copied, since the way back writes to it.
                let part = part.contiguous().copy();
                back.extend(head.back(&self.params, pass, part, &mut gradients, wants));
            }
        }
        if !back.is_empty() {
            self.encoder.back(&self.params, &encoder, Tensor::cat(&back, 0), &mut gradients, false);
        }
        gradients.pick(ids)
    }

    /// [`Ensemble::forward`] without a graph, as plain numbers `[member][sample][dimension]`.
    pub fn answers(&self, observations: &Tensor) -> Vec<f32> {
        let answers = tch::no_grad(|| self.forward(observations)).contiguous();
        memory::values(&answers).to_vec()
    }
}

fn check(architecture: Architecture) -> Result<(), StageError> {
    let Architecture { observation, actions, members, .. } = architecture;
    if members < 2 {
        return Err(StageError::failed(format!(
            "an ensemble of {members} has no covariance, expected at least 2 members"
        )));
    }
    if actions == 0 {
        return Err(StageError::failed("the actions have no dimension, expected at least one"));
    }
    match observation {
        Observation::Images { height, width, stack }
            if height < 36 || width < 36 || height % 4 != 0 || width % 4 != 0 || stack == 0 =>
        {
            Err(StageError::failed(format!(
                "frames are {height}x{width} in stacks of {stack}, expected multiples of 4 from 36 on and a stack"
            )))
        }
        _ => Ok(()),
    }
}

/// What stands in the file's metadata.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct About {
    /// Tells ensembles from policies, and this layout from later ones.
    format: String,
    ensemble: Architecture,
}

const FORMAT: &str = "ensemble-v1";

impl Ensemble {
    /// The bytes of its file.
    ///
    /// # Errors
    /// None that is known of.
    pub fn to_bytes(&self) -> Result<Vec<u8>, StageError> {
        let about = About { format: FORMAT.to_owned(), ensemble: self.architecture };
        weights::to_bytes(&about, &self.params)
    }

    /// Reads the ensemble at the input `port`.
    ///
    /// # Errors
    /// The file cannot be read or holds no ensemble; the message says what was seen and expected.
    pub fn load(port: &str, path: &Path) -> Result<Self, StageError> {
        let file = weights::read(port, path)?;
        let about: About = file.about(port, path)?;
        if about.format != FORMAT {
            let message = format!("has the format `{}`, expected `{FORMAT}`", about.format);
            return Err(StageError::input(port, path, message));
        }
        let mut ensemble = Self::build(about.ensemble, None)?;
        file.fill(port, path, &mut ensemble.params)?;
        Ok(ensemble)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_stage_api::Seed;
    use tch::{Device, Kind};

    const VECTORS: Architecture =
        Architecture { observation: Observation::Vector { len: 3 }, actions: 2, members: 4, choices: false };
    const IMAGES: Architecture = Architecture {
        observation: Observation::Images { height: 36, width: 36, stack: 2 },
        actions: 2,
        members: 3,
        choices: false,
    };

    fn new(architecture: Architecture) -> Ensemble {
        crate::fast::prepare();
        Ensemble::new(architecture, &mut Seed(1).stream("init")).unwrap()
    }

    fn numbers(shape: &[i64]) -> Tensor {
        let count = shape.iter().product::<i64>();
        (Tensor::arange(count, (Kind::Float, Device::Cpu)) * 0.37).sin().view(shape)
    }

    #[test]
    fn each_member_answers_to_its_slice_as_it_answers_to_all() {
        let ensemble = new(VECTORS);
        let batch = numbers(&[8, 3]);
        let (all, slices) = (ensemble.forward(&batch), ensemble.forward_slices(&batch).answers);
        assert_eq!((all.size(), slices.size()), (vec![4, 8, 2], vec![8, 2]));
        for row in 0..8 {
            let apart: f64 = (all.get(row / 2).get(row) - slices.get(row)).abs().max().double_value(&[]);
            assert!(apart < 1e-5, "row {row} is off by {apart}");
        }
    }

    #[test]
    fn members_begin_apart_and_share_the_encoder_for_images() {
        let ensemble = new(IMAGES);
        let answers = ensemble.forward(&numbers(&[1, 9, 9, 32]));
        assert_eq!(answers.size(), [3, 1, 2]);
        assert!((answers.get(0) - answers.get(1)).abs().max().double_value(&[]) > 1e-4);
        let names: Vec<&str> =
            ensemble.params.ids().map(|id| ensemble.params.spec(id).name.as_str()).collect();
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
        assert_eq!(read.params.values(), ensemble.params.values());
        let other = weights::to_bytes(&"policy", &ensemble.params).unwrap();
        std::fs::write(&path, other).unwrap();
        let message = Ensemble::load("ensemble", &path).unwrap_err().to_string();
        assert!(message.contains("other weights than expected"), "{message}");
    }

    #[test]
    fn one_member_is_refused_with_the_reason() {
        let lone = Architecture { members: 1, ..VECTORS };
        let message = Ensemble::new(lone, &mut Seed(1).stream("init")).unwrap_err().to_string();
        assert!(message.contains("at least 2 members"), "{message}");
    }
}
