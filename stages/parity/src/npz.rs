//! Reads numpy's `.npz` files: a zip archive of arrays. Only what recordings need: stored or deflated members, little
//! endian numbers, C order.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use super::CheckError;

/// Signature of the zip archive's last record, of an entry in its directory, and of a member.
const END: [u8; 4] = *b"PK\x05\x06";
const ENTRY: [u8; 4] = *b"PK\x01\x02";
const MEMBER: [u8; 4] = *b"PK\x03\x04";
const NPY: &[u8] = b"\x93NUMPY";
/// Largest member that is believed, bytes.
const MOST_BYTES: usize = 1 << 30;

/// An array as `f64`; every type that recordings hold converts exactly.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Array {
    /// Lengths of the axes.
    pub shape: Vec<usize>,
    /// Values in C order.
    pub values: Vec<f64>,
}

impl Array {
    /// Length of the first axis.
    pub fn rows(&self) -> usize {
        self.shape.first().copied().unwrap_or(0)
    }

    /// Values of one entry of the first axis.
    pub fn row(&self, index: usize) -> &[f64] {
        let width = self.shape.iter().skip(1).product::<usize>();
        &self.values[index * width..(index + 1) * width]
    }
}

/// The arrays of a file by name.
#[derive(Clone, Debug, Default)]
pub struct Npz {
    name: String,
    members: BTreeMap<String, Vec<u8>>,
}

impl Npz {
    /// Reads a file whole.
    ///
    /// # Errors
    /// It cannot be read, or it is not an archive of arrays.
    pub fn open(path: &Path) -> Result<Self, CheckError> {
        let bytes = std::fs::read(path).map_err(|source| CheckError::Io { path: path.to_owned(), source })?;
        let name = path.display().to_string();
        let members =
            members(&bytes).map_err(|message| CheckError::Format { name: name.clone(), message })?;
        Ok(Self { name, members })
    }

    /// Names of the arrays.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.members.keys().map(String::as_str)
    }

    /// One array.
    ///
    /// # Errors
    /// It is not there, or not of a type that recordings use.
    pub fn array(&self, name: &str) -> Result<Array, CheckError> {
        let fail = |message: String| CheckError::Format { name: format!("{}: `{name}`", self.name), message };
        let bytes = self.members.get(name).ok_or_else(|| fail("there is no such array".into()))?;
        npy(bytes).map_err(fail)
    }
}

fn number(bytes: &[u8], at: usize, size: usize) -> Result<usize, String> {
    let field = at.checked_add(size).and_then(|end| bytes.get(at..end));
    let field = field.ok_or_else(|| format!("cut off at byte {at}"))?;
    Ok(field.iter().rev().fold(0, |value, byte| value << 8 | usize::from(*byte)))
}

fn slice(bytes: &[u8], at: usize, len: usize) -> Result<&[u8], String> {
    at.checked_add(len).and_then(|end| bytes.get(at..end)).ok_or_else(|| format!("cut off at byte {at}"))
}

fn members(bytes: &[u8]) -> Result<BTreeMap<String, Vec<u8>>, String> {
    let end = bytes.windows(4).rposition(|window| window == END).ok_or("not a zip archive")?;
    let count = number(bytes, end + 10, 2)?;
    let mut at = number(bytes, end + 16, 4)?;
    let mut found = BTreeMap::new();
    for _ in 0..count {
        if slice(bytes, at, 4)? != ENTRY {
            return Err(format!("no directory entry at byte {at}"));
        }
        let [name_len, extra, comment] = [28, 30, 32].map(|field| number(bytes, at + field, 2));
        let name = String::from_utf8_lossy(slice(bytes, at + 46, name_len.clone()?)?).into_owned();
        let content = member(bytes, at).map_err(|message| format!("member `{name}`: {message}"))?;
        found.insert(name.trim_end_matches(".npy").to_owned(), content);
        at += 46 + name_len? + extra? + comment?;
    }
    Ok(found)
}

