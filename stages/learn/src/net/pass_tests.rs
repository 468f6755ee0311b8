//! The kernels' way there and back against libtorch's, and against itself at other widths.

use dril_stage_api::Seed;
use tch::{Device, Kind, Tensor};

use super::*;
use crate::net::{Builder, LayerInit};

/// Layers with their parameters, and a batch that they take.
struct Case {
    layers: Sequential,
    params: Parameters,
    input: Tensor,
}

fn numbers(shape: &[i64], factor: f64) -> Tensor {
    let count = shape.iter().product::<i64>();
    (Tensor::arange(count, (Kind::Float, Device::Cpu)) * factor).sin().view(shape)
}

fn pictures(batch: i64, side: usize, filters: [usize; 3]) -> Case {
    crate::fast::prepare();
    let mut build = Builder::new();
    let init = LayerInit::Default;
    let (mut layers, features) = build.convolutions("conv", (4, side, side), filters, init);
    build.linear(&mut layers, "hidden", (features, 50), init, Activation::Relu);
    build.linear(&mut layers, "out", (50, 2), init, Activation::Linear);
    let blocks = (side / 4) as i64;
    let input = (numbers(&[batch, blocks, blocks, 64], 0.37) * 127.0 + 127.0).to_kind(Kind::Uint8);
    Case { layers, params: build.finish(&mut Seed(1).stream("init")), input }
}

fn vectors(batch: i64, inputs: usize) -> Case {
    crate::fast::prepare();
    let mut build = Builder::new();
    let mut layers = Sequential::default();
    let init = LayerInit::Orthogonal(1.0);
    build.linear(&mut layers, "first", (inputs, 64), init, Activation::Tanh);
    build.linear(&mut layers, "second", (64, 37), init, Activation::Tanh);
    build.linear(&mut layers, "out", (37, 3), init, Activation::Linear);
    let params = build.finish(&mut Seed(2).stream("init"));
    Case { layers, params, input: numbers(&[batch, inputs as i64], 0.71) }
}

fn all() -> Vec<Case> {
    let mut cases = vec![pictures(7, 84, [32, 64, 32]), pictures(5, 36, [16, 32, 64])];
    cases.extend([(13, 8), (1, 16), (6, 35)].map(|(batch, inputs)| vectors(batch, inputs)));
    cases
}

/// The largest difference over the largest number.
fn apart(found: &Tensor, wanted: &Tensor) -> f64 {
    assert_eq!(found.size(), wanted.size());
    let largest = |tensor: Tensor| tensor.abs().max().double_value(&[]);
    largest(found - wanted) / largest(wanted.shallow_clone()).max(1e-6)
}

#[test]
fn outputs_and_all_gradients_are_those_of_libtorch() {
    for Case { layers, params, input } in all() {
        let ids: Vec<ParamId> = params.ids().collect();
        let wanted = layers.torch_forward(&params, &input);
        let pass = layers.pass(&params, &input);
        assert!(apart(pass.output(), &wanted) < 1e-5, "{:?}", input.size());
        let weights = numbers(&wanted.size(), 1.3);
        let wanted = params.torch_gradients(&(&wanted * &weights).sum(Kind::Float), &ids);
        let mut found = ByParameter::new(&params);
        assert!(layers.back(&params, &pass, weights.copy(), &mut found, false).is_none());
        for (id, (found, wanted)) in ids.iter().zip(found.pick(&ids).into_iter().zip(wanted)) {
            let (found, wanted) = (found.unwrap(), wanted.unwrap());
            assert!(apart(&found, &wanted) < 1e-5, "{} of {:?}", params.spec(*id).name, input.size());
        }
    }
}

#[test]
fn the_gradient_of_the_input_is_that_of_libtorch() {
    for Case { layers, params, input } in all() {
        let leaf = input.to_kind(Kind::Float).copy().set_requires_grad(true);
        let output = layers.torch_forward(&params, &leaf);
        let weights = numbers(&output.size(), 1.3);
        let loss = (&output * &weights).sum(Kind::Float);
        let wanted = Tensor::run_backward(&[&loss], &[&leaf], false, false).remove(0);
        let pass = layers.pass(&params, &input);
        let found =
            layers.back(&params, &pass, weights.copy(), &mut ByParameter::new(&params), true).unwrap();
        assert!(apart(&found, &wanted.contiguous()) < 1e-5, "{:?}", input.size());
    }
}

#[test]
fn a_row_comes_out_the_same_whatever_stands_beside_it() {
    for Case { layers, params, input } in all() {
        let all = layers.pass(&params, &input);
        for row in 0..input.size()[0] {
            let alone = layers.pass(&params, &input.narrow(0, row, 1).contiguous());
            assert_eq!(alone.output(), &all.output().narrow(0, row, 1));
        }
    }
}

#[test]
fn changed_weights_are_seen() {
    let Case { layers, mut params, input } = vectors(3, 8);
    let before = layers.pass(&params, &input).output().copy();
    params.set_values(&params.values().iter().map(|value| 2.0 * value).collect::<Vec<_>>());
    assert_ne!(layers.pass(&params, &input).output(), &before);
}
