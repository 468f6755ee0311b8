//! Frame storage: each frame is stored once, as bytes, and stacks are gathered for each minibatch.
//!
//! A buffer of stacks in floating point would take sixteen times the memory. A frame's predecessor is in the slot before
//! it, and each slot records how many frames of its own episode precede it, so that a stack never contains frames of
//! another episode: frames before the first are black, as in the reference code.

use dril_envs::{Frame, ObservationSpace};
use dril_stage_api::StageError;

use crate::kernels::layout;
use crate::nn::Batch;
use crate::training::checkpoint::{Arrays, foreign};
use crate::training::normalize::ObservationStatistics;

/// Frames (or observation vectors) in numbered slots.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameStore {
    observation: ObservationSpace,
    /// Frames in blocks (see [`layout`]), one slot after the other; empty for vectors.
    bytes: Vec<u8>,
    /// Vectors, one slot after the other; empty for frames.
    numbers: Vec<f32>,
    /// Number of preceding frames of the same episode, at most one less than the stack.
    ages: Vec<u8>,
}

impl FrameStore {
    /// A store without slots.
    pub fn new(observation: ObservationSpace) -> Self {
        Self { observation, bytes: Vec::new(), numbers: Vec::new(), ages: Vec::new() }
    }

    /// A store with this many empty slots, to be filled by [`FrameStore::set`].
    pub fn with_slots(observation: ObservationSpace, slots: usize) -> Self {
        let mut store = Self::new(observation);
        store.resize(slots);
        store
    }

    /// Observation space of the slots.
    pub fn observation(&self) -> ObservationSpace {
        self.observation
    }

    /// Number of slots.
    pub fn len(&self) -> usize {
        self.ages.len()
    }

    /// True if there is no slot.
    pub fn is_empty(&self) -> bool {
        self.ages.is_empty()
    }

    /// Appends a frame and returns its slot. `first`: the frame starts an episode.
    pub fn push(&mut self, frame: Frame<'_>, first: bool) -> usize {
        let slot = self.len();
        self.resize(slot + 1);
        self.set(slot, frame, first);
        slot
    }

    /// Writes a frame to a slot. `first`: the frame starts an episode; otherwise the previous frame must be in the slot
    /// before. The frame must have the size of the store's observation space.
    pub fn set(&mut self, slot: usize, frame: Frame<'_>, first: bool) {
        let deepest = self.observation.stack().saturating_sub(1) as u8;
        self.ages[slot] = if first || slot == 0 { 0 } else { (self.ages[slot - 1] + 1).min(deepest) };
        match (self.observation, frame) {
            (ObservationSpace::Image { height, width, .. }, Frame::Image(pixels)) => {
                let size = height * width;
                let blocked = &mut self.bytes[slot * size..][..size];
                layout::block_frame(pixels, (height, width), blocked);
            }
            (ObservationSpace::Vector { len }, Frame::Vector(vector)) => {
                self.numbers[slot * len..][..len].copy_from_slice(vector);
            }
            _ => {}
        }
    }

    /// As [`FrameStore::set`], with vectors normalised by the statistics, if given.
    pub fn set_scaled(
        &mut self,
        slot: usize,
        frame: Frame<'_>,
        first: bool,
        statistics: Option<&ObservationStatistics>,
    ) {
        match (statistics, frame) {
            (Some(statistics), Frame::Vector(vector)) => {
                self.set(slot, Frame::Vector(&statistics.scale(vector)), first);
            }
            _ => self.set(slot, frame, first),
        }
    }

    /// Frees the slot `newest` at the end of a window of `count` slots: all frames move back by one, and the oldest is
    /// dropped.
    pub fn shift(&mut self, newest: usize, count: usize) {
        if count > 1 {
            self.carry(newest, count - 1, newest + 1 - count);
        }
    }

    /// Copies the `count` slots up to and including `last` to the slots from `to` on, so that stacks continue when a buffer
    /// is refilled.
    pub fn carry(&mut self, last: usize, count: usize, to: usize) {
        let from = last + 1 - count;
        self.ages.copy_within(from..=last, to);
        let (bytes, numbers) = (self.frame_bytes(), self.frame_numbers());
        self.bytes.copy_within(from * bytes..(last + 1) * bytes, to * bytes);
        self.numbers.copy_within(from * numbers..(last + 1) * numbers, to * numbers);
    }

    /// The observations whose newest frames are in `slots`, as a batch.
    pub fn gather(&self, slots: &[usize]) -> Batch {
        let rows = slots.len();
        match self.observation {
            ObservationSpace::Image { height, width, stack } => {
                let mut bytes = vec![0; rows * stack * height * width];
                self.gather_stacks(slots, stack * height * width, &mut bytes);
                Batch::Images { rows, bytes }
            }
            ObservationSpace::Vector { len } => {
                let numbers =
                    slots.iter().flat_map(|slot| &self.numbers[slot * len..][..len]).copied().collect();
                Batch::Vectors { rows, numbers }
            }
        }
    }

    /// Saves the content to a checkpoint, under names that start with `name`.
    pub fn save(&self, name: &str, arrays: &mut Arrays) {
        arrays.put(&format!("{name}.bytes"), self.bytes.clone());
        arrays.put_f32(&format!("{name}.numbers"), &self.numbers);
        arrays.put(&format!("{name}.ages"), self.ages.clone());
    }

