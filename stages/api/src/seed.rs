//! Random numbers: all random numbers of a stage come from named streams of the stage's seed.
//!
//! Streams are independent: adding a draw in one place changes nothing elsewhere. They are counter-based (ChaCha with 8
//! rounds): a stream's position is one number, which checkpoints restore exactly.

use rand::{Rng, TryRng, rand_core::Infallible};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// The seed of a stage, as the pipeline file gives it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Seed(pub u64);

impl Seed {
    /// The stream of that name. Equal seed and name give equal numbers on every machine.
    pub fn stream(self, name: &str) -> StreamRng {
        StreamRng(rand::SeedableRng::from_seed(self.derive(name)))
    }

    /// A seed for a part with its own streams, such as one environment or one ensemble member.
    pub fn child(self, name: &str) -> Seed {
        let bytes = self.derive(name);
        let mut first = [0; 8];
        first.copy_from_slice(&bytes[..8]);
        Seed(u64::from_le_bytes(first))
    }

    fn derive(self, name: &str) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new_derive_key("dril-pipe random stream v1");
        hasher.update(&self.0.to_le_bytes());
        hasher.update(name.as_bytes());
        *hasher.finalize().as_bytes()
    }
}

/// A random stream; serialises with its position.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct StreamRng(ChaCha8Rng);

impl TryRng for StreamRng {
    type Error = Infallible;
    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        Ok(self.0.next_u32())
    }
    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        Ok(self.0.next_u64())
    }
    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        self.0.fill_bytes(bytes);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_gives_the_same_numbers_for_ever() {
        // A change here changes every result that anybody has cached: raise every REVISION if it is meant.
        let mut stream = Seed(66).stream("ppo/minibatch");
        let drawn: Vec<u64> = (0..3).map(|_| stream.next_u64()).collect();
        assert_eq!(drawn, GOLDEN);
        assert_eq!(Seed(66).child("env/0"), Seed(GOLDEN_CHILD));
    }
    const GOLDEN: [u64; 3] =
        [7_244_123_909_624_695_804, 4_538_712_736_815_455_465, 2_711_433_814_504_063_096];
    const GOLDEN_CHILD: u64 = 16498946991218271885;

    #[test]
    fn names_and_seeds_give_independent_streams() {
        let first = |seed: u64, name: &str| Seed(seed).stream(name).next_u64();
        assert_ne!(first(1, "a"), first(1, "b"));
        assert_ne!(first(1, "a"), first(2, "a"));
        assert_ne!(first(1, "a"), Seed(1).child("a").0);
    }

    #[test]
    fn a_stream_continues_where_it_was_saved() {
        let mut stream = Seed(1).stream("noise");
        for _ in 0..77 {
            stream.next_u32();
        }
        let saved = serde_json::to_string(&stream).unwrap();
        let mut restored: StreamRng = serde_json::from_str(&saved).unwrap();
        assert_eq!(restored.next_u64(), stream.next_u64());
    }
}
