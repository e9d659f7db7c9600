use std::borrow::Cow;
use std::collections::HashMap;

use pskel_sim::peer::ProtocolError;
use safetensors::tensor::{Dtype, SafeTensorError, SafeTensors, TensorView, View, serialize};

use crate::DenoiserError;

/// Maximum length of quoted texts of a denoiser, characters.
const SHOWN: usize = 200;

/// A tensor to send: little-endian numbers.
pub(crate) struct Tensor {
    pub(crate) dtype: Dtype,
    pub(crate) shape: Vec<usize>,
    pub(crate) bytes: Vec<u8>,
}

impl View for Tensor {
    fn dtype(&self) -> Dtype {
        self.dtype
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.bytes)
    }

    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}

impl Tensor {
    pub(crate) fn of_f64(shape: Vec<usize>, values: impl Iterator<Item = f64>) -> Self {
        Self { dtype: Dtype::F64, shape, bytes: values.flat_map(f64::to_le_bytes).collect() }
    }

    pub(crate) fn of_f32(shape: Vec<usize>, values: impl Iterator<Item = f32>) -> Self {
        Self { dtype: Dtype::F32, shape, bytes: values.flat_map(f32::to_le_bytes).collect() }
    }

    pub(crate) fn of_bytes(shape: Vec<usize>, bytes: Vec<u8>) -> Self {
        Self { dtype: Dtype::U8, shape, bytes }
    }
}

/// Serializes texts and tensors as a message.
pub(crate) fn message(
    texts: impl IntoIterator<Item = (&'static str, String)>,
    tensors: impl IntoIterator<Item = (&'static str, Tensor)>,
) -> Result<Vec<u8>, DenoiserError> {
    serialized(texts, tensors).map_err(|error| DenoiserError::Network(error.into()))
}

/// Serializes texts and tensors.
pub(crate) fn serialized(
    texts: impl IntoIterator<Item = (&'static str, String)>,
    tensors: impl IntoIterator<Item = (&'static str, Tensor)>,
) -> Result<Vec<u8>, SafeTensorError> {
    let texts = texts.into_iter().map(|(name, text)| (name.to_owned(), text)).collect();
    serialize(tensors, Some(texts))
}

/// A parsed message.
pub(crate) struct Answer<'a> {
    pub(crate) texts: HashMap<String, String>,
    pub(crate) tensors: SafeTensors<'a>,
}

impl<'a> Answer<'a> {
    pub(crate) fn read(bytes: &'a [u8]) -> Result<Self, ProtocolError> {
        let wrong = |error: SafeTensorError| {
            ProtocolError::new(
                "a safetensors file",
                format!("{} bytes: {}", bytes.len(), shown(&error.to_string())),
            )
        };
        let (_, head) = SafeTensors::read_metadata(bytes).map_err(wrong)?;
        let texts = head.metadata().clone().unwrap_or_default();
        Ok(Self { texts, tensors: SafeTensors::deserialize(bytes).map_err(wrong)? })
    }

    /// Returns a tensor of a type and a shape.
    pub(crate) fn tensor(
        &self,
        name: &str,
        (dtype, why): (Dtype, &str),
        sizes: &[usize],
    ) -> Result<TensorView<'_>, ProtocolError> {
        let tensor = self.tensors.tensor(name).map_err(|_| {
            let mut names = self.tensors.names();
            names.sort_unstable();
            let found = if names.is_empty() { "none".to_owned() } else { shown(&names.join(", ")) };
            ProtocolError::new(format!("a tensor `{name}`"), found)
        })?;
        if tensor.dtype() != dtype {
            let expected = format!("`{name}` as {dtype}{why}");
            return Err(ProtocolError::new(expected, tensor.dtype().to_string()));
        }
        if tensor.shape() != sizes {
            let found = shown(&format!("{:?}", tensor.shape()));
            return Err(ProtocolError::new(format!("`{name}` of {sizes:?}"), found));
        }
        Ok(tensor)
    }

    /// Returns a text in quotes, or `none` if it is absent.
    pub(crate) fn quoted(&self, name: &str) -> String {
        self.texts.get(name).map_or_else(|| "none".to_owned(), |text| format!("{:?}", shown(text)))
    }
}

/// Truncates a text that may be long.
pub(crate) fn shown(text: &str) -> String {
    text.chars().take(SHOWN).collect()
}