    /// Restores the content from a checkpoint.
    ///
    /// # Errors
    /// The checkpoint is from a store of another size.
    pub fn restore(&mut self, name: &str, arrays: &mut Arrays) -> Result<(), StageError> {
        let numbers = arrays.take_f32(&format!("{name}.numbers"), self.numbers.len())?;
        let (bytes, ages) = (arrays.take(&format!("{name}.bytes"))?, arrays.take(&format!("{name}.ages"))?);
        if bytes.len() != self.bytes.len() || ages.len() != self.ages.len() {
            return Err(foreign("the frames have another size"));
        }
        (self.bytes, self.numbers, self.ages) = (bytes, numbers, ages);
        Ok(())
    }

    /// Stacks of `len` bytes one after the other; within a stack, block by block the frames from the oldest on.
    fn gather_stacks(&self, slots: &[usize], len: usize, bytes: &mut [u8]) {
        let (size, stack) = (self.frame_bytes(), self.observation.stack());
        let stride = stack * layout::BLOCK_LEN;
        for (bytes, &slot) in bytes.chunks_exact_mut(len).zip(slots) {
            for position in 0..stack {
                let back = stack - 1 - position;
                // Frames before the start of the episode stay black.
                if back <= usize::from(self.ages[slot]) {
                    let frame = &self.bytes[(slot - back) * size..][..size];
                    layout::spread(frame, &mut bytes[position * layout::BLOCK_LEN..], stride);
                }
            }
        }
    }

    fn frame_bytes(&self) -> usize {
        match self.observation {
            ObservationSpace::Image { height, width, .. } => height * width,
            ObservationSpace::Vector { .. } => 0,
        }
    }

    fn frame_numbers(&self) -> usize {
        match self.observation {
            ObservationSpace::Image { .. } => 0,
            ObservationSpace::Vector { len } => len,
        }
    }

    fn resize(&mut self, slots: usize) {
        self.bytes.resize(slots * self.frame_bytes(), 0);
        self.numbers.resize(slots * self.frame_numbers(), 0.0);
        self.ages.resize(slots, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IMAGES: ObservationSpace = ObservationSpace::Image { height: 4, width: 8, stack: 3 };

    /// A frame of which every pixel has a value of its own.
    fn frame(number: u8) -> Vec<u8> {
        (0..32).map(|pixel| number * 32 + pixel).collect()
    }

    /// The planes of an observation, out of their blocks: [stack, height · width].
    fn planes(store: &FrameStore, slot: usize) -> Vec<Vec<u8>> {
        let Batch::Images { rows: 1, bytes } = store.gather(&[slot]) else { panic!("one image") };
        assert_eq!(bytes.len(), 2 * 48);
        let mut planes = vec![vec![0; 32]; 3];
        for (at, byte) in bytes.into_iter().enumerate() {
            let (block, plane, pixel) = (at / 48, at % 48 / 16, at % 16);
            planes[plane][pixel / 4 * 8 + block * 4 + pixel % 4] = byte;
        }
        planes
    }

    #[test]
    fn a_stack_has_the_oldest_frame_first_and_black_before_the_episode() {
        let mut store = FrameStore::new(IMAGES);
        for (number, first) in [(1, true), (2, false), (3, false), (4, false), (5, true), (6, false)] {
            store.push(Frame::Image(&frame(number)), first);
        }
        let black = vec![0; 32];
        assert_eq!(planes(&store, 0), [black.clone(), black.clone(), frame(1)]);
        assert_eq!(planes(&store, 1), [black.clone(), frame(1), frame(2)]);
        assert_eq!(planes(&store, 3), [frame(2), frame(3), frame(4)]);
        assert_eq!(planes(&store, 4), [black.clone(), black.clone(), frame(5)], "not the episode before");
        assert_eq!(planes(&store, 5), [black, frame(5), frame(6)]);
    }

    #[test]
    fn carried_and_shifted_frames_keep_their_history() {
        let mut store = FrameStore::with_slots(IMAGES, 7);
        for (slot, number) in [1, 2, 3, 4].into_iter().enumerate() {
            store.set(3 + slot, Frame::Image(&frame(number)), slot == 0);
        }
        store.carry(6, 3, 0);
        assert_eq!(planes(&store, 2), [frame(2), frame(3), frame(4)]);
        store.shift(2, 3);
        store.set(2, Frame::Image(&frame(5)), false);
        assert_eq!(planes(&store, 2), [frame(3), frame(4), frame(5)]);
        store.shift(2, 3);
        store.set(2, Frame::Image(&frame(6)), true);
        assert_eq!(planes(&store, 2), [vec![0; 32], vec![0; 32], frame(6)]);
    }

    #[test]
    fn vectors_are_gathered_in_the_order_asked_for() {
        let mut store = FrameStore::new(ObservationSpace::Vector { len: 2 });
        store.push(Frame::Vector(&[1.0, 2.0]), true);
        store.push(Frame::Vector(&[3.0, 4.0]), false);
        let numbers = vec![3.0, 4.0, 1.0, 2.0, 3.0, 4.0];
        assert_eq!(store.gather(&[1, 0, 1]), Batch::Vectors { rows: 3, numbers });
    }

    #[test]
    fn a_store_comes_back_from_a_checkpoint_and_refuses_one_of_another_size() {
        let mut store = FrameStore::new(IMAGES);
        store.push(Frame::Image(&frame(1)), true);
        store.push(Frame::Image(&frame(2)), false);
        let mut arrays = Arrays::new();
        store.save("x", &mut arrays);
        let mut other = FrameStore::with_slots(IMAGES, 2);
        other.restore("x", &mut arrays.clone()).unwrap();
        assert_eq!(other, store);
        assert!(FrameStore::with_slots(IMAGES, 3).restore("x", &mut arrays).is_err());
    }
}
