//! Live training curves for TensorBoard: event files in the folder given by `run --tensorboard`.
//!
//! They are not results: they contain wall-clock times, and existing files are kept. A file is a sequence of records, each with its length and two checksums (TensorFlow's `record_writer.h`); each record is an `Event` of
//! TensorFlow's `event.proto`, of which four fields are enough.

use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use dril_stage_api::{Ctx, StageError};

use super::log::TrainingLog;

/// Writes the rows of a training log as curves; does nothing if not requested.
#[derive(Debug)]
pub struct Curves(Option<Open>);

#[derive(Debug)]
struct Open {
    file: File,
    /// Time and step of the last row.
    last: Option<(Instant, u64)>,
}

impl Curves {
    /// Curves in the stage's folder for this run, or none.
    ///
    /// # Errors
    /// The folder or its file cannot be created.
    pub fn open(ctx: &Ctx<'_>) -> Result<Self, StageError> {
        let Some(folder) = ctx.curves() else { return Ok(Self(None)) };
        std::fs::create_dir_all(folder).map_err(StageError::io("cannot make", folder))?;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        // The name that TensorBoard looks for; a stage that continues after a stop adds a file.
        let name = format!("events.out.tfevents.{:010}.{:09}.dril-pipe", now.as_secs(), now.subsec_nanos());
        let path = folder.join(name);
        let file = File::create(&path).map_err(StageError::io("cannot make", &path))?;
        let mut open = Open { file, last: None };
        open.write(&event(0, Content::Version("brain.Event:2")), &path)?;
        Ok(Self(Some(open)))
    }

    /// Writes the log's last row, at a step. Empty cells are left out; steps per second are added.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn last_row(&mut self, step: u64, log: &TrainingLog) -> Result<(), StageError> {
        let Some(open) = &mut self.0 else { return Ok(()) };
        let mut scalars: Vec<(&str, f32)> =
            log.columns().iter().filter_map(|name| Some((name.as_str(), log.last(name)? as f32))).collect();
        let now = Instant::now();
        if let Some((then, before)) = open.last.replace((now, step)) {
            let speed = step.saturating_sub(before) as f64 / (now - then).as_secs_f64().max(1e-9);
            scalars.push(("steps_per_second", speed as f32));
        }
        open.write(&event(step, Content::Scalars(&scalars)), Path::new("the event file"))
    }
}

impl Open {
    fn write(&mut self, event: &[u8], path: &Path) -> Result<(), StageError> {
        self.file.write_all(&record(event)).map_err(StageError::io("cannot write", path))
    }
}

enum Content<'a> {
    /// The first event of a file.
    Version(&'a str),
    Scalars(&'a [(&'a str, f32)]),
}

/// A record: length, its checksum, the data, their checksum; all numbers little-endian.
fn record(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    let mut record = Vec::with_capacity(data.len() + 16);
    record.extend(length);
    record.extend(masked(&length).to_le_bytes());
    record.extend(data);
    record.extend(masked(data).to_le_bytes());
    record
}

/// TensorFlow's masked CRC-32C: a checksum of data that hold checksums themselves would be weak.
fn masked(data: &[u8]) -> u32 {
    crc32c::crc32c(data).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// An `Event` in protocol buffers' encoding.
fn event(step: u64, content: Content<'_>) -> Vec<u8> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
    let mut event = Vec::new();
    // 1: wall_time, a double; 2: step, a varint.
    event.push(1 << 3 | 1);
    event.extend(now.to_le_bytes());
    event.push(2 << 3);
    varint(step, &mut event);
    match content {
        Content::Version(text) => field(3, text.as_bytes(), &mut event),
        Content::Scalars(scalars) => {
            let mut summary = Vec::new();
            for (name, value) in scalars {
                // Summary.Value: 1: tag, a text; 2: simple_value, a float.
                let mut one = Vec::new();
                field(1, name.as_bytes(), &mut one);
                one.push(2 << 3 | 5);
                one.extend(value.to_le_bytes());
                field(1, &one, &mut summary);
            }
            field(5, &summary, &mut event);
        }
    }
    event
}

/// A field of bytes with their length.
fn field(number: u8, bytes: &[u8], into: &mut Vec<u8>) {
    into.push(number << 3 | 2);
    varint(bytes.len() as u64, into);
    into.extend(bytes);
}

/// Seven bits a byte, the lowest first; the highest bit says that more follow.
fn varint(mut value: u64, into: &mut Vec<u8>) {
    while value >= 0x80 {
        into.push(value as u8 | 0x80);
        value >>= 7;
    }
    into.push(value as u8);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_carries_checksums_as_tensorflow_computes_them() {
        // CRC-32C of "123456789" is 0xe3069283 (RFC 3720); the mask rotates it by 15 bits and adds a constant.
        assert_eq!(crc32c::crc32c(b"123456789"), 0xe306_9283);
        let made = record(b"123456789");
        assert_eq!(made.len(), 8 + 4 + 9 + 4);
        assert_eq!(made[..8], 9_u64.to_le_bytes());
        let sum = u32::from_le_bytes([made[21], made[22], made[23], made[24]]);
        assert_eq!(sum.wrapping_sub(0xa282_ead8).rotate_left(15), 0xe306_9283);
    }

    #[test]
    fn an_event_is_read_back_field_by_field() {
        let made = event(300, Content::Scalars(&[("score", 1.5)]));
        assert_eq!(made[0], 0x09);
        assert_eq!(made[9..12], [0x10, 0xac, 0x02], "step 300 as a varint");
        assert_eq!(made[12..16], [0x2a, 14, 0x0a, 12], "a summary of 14 bytes with a value of 12");
        assert_eq!(made[16..23], *b"\x0a\x05score");
        assert_eq!(made[23], 0x15);
        assert_eq!(made[24..], 1.5_f32.to_le_bytes());
    }
}
