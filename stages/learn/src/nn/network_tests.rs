//! The native backend against libtorch, and against itself in other batches.

use dril_stage_api::Seed;

use super::*;

/// A network with parts that share one, and a batch that it takes.
struct Case {
    network: Network,
    nodes: Vec<NodeId>,
    batch: Batch,
}

fn numbers(count: usize, factor: f32) -> Vec<f32> {
    (0..count).map(|at| (at as f32 * factor).sin()).collect()
}

fn images(rows: usize, side: usize, filters: [usize; 3]) -> Case {
    let mut build = Builder::new();
    let init = LayerInit::Default;
    let (mut shared, features) = build.convolutions("conv", (4, side, side), filters, init);
    build.linear(&mut shared, "hidden", (features, 50), init, Activation::Relu);
    let shared = build.node(None, shared);
    let nodes = ["out", "other"].map(|name| {
        let mut layers = Sequential::default();
        build.linear(&mut layers, name, (50, 2), init, Activation::Linear);
        build.node(Some(shared), layers)
    });
    let bytes = numbers(rows * 4 * side * side, 0.37).iter().map(|x| (x * 127.0 + 127.0) as u8).collect();
    let network = Network::new(build.finish(Some(&mut Seed(1).stream("init"))));
    Case { network, nodes: nodes.to_vec(), batch: Batch::Images { rows, bytes } }
}

fn vectors(rows: usize, inputs: usize) -> Case {
    let mut build = Builder::new();
    let mut layers = Sequential::default();
    let init = LayerInit::Orthogonal(1.0);
    build.linear(&mut layers, "first", (inputs, 64), init, Activation::Tanh);
    build.linear(&mut layers, "second", (64, 37), init, Activation::Tanh);
    build.linear(&mut layers, "out", (37, 3), init, Activation::Linear);
    let node = build.node(None, layers);
    let network = Network::new(build.finish(Some(&mut Seed(2).stream("init"))));
    Case { network, nodes: vec![node], batch: Batch::Vectors { rows, numbers: numbers(rows * inputs, 0.71) } }
}

fn all() -> Vec<Case> {
    let mut cases = vec![images(7, 84, [32, 64, 32]), images(5, 36, [16, 32, 64])];
    cases.extend([(13, 8), (1, 16), (6, 35)].map(|(rows, inputs)| vectors(rows, inputs)));
    cases
}

fn whole(case: &Case) -> Vec<Wanted> {
    case.nodes.iter().map(|node| Wanted { node: *node, rows: 0..case.batch.rows() }).collect()
}

/// The largest difference over the largest number.
fn apart(found: &[f32], wanted: &[f32]) -> f32 {
    assert_eq!(found.len(), wanted.len());
    let largest = |numbers: &mut dyn Iterator<Item = f32>| numbers.fold(0.0_f32, |a, b| a.max(b.abs()));
    largest(&mut found.iter().zip(wanted).map(|(a, b)| a - b))
        / largest(&mut wanted.iter().copied()).max(1e-6)
}

/// Outputs, and the gradients of a weighted sum of them.
fn pass(case: &Case, wanted: &[Wanted]) -> (Vec<Vec<f32>>, Gradients) {
    let mut gradients = Gradients::new(&case.network.params);
    let (outputs, tape) = case.network.forward(&case.batch, wanted);
    let arrived = wanted.iter().cloned().zip(outputs.iter().map(|output| numbers(output.len(), 1.3)));
    case.network.backward(&case.batch, tape, arrived.collect(), &mut gradients);
    (outputs, gradients)
}

/// Compares a pass with libtorch's on this device.
fn compare(device: tch::Device, tolerance: f32) {
    for mut case in all() {
        let rows = case.batch.rows();
        let slices = case.nodes.iter().enumerate().map(|(at, node)| Wanted {
            node: *node,
            rows: at * rows / case.nodes.len()..(at + 1) * rows / case.nodes.len(),
        });
        for wanted in [whole(&case), slices.collect()] {
            let (found, by_kernels) = pass(&case, &wanted);
            case.network.use_torch(device);
            let (outputs, by_torch) = pass(&case, &wanted);
            case.network.set_device(dril_kinds::Device::Cpu).unwrap();
            for (found, wanted) in found.iter().zip(&outputs) {
                assert!(apart(found, wanted) < tolerance);
            }
            for id in case.network.params.ids() {
                let (found, wanted) = (by_kernels.get(id).unwrap(), by_torch.get(id).unwrap());
                let name = &case.network.params.spec(id).name;
                assert!(apart(found, wanted) < tolerance, "{name}: {}", apart(found, wanted));
            }
        }
    }
}

#[test]
fn outputs_and_all_gradients_are_those_of_libtorch() {
    compare(tch::Device::Cpu, 1e-5);
}

#[test]
fn a_gpu_gives_the_same_where_there_is_one() {
    if tch::Cuda::is_available() {
        compare(tch::Device::Cuda(0), 1e-2);
    }
}

#[test]
fn a_row_comes_out_the_same_whatever_stands_beside_it() {
    for case in all() {
        let wanted = whole(&case);
        let all = case.network.infer(&case.batch, &wanted);
        for row in 0..case.batch.rows() {
            let alone = match &case.batch {
                Batch::Images { rows, bytes } => {
                    let len = bytes.len() / rows;
                    Batch::Images { rows: 1, bytes: bytes[row * len..][..len].to_vec() }
                }
                Batch::Vectors { rows, numbers } => {
                    let len = numbers.len() / rows;
                    Batch::Vectors { rows: 1, numbers: numbers[row * len..][..len].to_vec() }
                }
            };
            let one: Vec<Wanted> =
                wanted.iter().map(|wanted| Wanted { rows: 0..1, ..wanted.clone() }).collect();
            for (found, all) in case.network.infer(&alone, &one).iter().zip(&all) {
                assert_eq!(found[..], all[row * found.len()..][..found.len()]);
            }
        }
    }
}

#[test]
fn changed_weights_are_seen_and_what_was_not_asked_for_has_no_gradient() {
    let mut case = images(3, 36, [16, 32, 64]);
    let one = whole(&case)[..1].to_vec();
    let (before, gradients) = pass(&case, &one);
    for id in case.network.params.ids() {
        let unused = case.network.params.spec(id).name.starts_with("other");
        assert_eq!(gradients.get(id).is_none(), unused);
    }
    let doubled: Vec<f32> = case.network.params.values().iter().map(|value| 2.0 * value).collect();
    case.network.params.set_values(&doubled);
    assert_ne!(case.network.infer(&case.batch, &one), before);
}

#[test]
fn a_gpu_that_is_not_there_is_an_error_that_says_what_to_do() {
    if !tch::Cuda::is_available() {
        let message = images(1, 36, [16, 32, 64]).network.set_device(dril_kinds::Device::Cuda).unwrap_err();
        assert!(message.to_string().contains("set `device` to `cpu`"), "{message}");
    }
}
