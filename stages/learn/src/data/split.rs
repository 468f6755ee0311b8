//! Training and validation split, order and batches: pure functions over lists of transition numbers, with all random
//! choices drawn from a given stream.
//!
//! Transitions are numbered from 0 through all episodes of the demonstrations, in order.

use dril_kinds::Split;
use dril_stage_api::StreamRng;
use rand::RngExt;
use rand::seq::SliceRandom;

/// Pair numbers of the two parts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Partition {
    /// The training set; never empty.
    pub train: Vec<usize>,
    /// The validation set; may be empty.
    pub validation: Vec<usize>,
}

/// Splits the transitions of trajectories with these `lengths`, so that about `fraction` (0..1) of them are held out for
/// validation.
///
/// - [`Split::Pairs`]: a random permutation; the first ⌊n·(1 − fraction)⌋ transitions train (at least one).
/// - [`Split::Trajectories`]: trajectories in random order are held out as long as that brings their share closer to
///   `fraction`: at least one if `fraction` is above 0, never all. Of a single trajectory, a contiguous block at a random
///   position.
pub fn divide(lengths: &[usize], fraction: f64, split: Split, rng: &mut StreamRng) -> Partition {
    let count = lengths.iter().sum();
    match split {
        Split::Pairs => {
            let mut order = permutation(count, rng);
            let validation = order.split_off(training_size(count, fraction));
            Partition { train: order, validation }
        }
        Split::Trajectories if lengths.len() < 2 => {
            let held_out = count - training_size(count, fraction);
            let from = rng.random_range(0..=(count - held_out) as u64) as usize;
            by_membership(count, |transition| (from..from + held_out).contains(&transition))
        }
        Split::Trajectories => whole_trajectories(lengths, fraction, rng),
    }
}

/// Transitions left for training: the part that is not held out, rounded down, and at least one.
fn training_size(count: usize, fraction: f64) -> usize {
    let exact = count as f64 * (1.0 - fraction);
    // 100·(1 − 0.2) is 80.0 and 10·(1 − 0.1) is 9.0, but some products fall short by an ulp; they mean the whole number.
    let size =
        if (exact - exact.round()).abs() < 1e-9 * count as f64 { exact.round() } else { exact.floor() };
    (size as usize).max(1).min(count)
}

fn whole_trajectories(lengths: &[usize], fraction: f64, rng: &mut StreamRng) -> Partition {
    let wanted = fraction * lengths.iter().sum::<usize>() as f64;
    let mut held_out = vec![false; lengths.len()];
    let mut taken = 0;
    for (rank, trajectory) in permutation(lengths.len(), rng).into_iter().enumerate() {
        let with = taken + lengths[trajectory];
        let nearer = (with as f64 - wanted).abs() < (taken as f64 - wanted).abs();
        let first = rank == 0 && fraction > 0.0;
        let others_left = rank + 1 < lengths.len();
        if others_left && (first || nearer) {
            held_out[trajectory] = true;
            taken = with;
        } else {
            break;
        }
    }
    let owner: Vec<usize> =
        lengths.iter().enumerate().flat_map(|(at, length)| std::iter::repeat_n(at, *length)).collect();
    by_membership(owner.len(), |transition| held_out[owner[transition]])
}

fn by_membership(count: usize, validates: impl Fn(usize) -> bool) -> Partition {
    let (validation, train) = (0..count).partition(|transition| validates(*transition));
    Partition { train, validation }
}

/// The numbers below `count`, in random order.
pub fn permutation(count: usize, rng: &mut StreamRng) -> Vec<usize> {
    shuffled(&(0..count).collect::<Vec<_>>(), rng)
}

/// The elements of `of`, in random order.
pub fn shuffled(of: &[usize], rng: &mut StreamRng) -> Vec<usize> {
    let mut order = of.to_vec();
    order.shuffle(rng);
    order
}

/// `draws` elements of `of`, drawn with replacement.
pub fn with_replacement(of: &[usize], draws: usize, rng: &mut StreamRng) -> Vec<usize> {
    // Drawn as u64, so that the draws do not depend on the width of usize.
    (0..draws).map(|_| of[rng.random_range(0..of.len() as u64) as usize]).collect()
}

/// How an epoch over `count` transitions is divided into batches: (number of batches, batch size). A remainder is dropped;
/// fewer transitions than one batch form one batch, rounded down to a multiple of `slices`.
pub fn batching(count: usize, batch_size: usize, slices: usize) -> (usize, usize) {
    let size = batch_size.min(count) / slices * slices;
    (count.checked_div(size).unwrap_or(0), size)
}

