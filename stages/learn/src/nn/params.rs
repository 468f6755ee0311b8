//! The parameters of a network: named blocks of one flat buffer, so that saving, restoring and the optimizer work on plain
//! slices. Gradients are in a buffer of the same layout.

use std::cell::{Cell, Ref, RefCell};

use dril_stage_api::StreamRng;

use super::Init;
use crate::kernels::Buffer;

/// Index of a parameter in its [`Parameters`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ParamId(pub(crate) usize);

/// A parameter's name, shape and initial values.
#[derive(Clone, Debug, PartialEq)]
pub struct ParamSpec {
    /// Its name in the weights file, such as `actor.0.weight`.
    pub name: String,
    /// Its dimensions.
    pub shape: Vec<usize>,
    /// Distribution of its initial values.
    pub init: Init,
}

impl ParamSpec {
    /// Number of values.
    pub fn count(&self) -> usize {
        self.shape.iter().product()
    }
}

/// The parameters of a network.
#[derive(Debug)]
pub struct Parameters {
    specs: Vec<ParamSpec>,
    offsets: Vec<usize>,
    flat: Buffer,
    /// Number of changes.
    generation: Cell<u64>,
    /// For each parameter, its weights packed for the forward and for the backward kernels.
    panels: [Vec<RefCell<Panels>>; 2],
}

/// The weights of a layer in a kernel's layout, packed when needed after a change.
#[derive(Debug, Default)]
struct Panels {
    numbers: Buffer,
    /// The generation of the values that were packed; none before the first use.
    generation: Option<u64>,
}

impl Parameters {
    /// Draws the initial values from the stream, in the order of the list; zeros if there is no stream, to be replaced
    /// by [`super::weights::Weights::fill`].
    pub fn new(specs: Vec<ParamSpec>, stream: Option<&mut StreamRng>) -> Self {
        let mut offsets = Vec::with_capacity(specs.len() + 1);
        let mut total = 0;
        for spec in &specs {
            offsets.push(total);
            total += spec.count();
        }
        offsets.push(total);
        let panels = [(); 2].map(|()| specs.iter().map(|_| RefCell::default()).collect());
        let mut params =
            Self { specs, offsets, flat: Buffer::zeros(total), generation: Cell::new(0), panels };
        if let Some(stream) = stream {
            for id in params.ids() {
                let spec = params.spec(id);
                let values = spec.init.draw(&spec.shape, stream);
                params.slice_mut(id).copy_from_slice(&values);
            }
        }
        params
    }

    /// Number of parameters (named blocks).
    pub fn len(&self) -> usize {
        self.specs.len()
    }

    /// True if there is none.
    pub fn is_empty(&self) -> bool {
        self.specs.is_empty()
    }

    /// All parameters, in order.
    pub fn ids(&self) -> impl Iterator<Item = ParamId> + use<> {
        (0..self.specs.len()).map(ParamId)
    }

    /// Name, shape and initial values of a parameter.
    pub fn spec(&self, id: ParamId) -> &ParamSpec {
        &self.specs[id.0]
    }

    /// A number that changes whenever values change.
    pub(super) fn generation(&self) -> u64 {
        self.generation.get()
    }

    fn changed(&self) {
        self.generation.set(self.generation.get() + 1);
    }

    /// The values of one parameter, packed for a forward kernel: `len` numbers that `pack` computes from the values, cached
    /// until these change.
    pub(super) fn panels(
        &self,
        id: ParamId,
        len: usize,
        pack: impl FnOnce(&[f32], &mut [f32]),
    ) -> Ref<'_, [f32]> {
        self.packed(&self.panels[0][id.0], id, len, pack)
    }

    /// The same for the backward pass.
    pub(super) fn transposed_panels(
        &self,
        id: ParamId,
        len: usize,
        pack: impl FnOnce(&[f32], &mut [f32]),
    ) -> Ref<'_, [f32]> {
        self.packed(&self.panels[1][id.0], id, len, pack)
    }

    fn packed<'a>(
        &self,
        kept: &'a RefCell<Panels>,
        id: ParamId,
        len: usize,
        pack: impl FnOnce(&[f32], &mut [f32]),
    ) -> Ref<'a, [f32]> {
        let now = Some(self.generation());
        if kept.borrow().generation != now {
            let mut panels = kept.borrow_mut();
            if panels.numbers.len() != len {
                panels.numbers = Buffer::zeros(len);
            }
            pack(self.slice(id), &mut panels.numbers);
            panels.generation = now;
        }
        Ref::map(kept.borrow(), |panels| &*panels.numbers)
    }

    /// The values of one parameter, row-major.
    pub fn slice(&self, id: ParamId) -> &[f32] {
        &self.flat[self.offsets[id.0]..self.offsets[id.0 + 1]]
    }

    /// The values of one parameter, mutable.
    pub fn slice_mut(&mut self, id: ParamId) -> &mut [f32] {
        self.changed();
        &mut self.flat[self.offsets[id.0]..self.offsets[id.0 + 1]]
    }

    /// All values, one parameter after the other.
    pub fn values(&self) -> &[f32] {
        &self.flat
    }

    /// Replaces all values; the slice is as long as [`Parameters::values`].
    pub fn set_values(&mut self, values: &[f32]) {
        self.changed();
        self.flat.copy_from_slice(values);
    }
}

/// The gradients of a loss, in the layout of the parameters. A parameter that the loss does not depend on has no gradient.
#[derive(Debug)]
pub struct Gradients {
    offsets: Vec<usize>,
    flat: Buffer,
    present: Vec<bool>,
}

impl Gradients {
    /// A buffer for the gradients of these parameters, initially without gradients.
    pub fn new(params: &Parameters) -> Self {
        Self {
            offsets: params.offsets.clone(),
            flat: Buffer::zeros(params.flat.len()),
            present: vec![false; params.len()],
        }
    }

    /// Clears all gradients and keeps the memory.
    pub fn clear(&mut self) {
        self.present.fill(false);
    }

    /// The gradient of a parameter, row-major; `None` if the loss does not depend on it.
    pub fn get(&self, id: ParamId) -> Option<&[f32]> {
        self.present[id.0].then(|| &self.flat[self.offsets[id.0]..self.offsets[id.0 + 1]])
    }

    /// The buffer for a gradient, to be overwritten.
    pub fn set(&mut self, id: ParamId) -> &mut [f32] {
        self.present[id.0] = true;
        &mut self.flat[self.offsets[id.0]..self.offsets[id.0 + 1]]
    }
}
