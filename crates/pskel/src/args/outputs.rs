//! Output folder and files of a command; files are opened together before any work.

use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::{PathBufValueParser, TypedValueParser};
use point_skeleton::files::{FileKind, Inputs, OutputFile, is_one_file, resolved_output};

use crate::WrongUsage;

/// An output folder.
#[derive(Clone, Debug, Args)]
pub(crate) struct FolderArgs {
    /// Folder to write: a new or empty one, or one with an earlier result of this command, which is replaced
    #[arg(long, value_name = "DIR", value_parser = output_folder())]
    pub(crate) out: PathBuf,
}

/// Argument parser for an output folder.
pub(crate) fn output_folder() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().map(resolved_output)
}

/// An option with the file to write, if it is given.
pub(crate) type FileOption<'a> = (&'static str, Option<&'a Path>, FileKind);

/// Opens the files of options, in order. `folder` is the output folder of the same run, if it has one.
///
/// # Errors
/// Fails if two options name one file, if a file is in `folder`, or as [`OutputFile::open`].
pub(crate) fn open<const N: usize>(
    options: [FileOption<'_>; N],
    inputs: &Inputs,
    folder: Option<&Path>,
) -> anyhow::Result<[Option<OutputFile>; N]> {
    check_different(options.iter().filter_map(|(name, path, _)| Some((*name, (*path)?))))?;
    let mut files = options.map(|_| None);
    for (file, (_, path, kind)) in files.iter_mut().zip(options) {
        let Some(path) = path else { continue };
        folder.map_or(Ok(()), |folder| OutputFile::check_outside(path, folder))?;
        *file = Some(OutputFile::open(path, kind, inputs)?);
    }
    Ok(files)
}

/// Checks that options name different files.
pub(crate) fn check_different<'a>(
    given: impl IntoIterator<Item = (&'static str, &'a Path)>,
) -> Result<(), WrongUsage> {
    let given: Vec<(&str, &Path)> = given.into_iter().collect();
    for (place, (name, path)) in given.iter().enumerate() {
        if let Some((other, _)) = given[..place].iter().find(|(_, other)| is_one_file(other, path)) {
            let message = format!("expected two files for {other} and {name}, found {}", path.display());
            return Err(WrongUsage(message));
        }
    }
    Ok(())
}
