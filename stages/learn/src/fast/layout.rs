//! The first convolution over blocks of 4×4 pixels, for libtorch; see [`crate::kernels::layout`].
//!
//! The kernel is put into blocks at each step (8,192 numbers), and takes over the division of bytes by 255, which would
//! otherwise be a pass over the whole batch.

use tch::Tensor;

use crate::kernels::layout::{BLOCK, BLOCK_LEN};

/// The kernel `[filters, channels, 8, 8]` for inputs in 0..1 as the kernel `[filters, channels·16, 2, 2]` for blocks of
/// bytes.
pub fn block_kernel(kernel: &Tensor) -> Tensor {
    let size = kernel.size();
    let (filters, channels, block) = (size[0], size[1], BLOCK as i64);
    let (rows, columns) = (size[2] / block, size[3] / block);
    let blocks = kernel.view([filters, channels, rows, block, columns, block]).permute([0, 1, 3, 5, 2, 4]);
    blocks.reshape([filters, channels * block * block, rows, columns]) * (1.0 / 255.0)
}

/// As [`spread`](crate::kernels::layout::spread), as bfloat16 numbers, which hold 0..=255 exactly: the upper halves of
/// the `f32` bits.
pub fn widen_short(bytes: &[u8], numbers: &mut [u16], stride: usize) {
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
    use crate::kernels::layout::{block_frame, spread, widen};
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
