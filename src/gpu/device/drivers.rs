//! Drivers that the environment forces upon the Vulkan loader. The loader skips those that it cannot load
//! without a reason, so the reason is found here.

use std::ffi::OsString;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use crate::files::json;

/// Variables with manifests of drivers, separated by colons. The loader uses the first that is set.
const VARIABLES: [&str; 2] = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"];

/// Manifest of a driver.
#[derive(serde::Deserialize)]
struct Manifest {
    #[serde(rename = "ICD")]
    icd: Icd,
}

#[derive(serde::Deserialize)]
struct Icd {
    library_path: PathBuf,
}

/// Describes why no driver was found: `no driver`, and what is wrong with those that the environment names.
pub(in super::super) fn none_found() -> String {
    described(|name| std::env::var_os(name))
}

fn described(variable: impl Fn(&str) -> Option<OsString>) -> String {
    let set = VARIABLES.into_iter().find_map(|name| Some((name, variable(name).filter(|v| !v.is_empty())?)));
    let Some((name, files)) = set else { return "no driver".to_owned() };
    let faults: Vec<String> = std::env::split_paths(&files).map(|path| fault(&path)).collect();
    format!("no driver ({name} names {}; correct or unset it)", faults.join(", "))
}

/// Describes a manifest and what is wrong with it.
fn fault(path: &Path) -> String {
    let shown = path.display();
    if !path.exists() {
        return format!("{shown}, which does not exist");
    }
    if path.is_dir() {
        return format!("the folder {shown}, whose drivers cannot be loaded");
    }
    let library = match json::read::<Manifest>(path, "the manifest of a driver") {
        Ok(manifest) => manifest.icd.library_path,
        Err(error) => return error.to_string(),
    };
    // A bare name is searched for by the system.
    let is_name = library.components().count() == 1;
    let library = path.parent().unwrap_or(Path::new("")).join(library);
    if !is_name && !library.exists() {
        return format!("{shown}, whose library {} does not exist", library.display());
    }
    let own = machine(Path::new("/proc/self/exe"));
    match machine(&library) {
        found @ Some(_) if !is_name && found != own => {
            format!("{shown}, whose library {} is for another processor", library.display())
        }
        _ => format!("{shown}, whose driver cannot be loaded"),
    }
}

/// Returns class and machine of an ELF file.
fn machine(path: &Path) -> Option<[u8; 3]> {
    let mut head = [0; 20];
    File::open(path).ok()?.read_exact_at(&mut head, 0).ok()?;
    head.starts_with(b"\x7fELF").then_some([head[4], head[18], head[19]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_forced_drivers_and_their_faults() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let manifest = |library: &str| {
            format!(r#"{{"file_format_version": "1.0.0", "ICD": {{"library_path": "{library}"}}}}"#)
        };
        let found = |file: &str| described(|name| (name == "VK_ICD_FILENAMES").then(|| at(file).into()));
        assert_eq!(described(|_| None), "no driver");
        assert_eq!(described(|_| Some("".into())), "no driver");
        let text = found("none.json");
        assert!(
            text.contains("(VK_ICD_FILENAMES names ") && text.contains("none.json, which does not exist"),
            "{text}"
        );
        std::fs::write(at("a.json"), manifest("./libx.so")).unwrap();
        assert!(found("a.json").contains("libx.so does not exist"), "{}", found("a.json"));
        let mut library = std::fs::read("/proc/self/exe").unwrap()[..64].to_vec();
        library[18] ^= 1;
        std::fs::write(at("libx.so"), library).unwrap();
        assert!(found("a.json").contains("is for another processor"), "{}", found("a.json"));
        std::fs::write(at("b.json"), "").unwrap();
        assert!(found("b.json").contains("found an empty file"), "{}", found("b.json"));
        std::fs::write(at("c.json"), manifest("libx.so")).unwrap();
        assert!(found("c.json").contains("cannot be loaded"), "{}", found("c.json"));
    }
}
