//! The parameters of a network: named tensors that share one flat buffer.
//!
//! Each parameter is a leaf of autograd and at the same time a window on the flat buffer, so that saving, restoring and
//! the optimizer walk over plain slices, and gradients come out of [`Parameters::gradients`] without torch's
//! accumulation into `.grad`.
//!
//! With [`Precision::Bf16`] there is a second, shorter copy, which layers compute with; the flat buffer stays the one
//! that counts.

use std::cell::{Cell, Ref, RefCell};

use dril_kinds::Precision;
use dril_stage_api::StreamRng;
use tch::{Device, Kind, Tensor};

use super::Init;
use crate::fast::memory;

/// The position of a parameter in its [`Parameters`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ParamId(pub(crate) usize);

/// What a parameter is called, its shape and how it begins.
#[derive(Clone, Debug, PartialEq)]
pub struct ParamSpec {
    /// Its name in the weights file, as `actor.0.weight`.
    pub name: String,
    /// Its dimensions.
    pub shape: Vec<i64>,
    /// How it begins.
    pub init: Init,
    /// True where it may be rounded to 16 bits while the network learns (see [`Precision::Bf16`]).
    pub may_round: bool,
}

/// One gradient for each parameter asked for; `None` where the loss does not depend on it.
pub type Gradients = Vec<Option<Tensor>>;

/// The parameters of a network.
#[derive(Debug)]
pub struct Parameters {
    specs: Vec<ParamSpec>,
    offsets: Vec<usize>,
    flat: Tensor,
    tensors: Vec<Tensor>,
    /// None with 32 bits.
    short: Option<Short>,
    /// Counts changes of values.
    generation: Cell<u64>,
    /// For each parameter, its weights in the order of the kernels, and those the other way round.
    panels: [Vec<RefCell<Panels>>; 2],
}

/// The weights of a layer in the order of a kernel, made anew when they are needed after a change.
#[derive(Debug, Default)]
struct Panels {
    numbers: Vec<f32>,
    /// The generation that they are of; none before the first use.
    made: Option<u64>,
}

/// The copy in 16 bits.
#[derive(Debug)]
struct Short {
    flat: Tensor,
    /// Leaves of autograd over windows on `flat`; none for parameters that are not rounded.
    tensors: Vec<Option<Tensor>>,
    /// True where values have changed since the copy was made.
    stale: Cell<bool>,
}

impl Parameters {
    /// Makes the parameters and draws their first values from the stream, in the order of the list; without a stream
    /// they are zeros, to be replaced by [`super::weights::Weights::fill`].
    pub fn new(specs: Vec<ParamSpec>, stream: Option<&mut StreamRng>) -> Self {
        let mut offsets = Vec::with_capacity(specs.len() + 1);
        let mut total = 0;
        for spec in &specs {
            offsets.push(total);
            total += spec.shape.iter().product::<i64>() as usize;
        }
        offsets.push(total);
        let flat = Tensor::zeros([total as i64], (Kind::Float, Device::Cpu));
        let tensors = specs.iter().zip(&offsets).map(|(spec, &offset)| {
            let count = spec.shape.iter().product::<i64>();
            flat.narrow(0, offset as i64, count).view(&*spec.shape).detach().set_requires_grad(true)
        });
        let tensors = tensors.collect();
        let panels = [(); 2].map(|()| specs.iter().map(|_| RefCell::default()).collect());
        let generation = Cell::new(0);
        let mut params = Self { specs, offsets, flat, tensors, short: None, generation, panels };
        if let Some(stream) = stream {
            for id in params.ids() {
                let spec = params.spec(id);
                let values = spec.init.draw(&spec.shape, stream);
                params.slice_mut(id).copy_from_slice(&values);
            }
        }
        params
    }

    /// How many parameters (tensors) there are.
    pub fn len(&self) -> usize {
        self.specs.len()
    }

    /// True where there is none.
    pub fn is_empty(&self) -> bool {
        self.specs.is_empty()
    }

    /// All parameters, in order.
    pub fn ids(&self) -> impl Iterator<Item = ParamId> + use<> {
        (0..self.specs.len()).map(ParamId)
    }

    /// Name, shape and first values of a parameter.
    pub fn spec(&self, id: ParamId) -> &ParamSpec {
        &self.specs[id.0]
    }

