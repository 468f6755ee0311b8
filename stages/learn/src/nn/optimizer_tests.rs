//! The optimizer against PyTorch's.

use dril_stage_api::Seed;
use tch::nn::OptimizerConfig;
use tch::{Device, Kind, Tensor, nn};

use super::*;
use crate::training::checkpoint::Arrays;

fn params(count: usize) -> Parameters {
    let spec = |name: &str, shape: &[usize]| ParamSpec {
        name: name.into(),
        shape: shape.to_vec(),
        init: Init::FanIn(1),
    };
    Parameters::new(vec![spec("a", &[count]), spec("b", &[3, 5])], Some(&mut Seed(1).stream("init")))
}

/// The gradients of [`loss`].
fn gradients(params: &Parameters) -> Gradients {
    let ids: Vec<ParamId> = params.ids().collect();
    let mut gradients = Gradients::new(params);
    let a: Vec<f32> = params.slice(ids[0]).iter().map(|a| 4.0 * (a - 0.3).powi(3)).collect();
    let b: Vec<f32> = params.slice(ids[1]).iter().map(|b| -100.0 * (b * 100.0).sin()).collect();
    gradients.set(ids[0]).copy_from_slice(&a);
    gradients.set(ids[1]).copy_from_slice(&b);
    gradients
}

/// A loss with gradients of very different sizes.
fn loss(a: &Tensor, b: &Tensor) -> Tensor {
    (a - 0.3).pow_tensor_scalar(4).sum(Kind::Float) + (b * 100.0).cos().sum(Kind::Float)
}

/// PyTorch's variables with the same values.
fn copies(params: &Parameters, store: &nn::VarStore) -> Vec<Tensor> {
    let copy = |id| {
        let shape: Vec<i64> = params.spec(id).shape.iter().map(|n| *n as i64).collect();
        let values = Tensor::from_slice(params.slice(id)).view(&*shape);
        store.root().var_copy(&params.spec(id).name, &values)
    };
    params.ids().map(copy).collect()
}

fn assert_near(params: &Parameters, copies: &[Tensor], tolerance: f32) {
    for (id, copy) in params.ids().zip(copies) {
        let theirs: Vec<f32> = Vec::try_from(copy.detach().flatten(0, -1)).unwrap();
        let apart = params.slice(id).iter().zip(theirs).map(|(ours, theirs)| (ours - theirs).abs());
        assert!(apart.fold(0.0, f32::max) < tolerance);
    }
}

#[test]
fn steps_equal_those_of_pytorchs_adam() {
    let mut params = params(37);
    let store = nn::VarStore::new(Device::Cpu);
    let copies = copies(&params, &store);
    let mut theirs = nn::Adam::default().eps(1e-5).build(&store, 1e-2).unwrap();
    let settings = OptimizerSettings { epsilon: 1e-5, ..OptimizerSettings::default() };
    let mut ours = Optimizer::new(&params, params.ids().collect(), settings);
    for _ in 0..30 {
        let gradients = gradients(&params);
        let norm = ours.norm(&gradients);
        assert!(ours.step(&mut params, &gradients, 1e-2, Some((norm, 0.5))));
        theirs.backward_step_clip_norm(&loss(&copies[0], &copies[1]), 0.5);
    }
    assert_near(&params, &copies, 1e-5);
}

#[test]
fn steps_equal_those_of_pytorchs_rmsprop() {
    let mut params = params(40);
    let store = nn::VarStore::new(Device::Cpu);
    let copies = copies(&params, &store);
    let theirs = nn::RmsProp { alpha: 0.99, eps: 1e-5, wd: 0.0, momentum: 0.0, centered: false };
    let mut theirs = theirs.build(&store, 1e-5).unwrap();
    let mut ours = Optimizer::new(&params, params.ids().collect(), OptimizerSettings::rmsprop(0.99, 1e-5));
    for _ in 0..30 {
        let gradients = gradients(&params);
        assert!(ours.step(&mut params, &gradients, 1e-5, None));
        theirs.backward_step(&loss(&copies[0], &copies[1]));
    }
    assert_near(&params, &copies, 1e-6);
}

#[test]
fn a_parameter_without_a_gradient_stays_and_moments_are_kept_apart() {
    let mut params = params(4);
    let ids: Vec<ParamId> = params.ids().collect();
    let before = params.values().to_vec();
    let mut adam = Optimizer::new(&params, ids.clone(), OptimizerSettings::default());
    let mut gradients = Gradients::new(&params);
    gradients.set(ids[0]).fill(1.0);
    assert_eq!(adam.norm(&gradients), 2.0, "the norm of four ones");
    assert!(adam.step(&mut params, &gradients, 0.1, None));
    let moved = params.values()[..4].iter().zip(&before);
    assert!(moved.into_iter().all(|(after, before)| (before - after - 0.1).abs() < 1e-5));
    assert_eq!(params.values()[4..], before[4..]);
}

#[test]
fn an_optimizer_goes_on_from_a_checkpoint_as_if_it_had_not_stopped() {
    let run = |stop: bool| {
        let mut params = params(40);
        let ids: Vec<ParamId> = params.ids().collect();
        let mut adam = Optimizer::new(&params, ids.clone(), OptimizerSettings::default());
        for step in 0..6 {
            let gradients = gradients(&params);
            assert!(adam.step(&mut params, &gradients, 1e-2, None));
            if stop && step == 2 {
                let mut arrays = Arrays::new();
                adam.save("adam", &mut arrays);
                let steps = adam.steps();
                adam = Optimizer::new(&params, ids.clone(), OptimizerSettings::default());
                adam.restore("adam", steps, &mut arrays).unwrap();
            }
        }
        params.values().to_vec()
    };
    assert_eq!(run(true), run(false));
}

#[test]
fn a_step_that_no_weight_can_hold_is_refused_and_changes_nothing() {
    let mut params = params(4);
    let (before, gradients) = (params.values().to_vec(), gradients(&params));
    let mut adam = Optimizer::new(&params, params.ids().collect(), OptimizerSettings::default());
    assert!(!adam.step(&mut params, &gradients, 1e38, None));
    assert_eq!((params.values(), adam.steps()), (&before[..], 0));
}
