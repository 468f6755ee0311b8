//! Frame stacking: the last frames of an episode as one observation.

/// The newest frames, oldest first; frames before the start of the episode are 0.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameStack {
    planes: Vec<u8>,
    frame_len: usize,
}

impl FrameStack {
    /// An empty stack of `depth` frames with `frame_len` pixels each.
    pub fn new(frame_len: usize, depth: usize) -> Self {
        Self { planes: vec![0; frame_len * depth], frame_len }
    }

    /// Clears all frames, for the start of an episode.
    pub fn reset(&mut self) {
        self.planes.fill(0);
    }

    /// Adds the newest frame and drops the oldest. A longer frame is truncated; a shorter one leaves the rest unchanged.
    pub fn push(&mut self, frame: &[u8]) {
        if self.frame_len == 0 || self.planes.is_empty() {
            return;
        }
        self.planes.copy_within(self.frame_len.., 0);
        let newest = self.planes.len() - self.frame_len;
        let len = frame.len().min(self.frame_len);
        self.planes[newest..newest + len].copy_from_slice(&frame[..len]);
    }

    /// `depth * frame_len` pixels, the oldest frame first.
    pub fn stacked(&self) -> &[u8] {
        &self.planes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_come_oldest_first_with_zeros_before_the_start() {
        let mut stack = FrameStack::new(2, 4);
        stack.push(&[1, 1]);
        stack.push(&[2, 2]);
        assert_eq!(stack.stacked(), [0, 0, 0, 0, 1, 1, 2, 2]);
        for level in 3..=5 {
            stack.push(&[level, level]);
        }
        assert_eq!(stack.stacked(), [2, 2, 3, 3, 4, 4, 5, 5]);
        stack.reset();
        assert_eq!(stack.stacked(), [0; 8]);
    }
}