    /// The parameter with 32 bits.
    pub fn tensor(&self, id: ParamId) -> &Tensor {
        &self.tensors[id.0]
    }

    /// The tensor to compute with: short where the precision says so and the parameter may be rounded.
    pub fn weight(&self, id: ParamId) -> &Tensor {
        let Some(short) = &self.short else { return self.tensor(id) };
        if short.stale.replace(false) {
            tch::no_grad(|| short.flat.shallow_clone().copy_(&self.flat));
        }
        short.tensors[id.0].as_ref().unwrap_or_else(|| self.tensor(id))
    }

    /// The numbers that layers compute with from now on.
    pub fn set_precision(&mut self, precision: Precision) {
        self.short = match precision {
            Precision::Fp32 => None,
            Precision::Bf16 => Some(self.shortened()),
        };
    }

    /// The numbers that layers compute with.
    pub fn precision(&self) -> Precision {
        if self.short.is_some() { Precision::Bf16 } else { Precision::Fp32 }
    }

    fn shortened(&self) -> Short {
        let flat = self.flat.to_kind(Kind::BFloat16);
        let window = |id: ParamId| {
            let (spec, offset) = (self.spec(id), self.offsets[id.0]);
            let count = spec.shape.iter().product::<i64>();
            let window = flat.narrow(0, offset as i64, count).view(&*spec.shape).detach();
            spec.may_round.then(|| window.set_requires_grad(true))
        };
        let tensors = self.ids().map(window).collect();
        Short { flat, tensors, stale: Cell::new(false) }
    }

    /// To be called after the values change.
    fn changed(&self) {
        self.generation.set(self.generation.get() + 1);
        if let Some(short) = &self.short {
            short.stale.set(true);
        }
    }

    /// The values of one parameter in another order: `len` numbers that `make` has filled from the values, kept until
    /// these change. A parameter has one such order.
    pub fn panels(&self, id: ParamId, len: usize, make: impl FnOnce(&[f32], &mut [f32])) -> Ref<'_, [f32]> {
        self.kept_panels(&self.panels[0][id.0], id, len, make)
    }

    /// As [`Parameters::panels`], with the order that the way back needs.
    pub fn transposed_panels(
        &self,
        id: ParamId,
        len: usize,
        make: impl FnOnce(&[f32], &mut [f32]),
    ) -> Ref<'_, [f32]> {
        self.kept_panels(&self.panels[1][id.0], id, len, make)
    }

    fn kept_panels<'a>(
        &self,
        kept: &'a RefCell<Panels>,
        id: ParamId,
        len: usize,
        make: impl FnOnce(&[f32], &mut [f32]),
    ) -> Ref<'a, [f32]> {
        let now = Some(self.generation.get());
        if kept.borrow().made != now {
            let mut panels = kept.borrow_mut();
            panels.numbers.resize(len, 0.0);
            make(self.slice(id), &mut panels.numbers);
            panels.made = now;
        }
        Ref::map(kept.borrow(), |panels| panels.numbers.as_slice())
    }

    /// The values of one parameter, row-major.
    pub fn slice(&self, id: ParamId) -> &[f32] {
        &memory::values(&self.flat)[self.offsets[id.0]..self.offsets[id.0 + 1]]
    }

    /// The values of one parameter, to be changed.
    pub fn slice_mut(&mut self, id: ParamId) -> &mut [f32] {
        self.changed();
        &mut memory::values_mut(&mut self.flat)[self.offsets[id.0]..self.offsets[id.0 + 1]]
    }

    /// All values, one parameter after the other.
    pub fn values(&self) -> &[f32] {
        memory::values(&self.flat)
    }

    /// Replaces all values; the slice is as long as [`Parameters::values`].
    pub fn set_values(&mut self, values: &[f32]) {
        self.changed();
        memory::values_mut(&mut self.flat).copy_from_slice(values);
    }

    /// The gradients of a scalar with respect to these parameters, by libtorch. The graph is used up.
    pub fn torch_gradients(&self, loss: &Tensor, ids: &[ParamId]) -> Gradients {
        let inputs: Vec<&Tensor> = ids.iter().map(|id| self.weight(*id)).collect();
        let gradients = Tensor::run_backward(&[loss], &inputs, false, false);
        let dense = |g: Tensor| g.defined().then(|| g.to_kind(Kind::Float).contiguous());
        gradients.into_iter().map(dense).collect()
    }
}
