//! Writes the default templates of the core: `cargo run -p pskel-town --example default_templates -- FOLDER`.

use std::path::PathBuf;

use point_skeleton::error::FileError;
use point_skeleton::files::Inputs;
use point_skeleton::skeleton::{TemplateLibrary, TemplateOptions, TemplateReport};

fn main() -> Result<(), FileError> {
    let default = PathBuf::from("shipped/templates");
    let folder = std::env::args_os().nth(1).map_or(default, PathBuf::from);
    let made = (pskel_town::templates(), TemplateReport::default());
    let library = TemplateLibrary::new(Vec::new(), TemplateOptions::default(), made);
    library.write(TemplateLibrary::target(&folder, &Inputs::default())?, |_| Ok::<(), FileError>(()))
}
