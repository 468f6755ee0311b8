//! Agents as a whole: their size, their file, and what is refused.

use dril_stage_api::Seed;

use super::*;

const IMAGES: ObservationSpace = ObservationSpace::Image { height: 84, width: 84, stack: 4 };

fn architecture(network: Network, family: PolicyFamily, observation: ObservationSpace) -> Architecture {
    Architecture { network, family, observation, actions: ActionSpace::Continuous { dims: 2 } }
}

fn policy(network: Network, family: PolicyFamily) -> Policy {
    let observation = if network == Network::Mlp { ObservationSpace::Vector { len: 8 } } else { IMAGES };
    Policy::new(architecture(network, family, observation), &mut Seed(1).stream("init")).unwrap()
}

fn count(policy: &Policy, part: &str) -> usize {
    let ids = policy.params().ids().filter(|id| policy.params().spec(*id).name.starts_with(part));
    ids.map(|id| policy.params().slice(id).len()).sum()
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

/// The Euclidean norms of the rows of a weight.
fn row_norms(policy: &Policy, name: &str) -> Vec<f32> {
    let id = policy.params().ids().find(|id| policy.params().spec(*id).name == name).unwrap();
    let len = policy.params().spec(id).shape[1..].iter().product();
    let rows = policy.params().slice(id).chunks(len);
    rows.map(|row| row.iter().map(|weight| weight * weight).sum::<f32>().sqrt()).collect()
}

#[test]
fn an_expert_begins_with_the_gains_of_the_reference() {
    let expert = policy(Network::ExpertCnn, PolicyFamily::Gaussian);
    for (name, gain) in [
        ("conv.0", 2.0_f32.sqrt()),
        ("shared", 2.0_f32.sqrt()),
        ("actor.0", 1.0),
        ("actor.1", 1.0),
        ("critic.0", 1.0),
        ("critic.1", 1.0),
        ("head.mean", 1.0),
    ] {
        let norms = row_norms(&expert, &format!("{name}.weight"));
        assert!(norms.iter().all(|norm| (norm - gain).abs() < 1e-4), "{name}: {norms:?}");
    }
}

#[test]
fn a_new_beta_agent_acts_with_the_spread_of_the_thesis() {
    // α = β = softplus(0) + 1 ≈ 1.69 where the features are 0: a deviation of 0.477 in [-1, 1].
    let row = Row::Beta { u: &[0.0], w: &[0.0] };
    let mut stream = Seed(1).stream("action");
    let mut sample = [0.0];
    let squares = (0..20_000).map(|_| {
        row.sample(&mut stream, &mut sample);
        let action = f64::from(to_action(PolicyFamily::Beta, sample[0]));
        action * action
    });
    let deviation = (squares.sum::<f64>() / 20_000.0).sqrt();
    assert!((deviation - 0.477).abs() < 0.005, "{deviation}");
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
        assert_eq!(read.params().values(), saved.params().values());
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
    let odd = ObservationSpace::Image { height: 83, width: 84, stack: 4 };
    let wrong = architecture(Network::DrilCnn, PolicyFamily::Beta, odd);
    assert!(Policy::new(wrong, &mut stream).unwrap_err().to_string().contains("multiples of 4"));
}

#[test]
fn one_pass_gives_the_same_as_actor_and_critic_apart() {
    let policy = policy(Network::ExpertCnn, PolicyFamily::Gaussian);
    let bytes = (0..2 * 64 * 441).map(|at| (at % 256) as u8).collect();
    let seen = Batch::Images { rows: 2, bytes };
    let both = policy.infer(&seen, Parts::Both);
    assert_eq!(both.values, policy.values(&seen));
    assert_eq!(both.heads, policy.infer(&seen, Parts::Actor).heads);
    assert_eq!(policy.forward(&seen, Parts::Both).0, both);
}

#[test]
fn a_mark_of_divergence_survives_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("policy");
    let mut marked = policy(Network::Mlp, PolicyFamily::Beta);
    marked.diverged_at_step = Some(4096);
    marked.save(&path).unwrap();
    assert_eq!(Policy::load("policy", &path).unwrap().diverged_at_step, Some(4096));
}