fn member(bytes: &[u8], entry: usize) -> Result<Vec<u8>, String> {
    let (method, packed) = (number(bytes, entry + 10, 2)?, number(bytes, entry + 20, 4)?);
    let (size, at) = (number(bytes, entry + 24, 4)?, number(bytes, entry + 42, 4)?);
    if slice(bytes, at, 4)? != MEMBER {
        return Err(format!("nothing at byte {at}"));
    }
    let data = at + 30 + number(bytes, at + 26, 2)? + number(bytes, at + 28, 2)?;
    let data = slice(bytes, data, packed)?;
    if size > MOST_BYTES {
        return Err(format!("{size} bytes, expected at most {MOST_BYTES}"));
    }
    let content = match method {
        0 => data.to_vec(),
        8 => {
            let mut content = Vec::with_capacity(size);
            let mut stream = flate2::read::DeflateDecoder::new(data).take(size as u64);
            stream.read_to_end(&mut content).map_err(|error| error.to_string())?;
            content
        }
        other => return Err(format!("packing method {other}, expected 0 (stored) or 8 (deflated)")),
    };
    if content.len() == size { Ok(content) } else { Err(format!("{} of {size} bytes", content.len())) }
}

fn npy(bytes: &[u8]) -> Result<Array, String> {
    if slice(bytes, 0, NPY.len())? != NPY {
        return Err("not a numpy array".into());
    }
    let wide = bytes.get(6).is_some_and(|version| *version >= 2);
    let (field, at) = if wide { (4, 12) } else { (2, 10) };
    let len = number(bytes, 8, field)?;
    let header = String::from_utf8_lossy(slice(bytes, at, len)?).into_owned();
    if header.contains("'fortran_order': True") {
        return Err("in Fortran order, expected C order".into());
    }
    let shape = shape(&header).ok_or_else(|| format!("no shape in `{}`", header.trim()))?;
    let data = slice(bytes, at + len, bytes.len() - at - len)?;
    let kind = header.split("'descr': '").nth(1).and_then(|rest| rest.split('\'').next()).unwrap_or("");
    let values = values(kind, data)?;
    let wanted = shape.iter().try_fold(1usize, |n, axis| n.checked_mul(*axis));
    if wanted == Some(values.len()) {
        Ok(Array { shape, values })
    } else {
        Err(format!("{} values for shape {shape:?}", values.len()))
    }
}

fn shape(header: &str) -> Option<Vec<usize>> {
    let inside = header.split("'shape': (").nth(1)?.split(')').next()?;
    let axes = inside.split(',').map(str::trim).filter(|axis| !axis.is_empty());
    axes.map(|axis| axis.parse().ok()).collect()
}

fn values(kind: &str, data: &[u8]) -> Result<Vec<f64>, String> {
    Ok(match kind {
        "|u1" => data.iter().map(|byte| f64::from(*byte)).collect(),
        "<u2" => data.chunks_exact(2).map(|b| f64::from(u16::from_le_bytes([b[0], b[1]]))).collect(),
        "<i4" => {
            data.chunks_exact(4).map(|b| f64::from(i32::from_le_bytes([b[0], b[1], b[2], b[3]]))).collect()
        }
        "<i8" => data.as_chunks().0.iter().map(|b| i64::from_le_bytes(*b) as f64).collect(),
        "<f4" => {
            data.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))).collect()
        }
        "<f8" => data.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect(),
        other => return Err(format!("numbers of type `{other}`, expected u1, u2, i4, i8, f4 or f8")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn array_bytes(kind: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn numbers_and_shapes_are_read() {
        let data: Vec<u8> = [1.5f32, -2.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let array = npy(&array_bytes("<f4", "(1, 2)", &data)).unwrap();
        assert_eq!(array, Array { shape: vec![1, 2], values: vec![1.5, -2.0] });
        assert_eq!(npy(&array_bytes("|u1", "(3,)", &[1, 2, 255])).unwrap().values, [1.0, 2.0, 255.0]);
    }

    #[test]
    fn garbled_arrays_and_archives_are_refused() {
        assert!(npy(b"\x93NUMPY").is_err());
        assert!(npy(&array_bytes("<f4", "(3,)", &[0; 8])).unwrap_err().contains("2 values"));
        assert!(npy(&array_bytes("<c8", "(1,)", &[0; 8])).unwrap_err().contains("<c8"));
        assert!(members(b"PK\x05\x06").is_err());
        assert!(members(b"hello").is_err());
    }
}
