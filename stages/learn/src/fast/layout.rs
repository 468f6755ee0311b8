//! Frames in blocks of 4×4 pixels.
//!
//! The first convolution (8×8, stride 4, few input channels) is the worst case of a convolution library. Where each
//! block of 4×4 pixels becomes 16 channels, the same function is a 2×2 convolution with stride 1 over 16 times the
//! channels. Frames are put into blocks once, when they arrive; the kernel is put into blocks at each step (8,192 numbers),
//! and takes over the division of bytes by 255, which would otherwise be a pass over the whole batch.

use tch::Tensor;

use super::vector::widest;

/// Pixels along each side of a block: the first convolution's stride.
pub const BLOCK: usize = 4;

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

/// The kernel `[filters, channels, 8, 8]` for inputs in 0..1 as the kernel `[filters, channels·16, 2, 2]` for blocks of
/// bytes.
pub fn block_kernel(kernel: &Tensor) -> Tensor {
    let size = kernel.size();
    let (filters, channels, block) = (size[0], size[1], BLOCK as i64);
    let (rows, columns) = (size[2] / block, size[3] / block);
    let blocks = kernel.view([filters, channels, rows, block, columns, block]).permute([0, 1, 3, 5, 2, 4]);
    blocks.reshape([filters, channels * block * block, rows, columns]) * (1.0 / 255.0)
}

/// Numbers in a block.
pub const BLOCK_LEN: usize = BLOCK * BLOCK;

widest! {
    /// Bytes as numbers, 0..=255.
    pub fn widen(bytes: &[u8], numbers: &mut [f32]) = widen_in
}

#[inline(always)]
fn widen_in<const ROWS: usize>(bytes: &[u8], numbers: &mut [f32]) {
    for (number, byte) in numbers.iter_mut().zip(bytes) {
        *number = f32::from(*byte);
    }
}

/// The bytes of a frame in blocks: each block `stride` after the one before it.
pub fn spread(bytes: &[u8], spread: &mut [u8], stride: usize) {
    for (block, spread) in bytes.as_chunks::<BLOCK_LEN>().0.iter().zip(spread.chunks_mut(stride)) {
        spread[..BLOCK_LEN].copy_from_slice(block);
    }
}

widest! {
    /// As [`spread`], as bfloat16 numbers, which hold 0..=255 exactly: the upper halves of the `f32` bits.
    pub fn widen_short(bytes: &[u8], numbers: &mut [u16], stride: usize) = widen_short_in
}

#[inline(always)]
fn widen_short_in<const ROWS: usize>(bytes: &[u8], numbers: &mut [u16], stride: usize) {
    for (block, numbers) in bytes.chunks_exact(BLOCK_LEN).zip(numbers.chunks_mut(stride)) {
        for (number, byte) in numbers[..BLOCK_LEN].iter_mut().zip(block) {
            *number = (f32::from(*byte).to_bits() >> 16) as u16;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fast::memory;
    use tch::{Kind, Tensor};

    #[test]
    fn the_convolution_over_blocks_equals_the_one_over_pixels() {
        crate::fast::prepare();
        let (channels, side) = (2_usize, 36_usize);
        let bytes: Vec<u8> = (0..channels * side * side).map(|at| (at * at % 251) as u8).collect();
        let kernel: Vec<f32> = (0..3 * channels * 64).map(|at| (at as f32 * 0.37).sin()).collect();
        let kernel = Tensor::from_slice(&kernel).view([3, channels as i64, 8, 8]);
        let plain = Tensor::from_slice(&bytes).view([1, channels as i64, side as i64, side as i64]);
        let plain = (plain.to_kind(Kind::Float) / 255.0).conv2d(&kernel, None::<Tensor>, 4, 0, 1, 1);
        let mut blocked = vec![0; bytes.len()];
        for (frame, blocked) in bytes.chunks(side * side).zip(blocked.chunks_mut(side * side)) {
            block_frame(frame, (side, side), blocked);
        }
        let (mut stacked, mut numbers) = (vec![0; blocked.len()], vec![0.0; blocked.len()]);
        for (plane, frame) in blocked.chunks(side * side).enumerate() {
            spread(frame, &mut stacked[plane * BLOCK_LEN..], channels * BLOCK_LEN);
        }
        widen(&stacked, &mut numbers);
        let input = Tensor::from_slice(&numbers).view([1, 9, 9, 16 * channels as i64]).permute([0, 3, 1, 2]);
        let found = input.conv2d(&block_kernel(&kernel), None::<Tensor>, 1, 0, 1, 1);
        assert_eq!(found.size(), plain.size());
        let worst = memory::values(&found.contiguous())
            .iter()
            .zip(memory::values(&plain.contiguous()))
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        assert!(worst < 1e-5, "{worst}");
    }
}
