//! Texts for the prompt.

use std::path::PathBuf;

use clap::Args;
use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::error::FileError;

/// Annotations of a recording.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct PromptArgs {
    /// Annotations for the prompt in meta.json: {"weather": "Sunny", "city": "Boston"}, both optional
    #[arg(long, value_name = "F.json")]
    pub(crate) annotations: Option<PathBuf>,
}

impl PromptArgs {
    /// Reads the parts of the prompt.
    pub(crate) fn read(&self) -> Result<PromptParts, FileError> {
        self.annotations.as_deref().map_or(Ok(PromptParts::default()), PromptParts::read)
    }
}
