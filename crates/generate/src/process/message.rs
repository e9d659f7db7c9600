use std::borrow::Cow;
use std::collections::HashMap;

use pskel_sim::peer::ProtocolError;
use safetensors::tensor::{Dtype, SafeTensorError, SafeTensors, TensorView, View, serialize};

use crate::DenoiserError;

/// Maximum length of quoted texts of a denoiser, characters.
const SHOWN: usize = 200;

/// A tensor to send, as consecutive parts (one per frame).
pub(crate) struct Values<'a> {
    pub(crate) shape: Vec<usize>,
    pub(crate) parts: Vec<&'a [f32]>,
}

impl View for Values<'_> {
    fn dtype(&self) -> Dtype {
        Dtype::F32
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        let mut bytes = Vec::with_capacity(self.data_len());
        for part in &self.parts {
            bytes.extend(part.iter().flat_map(|value| value.to_le_bytes()));
        }
        bytes.into()
    }

    fn data_len(&self) -> usize {
        self.parts.iter().map(|part| size_of_val(*part)).sum()
    }
}

/// Serializes texts and tensors as a message.
pub(crate) fn message<V: View>(
    texts: impl IntoIterator<Item = (&'static str, String)>,
    tensors: impl IntoIterator<Item = (&'static str, V)>,
) -> Result<Vec<u8>, DenoiserError> {
    serialized(texts, tensors).map_err(|error| DenoiserError::Network(error.into()))
}

/// Serializes texts and tensors.
pub(crate) fn serialized<V: View>(
    texts: impl IntoIterator<Item = (&'static str, String)>,
    tensors: impl IntoIterator<Item = (&'static str, V)>,
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
