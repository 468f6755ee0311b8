//! The weights file: safetensors, with a description of the network as JSON in the metadata.
//!
//! There is only one metadata key: the safetensors crate writes its metadata from a hash map, so that with two keys, equal
//! weights could give different bytes.

use std::collections::HashMap;
use std::path::Path;

use dril_stage_api::StageError;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Serialize, de::DeserializeOwned};

use super::Parameters;

/// The metadata key of the description.
const KEY: &str = "dril";

/// The weights as a file: `about` describes the network and is returned by [`read`].
///
/// # Errors
/// The description cannot be serialised.
pub fn to_bytes<A: Serialize>(about: &A, params: &Parameters) -> Result<Vec<u8>, StageError> {
    let about = serde_json::to_string(about).map_err(StageError::failed)?;
    let bytes: Vec<Vec<u8>> = params.ids().map(|id| little_endian(params.slice(id))).collect();
    let views = params.ids().zip(&bytes).map(|(id, bytes)| {
        let spec = params.spec(id);
        Ok((
            spec.name.as_str(),
            TensorView::new(Dtype::F32, spec.shape.clone(), bytes).map_err(StageError::failed)?,
        ))
    });
    let views = views.collect::<Result<Vec<_>, StageError>>()?;
    let metadata = HashMap::from([(KEY.to_owned(), about)]);
    safetensors::serialize(views, Some(metadata)).map_err(StageError::failed)
}

/// Weights read from a file.
#[derive(Debug)]
pub struct Weights {
    bytes: Vec<u8>,
    about: String,
}

/// Reads a weights file.
///
/// # Errors
/// The file cannot be read, is not a safetensors file, or was not written by this program.
pub fn read(port: &str, path: &Path) -> Result<Weights, StageError> {
    let bytes = std::fs::read(path).map_err(StageError::io("cannot read", path))?;
    let broken = |error| StageError::input(port, path, format!("not a safetensors file: {error}"));
    let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(broken)?;
    SafeTensors::deserialize(&bytes).map_err(broken)?;
    let about = metadata.metadata().as_ref().and_then(|map| map.get(KEY)).cloned();
    let about = about.ok_or_else(|| {
        StageError::input(
            port,
            path,
            format!("its metadata has no `{KEY}`, expected weights of this program"),
        )
    })?;
    Ok(Weights { bytes, about })
}

impl Weights {
    /// The description that was given to [`to_bytes`].
    ///
    /// # Errors
    /// It describes something else.
    pub fn about<A: DeserializeOwned>(&self, port: &str, path: &Path) -> Result<A, StageError> {
        serde_json::from_str(&self.about).map_err(|error| {
            StageError::input(port, path, format!("holds other weights than expected here: {error}"))
        })
    }

    /// Copies the values into a network of the same layout.
    ///
    /// # Errors
    /// A parameter is missing, has another shape or type, is unknown, or is not finite.
    pub fn fill(&self, port: &str, path: &Path, params: &mut Parameters) -> Result<(), StageError> {
        let wrong = |message: String| StageError::input(port, path, message);
        let file = SafeTensors::deserialize(&self.bytes).map_err(|error| wrong(error.to_string()))?;
        if file.len() != params.len() {
            return Err(wrong(format!("has {} tensors, expected {}", file.len(), params.len())));
        }
        for id in params.ids() {
            let spec = params.spec(id).clone();
            let view =
                file.tensor(&spec.name).map_err(|_| wrong(format!("has no tensor `{}`", spec.name)))?;
            if view.shape() != spec.shape || view.dtype() != Dtype::F32 {
                let seen = format!("{:?} {:?}", view.dtype(), view.shape());
                return Err(wrong(format!("`{}` is {seen}, expected F32 {:?}", spec.name, spec.shape)));
            }
            let values: Vec<f32> =
                view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
            if values.iter().any(|value| !value.is_finite()) {
                return Err(wrong(format!("`{}` holds a value that is not finite", spec.name)));
            }
            params.slice_mut(id).copy_from_slice(&values);
        }
        Ok(())
    }
}

fn little_endian(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}
