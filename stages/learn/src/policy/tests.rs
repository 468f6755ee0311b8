//! Agents as a whole: their size, their file, and what is refused.

use dril_stage_api::Seed;

use super::*;

const IMAGES: Observation = Observation::Images { height: 84, width: 84, stack: 4 };

fn architecture(network: Network, family: PolicyFamily, observation: Observation) -> Architecture {
    crate::fast::prepare();
    Architecture { network, family, observation, actions: 2 }
}

fn policy(network: Network, family: PolicyFamily) -> Policy {
    let observation = if network == Network::Mlp { Observation::Vector { len: 8 } } else { IMAGES };
    Policy::new(architecture(network, family, observation), &mut Seed(1).stream("init")).unwrap()
}

fn count(policy: &Policy, part: &str) -> usize {
    let ids = policy.params.ids().filter(|id| policy.params.spec(*id).name.starts_with(part));
    ids.map(|id| policy.params.slice(id).len()).sum()
}

#[test]
fn networks_have_the_size_of_the_references() {
    let dril = policy(Network::DrilCnn, PolicyFamily::Gaussian);
    // 4·32·8² + 32, 32·64·4² + 64, 64·64·3² + 64.
    assert_eq!(count(&dril, "conv"), 8_224 + 32_832 + 36_928);
    assert_eq!(count(&dril, "actor"), 3_136 * 512 + 512 + 512 * 512 + 512);
    assert_eq!(count(&dril, "critic"), 3_136 * 512 + 512 + 513);
    assert_eq!(count(&dril, "head"), 2 * 512 + 2 + 2);
    let expert = policy(Network::ExpertCnn, PolicyFamily::Beta);
    assert_eq!(count(&expert, "conv"), 8_224 + 32_832 + 64 * 32 * 9 + 32);
    assert_eq!(count(&expert, "shared"), 1_568 * 512 + 512);
    assert_eq!(count(&expert, "actor"), 2 * (512 * 512 + 512));
    assert_eq!(count(&expert, "head"), 2 * (512 * 2 + 2));
    let mlp = policy(Network::Mlp, PolicyFamily::Gaussian);
    assert_eq!(count(&mlp, "actor"), 8 * 64 + 64 + 64 * 64 + 64);
}

#[test]
fn a_new_beta_agent_acts_with_the_spread_of_the_thesis() {
    // α = β = softplus(0) + 1 ≈ 1.69 where the features are 0: a deviation of 0.477 in [-1, 1].
    let shape = oracle::beta_shape(&Tensor::from_slice(&[0.0_f32])).double_value(&[0]);
    assert!((shape - 1.693).abs() < 1e-3);
    assert!((2.0 * (1.0 / (4.0 * (2.0 * shape + 1.0))).sqrt() - 0.477).abs() < 1e-3);
}

#[test]
fn an_agent_comes_back_from_its_file_and_says_the_same() {
    let folder = tempfile::tempdir().unwrap();
    for (network, family) in
        [(Network::ExpertCnn, PolicyFamily::Beta), (Network::Mlp, PolicyFamily::Gaussian)]
    {
        let saved = policy(network, family);
        let path = folder.path().join("policy");
        saved.save(&path).unwrap();
        let read = Policy::load("policy", &path).unwrap();
        assert_eq!(read.architecture(), saved.architecture());
        assert_eq!(read.params.values(), saved.params.values());
        assert_eq!(read.to_bytes().unwrap(), saved.to_bytes().unwrap());
    }
}

#[test]
fn a_file_that_holds_no_agent_is_refused_with_what_was_seen() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("policy");
    let whole = policy(Network::Mlp, PolicyFamily::Beta).to_bytes().unwrap();
    let foreign =
        safetensors::serialize(Vec::<(&str, safetensors::tensor::TensorView<'_>)>::new(), None).unwrap();
    let mut not_finite = whole.clone();
    let last = not_finite.len() - 4;
    not_finite[last..].copy_from_slice(&f32::NAN.to_le_bytes());
    for (bytes, part) in [
        (&b""[..], "not a safetensors file"),
        (b"something else entirely", "not a safetensors file"),
        (&whole[..whole.len() - 1], "not a safetensors file"),
        (&foreign, "expected weights of this program"),
        (&not_finite, "not finite"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let message = Policy::load("policy", &path).unwrap_err().to_string();
        assert!(message.contains(part) && message.starts_with("input `policy`"), "{message}");
    }
    assert!(Policy::load("policy", folder.path()).is_err(), "a folder");
}

#[test]
fn a_network_that_does_not_fit_the_observation_is_refused_with_one_that_does() {
    let mut stream = Seed(1).stream("init");
    let wrong = architecture(Network::Mlp, PolicyFamily::Beta, IMAGES);
    let message = Policy::new(wrong, &mut stream).unwrap_err().to_string();
    assert!(message.contains("`mlp`") && message.contains("`expert-cnn`"), "{message}");
    let odd = Observation::Images { height: 83, width: 84, stack: 4 };
    let wrong = architecture(Network::DrilCnn, PolicyFamily::Beta, odd);
    assert!(Policy::new(wrong, &mut stream).unwrap_err().to_string().contains("multiples of 4"));
}

#[test]
fn short_numbers_give_nearly_the_same_gradients_and_leave_the_weights_as_they_are() {
    let mut policy = policy(Network::DrilCnn, PolicyFamily::Beta);
    let before = policy.params.values().to_vec();
    let seen =
        Tensor::from_slice(&(0..4_i64 * 64 * 441).map(|at| (at * at % 253) as f32).collect::<Vec<_>>());
    let seen = seen.view([4, 21, 21, 64]);
    let ids: Vec<_> = policy.params.ids().collect();
    let gradients = |policy: &Policy| -> Vec<f32> {
        let forward = policy.forward(&seen);
        let loss = forward.distribution.mean_action().square().sum(tch::Kind::Float)
            + forward.values.square().sum(tch::Kind::Float);
        let gradients = forward.gradients(policy, &loss, &ids);
        gradients.iter().flatten().flat_map(|g| crate::fast::memory::values(g).to_vec()).collect()
    };
    let exact = gradients(&policy);
    policy.params.set_precision(Precision::Bf16);
    let short = gradients(&policy);
    assert_eq!(policy.params.values(), before);
    let norm =
        |values: &mut dyn Iterator<Item = f32>| values.map(|v| f64::from(v).powi(2)).sum::<f64>().sqrt();
    let apart = norm(&mut exact.iter().zip(&short).map(|(a, b)| a - b)) / norm(&mut exact.iter().copied());
    assert!(apart > 0.0 && apart < 0.05, "{apart}");
    // A change of the weights is seen by the short copy.
    policy.params.set_values(&before.iter().map(|v| 0.5 * v).collect::<Vec<_>>());
    assert_ne!(gradients(&policy), short);
}

#[test]
fn one_pass_gives_the_same_as_actor_and_critic_apart() {
    let policy = policy(Network::ExpertCnn, PolicyFamily::Gaussian);
    let seen = Tensor::from_slice(&(0..2 * 64 * 441).map(|at| (at % 256) as f32).collect::<Vec<_>>());
    let seen = seen.view([2, 21, 21, 64]);
    tch::no_grad(|| {
        let both = policy.forward(&seen);
        assert_eq!(both.values, policy.values(&seen));
        assert_eq!(both.distribution.mean_action(), policy.act(&seen).distribution.mean_action());
    });
}
