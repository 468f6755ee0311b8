//! A network with its parameters and the backend that computes it: the interface between algorithms and hardware.

use dril_kinds::Device;
use dril_stage_api::StageError;

use super::graph::{Graph, Wanted};
use super::torch::{self, Torch};
use super::{Batch, Gradients, Parameters, native};

/// A network.
#[derive(Debug)]
pub struct Network {
    graph: Graph,
    /// The weights.
    pub params: Parameters,
    backend: Backend,
}

/// The backend that computes a network.
#[derive(Debug)]
enum Backend {
    /// The kernels of this crate, on the CPU. Its bits are the same on every x86-64 processor with AVX2 and FMA.
    Native(native::Pool),
    /// libtorch.
    Torch(Torch),
}

/// The data of a forward pass that the backward pass needs.
#[derive(Debug)]
pub struct Tape(Kind);

#[derive(Debug)]
enum Kind {
    Native(native::Tape),
    Torch(torch::Tape),
}

impl Network {
    /// A network on the CPU.
    pub fn new((graph, params): (Graph, Parameters)) -> Self {
        Self { graph, params, backend: Backend::Native(native::Pool::default()) }
    }

    /// Selects the device.
    ///
    /// # Errors
    /// The device is a GPU, and libtorch finds none.
    pub fn set_device(&mut self, device: Device) -> Result<(), StageError> {
        self.backend = match device {
            Device::Cpu => Backend::Native(native::Pool::default()),
            Device::Cuda if tch::Cuda::is_available() => Backend::Torch(Torch::new(tch::Device::Cuda(0))),
            Device::Cuda => {
                return Err(StageError::failed(
                    "`device` is `cuda`, but libtorch finds no GPU here: build with a libtorch that has CUDA (see README, \
                     \"Another libtorch, and GPUs\") on a machine with one, or set `device` to `cpu`",
                ));
            }
        };
        Ok(())
    }

    /// Selects libtorch on the CPU, which the native backend is tested against.
    #[cfg(test)]
    pub(crate) fn use_torch(&mut self, device: tch::Device) {
        self.backend = Backend::Torch(Torch::new(device));
    }

    /// The requested outputs, in that order, each [rows, outputs], and the tape for the backward pass.
    pub fn forward(&self, batch: &Batch, wanted: &[Wanted]) -> (Vec<Vec<f32>>, Tape) {
        match &self.backend {
            Backend::Native(pool) => {
                let (outputs, tape) = native::forward(&self.graph, &self.params, pool, batch, wanted);
                (outputs, Tape(Kind::Native(tape)))
            }
            Backend::Torch(torch) => {
                let (outputs, tape) = torch.forward(&self.graph, &self.params, batch, wanted);
                (outputs, Tape(Kind::Torch(tape)))
            }
        }
    }

    /// The outputs only.
    pub fn infer(&self, batch: &Batch, wanted: &[Wanted]) -> Vec<Vec<f32>> {
        match &self.backend {
            Backend::Native(pool) => {
                let (outputs, tape) = native::forward(&self.graph, &self.params, pool, batch, wanted);
                pool.recycle(tape);
                outputs
            }
            Backend::Torch(torch) => {
                tch::no_grad(|| torch.forward(&self.graph, &self.params, batch, wanted).0)
            }
        }
    }

    /// Writes the gradients of the parameters, given those of outputs (each as long as the output was) after a forward
    /// pass of the same batch. Gradients of parameters that no given output depends on stay as they are.
    pub fn backward(
        &self,
        batch: &Batch,
        tape: Tape,
        arrived: Vec<(Wanted, Vec<f32>)>,
        gradients: &mut Gradients,
    ) {
        match (&self.backend, tape.0) {
            (Backend::Native(pool), Kind::Native(tape)) => {
                native::backward(&self.graph, &self.params, pool, (batch, tape), arrived, gradients);
            }
            (Backend::Torch(torch), Kind::Torch(tape)) => {
                torch.backward(&self.params, &tape, arrived, gradients);
            }
            // A tape of another backend: nothing of this network was computed with it.
            _ => {}
        }
    }
}
