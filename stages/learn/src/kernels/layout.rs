//! Frames in blocks of 4×4 pixels, bytes as numbers, and transposition.
//!
//! The first convolution (8×8, stride 4, few input channels) is the worst case of a convolution library. Where each
//! block of 4×4 pixels becomes 16 channels, the same function is a 2×2 convolution with stride 1 over 16 times the
//! channels. Frames are put into blocks once, when they arrive.

use super::vector::{Kernel, LANES, Simd, run, store_some};

/// Pixels along each side of a block: the first convolution's stride.
pub const BLOCK: usize = 4;

/// Numbers in a block.
pub const BLOCK_LEN: usize = BLOCK * BLOCK;

/// Writes a frame of `height`×`width` bytes as blocks: `[height/4, width/4, 16]`, the pixels of a block row by row.
pub fn block_frame(frame: &[u8], (_, width): (usize, usize), blocked: &mut [u8]) {
    let line = width * BLOCK;
    for (rows, blocks) in frame.chunks_exact(line).zip(blocked.chunks_exact_mut(line)) {
        for (y, row) in rows.chunks_exact(width).enumerate() {
            for (pixels, block) in row.chunks_exact(BLOCK).zip(blocks.chunks_exact_mut(BLOCK * BLOCK)) {
                block[y * BLOCK..][..BLOCK].copy_from_slice(pixels);
            }
        }
    }
}

/// The bytes of a frame in blocks: each block `stride` after the one before it.
pub fn spread(bytes: &[u8], spread: &mut [u8], stride: usize) {
    for (block, spread) in bytes.as_chunks::<BLOCK_LEN>().0.iter().zip(spread.chunks_mut(stride)) {
        spread[..BLOCK_LEN].copy_from_slice(block);
    }
}

/// Bytes as numbers, 0..=255.
pub fn widen(bytes: &[u8], numbers: &mut [f32]) {
    run(Widen { bytes, numbers });
}

struct Widen<'a> {
    bytes: &'a [u8],
    numbers: &'a mut [f32],
}

impl Kernel for Widen<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for (bytes, numbers) in self.bytes.chunks(LANES).zip(self.numbers.chunks_mut(LANES)) {
            let widened = match bytes.first_chunk() {
                Some(bytes) => simd.bytes(bytes),
                None => {
                    let mut padded = [0; LANES];
                    padded[..bytes.len()].copy_from_slice(bytes);
                    simd.bytes(&padded)
                }
            };
            store_some(simd, widened, numbers);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_become_the_same_numbers() {
        let bytes: Vec<u8> = (0..=255).chain(0..7).collect();
        let mut numbers = vec![-1.0; bytes.len()];
        widen(&bytes, &mut numbers);
        assert!(numbers.iter().zip(&bytes).all(|(number, byte)| *number == f32::from(*byte)));
    }

    #[test]
    fn a_frame_is_cut_into_blocks_and_spread() {
        let frame: Vec<u8> = (0..32).collect();
        let mut blocked = vec![0; 32];
        block_frame(&frame, (4, 8), &mut blocked);
        assert_eq!(blocked[..16], [0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27]);
        let mut spread_out = [0; 64];
        spread(&blocked, &mut spread_out[16..], 32);
        assert_eq!(spread_out[16..32], blocked[..16]);
        assert_eq!(spread_out[48..], blocked[16..]);
    }
}
