use std::borrow::Cow;
use std::collections::HashMap;

use pskel_sim::peer::ProtocolError;
use safetensors::tensor::{Dtype, SafeTensorError, SafeTensors, View, serialize};

use crate::DenoiserError;

/// Maximum length of quoted texts of a denoiser, characters.
const SHOWN: usize = 200;

/// A tensor to send, as consecutive parts (one per frame).
pub(super) struct Values<'a> {
    pub(super) shape: Vec<usize>,
    pub(super) parts: Vec<&'a [f32]>,
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
pub(super) fn message<'a>(
    texts: impl IntoIterator<Item = (&'static str, String)>,
    tensors: impl IntoIterator<Item = (&'static str, Values<'a>)>,
) -> Result<Vec<u8>, DenoiserError> {
    let texts = texts.into_iter().map(|(name, text)| (name.to_owned(), text)).collect();
    serialize(tensors, Some(texts)).map_err(|error| DenoiserError::Network(error.into()))
}

/// A parsed message.
pub(super) struct Answer<'a> {
    pub(super) texts: HashMap<String, String>,
    pub(super) tensors: SafeTensors<'a>,
}

impl<'a> Answer<'a> {
    pub(super) fn read(bytes: &'a [u8]) -> Result<Self, ProtocolError> {
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

    /// Returns a text in quotes, or `none` if it is absent.
    pub(super) fn quoted(&self, name: &str) -> String {
        self.texts.get(name).map_or_else(|| "none".to_owned(), |text| format!("{:?}", shown(text)))
    }
}

/// Truncates a text that may be long.
pub(super) fn shown(text: &str) -> String {
    text.chars().take(SHOWN).collect()
}
