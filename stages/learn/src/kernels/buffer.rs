//! Memory for numbers, as the kernels like it.
#![allow(unsafe_code)]

use std::cell::Cell;
use std::ops::{Deref, DerefMut};

/// Bytes of a cache line: a vector that begins at one is read at once, another one in two parts.
const CACHE_LINE: usize = 64;

/// Bytes of a huge page of x86-64.
const HUGE_PAGE: usize = 2 << 20;

/// Numbers that begin at a cache line. Large ones lie in huge pages where the system gives them: with pages of 4 KiB a
/// pass over 9 MB waits for the translation of 2,200 addresses, which halves the speed of an optimizer's step.
///
/// It dereferences to a slice.
#[derive(Debug, Default)]
pub struct Buffer {
    /// Longer than needed, so that a part of it is aligned.
    room: Vec<f32>,
    start: usize,
    len: usize,
}

impl Buffer {
    /// So many zeros.
    pub fn zeros(len: usize) -> Self {
        let bytes = len * size_of::<f32>();
        let align = if bytes >= HUGE_PAGE { HUGE_PAGE } else { CACHE_LINE };
        let mut room: Vec<f32> =
            Vec::with_capacity((bytes.next_multiple_of(align) + align) / size_of::<f32>());
        let start = room.as_ptr().align_offset(align);
        if align == HUGE_PAGE {
            use_huge_pages(room.as_mut_ptr().wrapping_add(start).cast(), bytes.next_multiple_of(align));
        }
        room.resize(start + len, 0.0);
        Self { room, start, len }
    }
}

thread_local! {
    static SCRATCH: Cell<Buffer> = Cell::default();
}

/// Calls `call` with room for `len` numbers, which hold anything. The room is kept from call to call: memory that is new
/// each time costs more than what small layers compute.
pub fn with_scratch<T>(len: usize, call: impl FnOnce(&mut [f32]) -> T) -> T {
    let mut scratch = SCRATCH.take();
    if scratch.len < len {
        scratch = Buffer::zeros(len);
    }
    let result = call(&mut scratch[..len]);
    SCRATCH.set(scratch);
    result
}

/// The whole pages from `start` on have not been touched yet.
fn use_huge_pages(start: *mut libc::c_void, bytes: usize) {
    #[cfg(target_os = "linux")]
    // SAFETY: the memory belongs to the caller, and the advice changes none of its contents. A system without huge pages
    // gives an error, after which all is as before.
    unsafe {
        libc::madvise(start, bytes, libc::MADV_HUGEPAGE);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (start, bytes);
}

impl Clone for Buffer {
    fn clone(&self) -> Self {
        Self::from(&self[..])
    }
}

impl From<&[f32]> for Buffer {
    fn from(numbers: &[f32]) -> Self {
        let mut buffer = Self::zeros(numbers.len());
        buffer.copy_from_slice(numbers);
        buffer
    }
}

impl PartialEq for Buffer {
    fn eq(&self, other: &Self) -> bool {
        self[..] == other[..]
    }
}

impl Deref for Buffer {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.room[self.start..self.start + self.len]
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.room[self.start..self.start + self.len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_buffer_is_aligned_and_holds_what_it_is_given() {
        for len in [0, 1, 100, HUGE_PAGE / 4 - 1, HUGE_PAGE / 4, HUGE_PAGE + 77] {
            let numbers: Vec<f32> = (0..len).map(|at| at as f32).collect();
            let buffer = Buffer::from(&numbers[..]);
            assert_eq!(buffer.as_ptr().align_offset(CACHE_LINE), 0);
            assert!(buffer[..] == numbers[..] && buffer.clone() == buffer);
            assert!(Buffer::zeros(len).iter().all(|number| *number == 0.0));
        }
    }
}