/// `batch_size` distinct elements of `of` in random order, or all of them if there are fewer.
///
/// Each call draws independently, so that the stream is the whole state.
pub fn random_batch(of: &[usize], batch_size: usize, rng: &mut StreamRng) -> Vec<usize> {
    let drawn = rand::seq::index::sample(rng, of.len(), batch_size.min(of.len()));
    drawn.into_iter().map(|at| of[at]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_stage_api::Seed;
    use proptest::prelude::*;

    fn stream() -> StreamRng {
        Seed(66).stream("split")
    }

    #[test]
    fn permutations_and_draws_are_the_same_for_ever() {
        // A change here changes every trained policy that anybody has cached: raise the REVISIONs if it is meant.
        assert_eq!(permutation(8, &mut stream()), PERMUTATION);
        assert_eq!(with_replacement(&[10, 11, 12, 13], 6, &mut stream()), DRAWS);
        assert_eq!(random_batch(&[10, 11, 12, 13, 14], 3, &mut stream()), BATCH);
    }
    const PERMUTATION: [usize; 8] = [7, 2, 5, 3, 1, 6, 4, 0];
    const DRAWS: [usize; 6] = [12, 11, 12, 10, 12, 10];
    const BATCH: [usize; 3] = [11, 12, 14];

    #[test]
    fn four_fifths_of_the_pairs_train() {
        let parts = divide(&[60, 40], 0.2, Split::Pairs, &mut stream());
        assert_eq!((parts.train.len(), parts.validation.len()), (80, 20));
        assert_ne!(parts.train, (0..80).collect::<Vec<_>>(), "the transitions are in random order");
    }

    #[test]
    fn trajectories_stay_whole() {
        let parts = divide(&[10, 10, 10, 10, 10], 0.2, Split::Trajectories, &mut stream());
        assert_eq!(parts.validation.len(), 10);
        assert_eq!(parts.validation[0] % 10, 0);
        assert!(parts.validation.windows(2).all(|two| two[1] == two[0] + 1));
    }

    #[test]
    fn of_one_trajectory_a_block_validates() {
        let parts = divide(&[50], 0.2, Split::Trajectories, &mut stream());
        assert_eq!(parts.validation.len(), 10);
        assert!(parts.validation.windows(2).all(|two| two[1] == two[0] + 1));
    }

    #[test]
    fn two_trajectories_of_unequal_length_leave_one_for_each_part() {
        for seed in 0..8 {
            let parts = divide(&[90, 10], 0.2, Split::Trajectories, &mut Seed(seed).stream("split"));
            assert!([10, 90].contains(&parts.validation.len()));
        }
    }

    #[test]
    fn leftovers_are_left_out_and_few_pairs_are_one_batch() {
        assert_eq!(batching(7, 3, 1), (2, 3));
        assert_eq!(batching(7, 100, 1), (1, 7));
        assert_eq!(batching(7, 100, 5), (1, 5));
        assert_eq!(batching(250, 100, 5), (2, 100));
        assert_eq!(batching(250, 102, 5), (2, 100));
        assert_eq!(batching(4, 100, 5), (0, 0));
    }

    #[test]
    fn a_random_batch_holds_no_pair_twice_and_differs_from_the_next() {
        let of: Vec<usize> = (100..120).collect();
        let mut rng = stream();
        let (first, second) = (random_batch(&of, 12, &mut rng), random_batch(&of, 12, &mut rng));
        assert_ne!(first, second);
        for mut batch in [first, second] {
            batch.sort_unstable();
            batch.dedup();
            assert_eq!(batch.len(), 12);
            assert!(batch.iter().all(|transition| of.contains(transition)));
        }
        assert_eq!(random_batch(&of, 100, &mut rng).len(), 20);
    }

    proptest! {
        #[test]
        fn the_parts_hold_every_pair_once(
            lengths in proptest::collection::vec(1usize..40, 1..8),
            fraction in 0.0f64..0.95,
            whole in any::<bool>(),
            seed in any::<u64>(),
        ) {
            let split = if whole { Split::Trajectories } else { Split::Pairs };
            let parts = divide(&lengths, fraction, split, &mut Seed(seed).stream("split"));
            prop_assert!(!parts.train.is_empty());
            let mut all = [parts.train, parts.validation].concat();
            all.sort_unstable();
            prop_assert_eq!(all, (0..lengths.iter().sum()).collect::<Vec<usize>>());
        }

        #[test]
        fn draws_with_replacement_come_from_the_list(
            of in proptest::collection::vec(0usize..1000, 1..30), draws in 0usize..100, seed in any::<u64>(),
        ) {
            let drawn = with_replacement(&of, draws, &mut Seed(seed).stream("bootstrap"));
            prop_assert_eq!(drawn.len(), draws);
            prop_assert!(drawn.iter().all(|transition| of.contains(transition)));
        }
    }
}
