//! Compiles every shader in a package's `glsl/` to SPIR-V and generates its reflection for Rust; for build
//! scripts.
//!
//! # How it works
//! naga parses GLSL (`x.vert`, `x.frag`, `x.comp`) or WGSL (`x.wgsl`), validates, and emits SPIR-V for Vulkan
//! 1.1. `shaders.rs` in `OUT_DIR` then contains one module per shader: the words, descriptor bindings, vertex
//! inputs, the push-constant size, integer constants, and for each named struct its size and the offset of
//! each member, which the Rust structs are asserted against. A shader error fails the build with file and
//! line.
#![allow(clippy::print_stdout, clippy::print_stderr)] // a build script's interface to cargo

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use naga::back::pipeline_constants::process_overrides;
use naga::back::spv;
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use naga::{AddressSpace, Binding, Expression, Literal, Module, ScalarKind, ShaderStage, TypeInner};

/// Compiles all shaders in `glsl/` of the package whose build script calls it, into `OUT_DIR/shaders.rs`. The
/// package includes that file below a module with `point_skeleton::gpu::shader::*` in scope. Prints
/// an error and returns a failure if a shader is invalid.
pub fn build_script() -> ExitCode {
    match compile_all() {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn compile_all() -> Result<(), String> {
    println!("cargo:rerun-if-changed=glsl");
    let folder = std::fs::read_dir("glsl").map_err(|e| format!("glsl: {e}"))?;
    let mut paths: Vec<PathBuf> = folder.filter_map(|entry| entry.ok().map(|e| e.path())).collect();
    paths.sort();
    let mut rust = String::new();
    for path in paths.iter().filter(|p| p.is_file()) {
        println!("cargo:rerun-if-changed={}", path.display());
        for variant in variants(path)? {
            rust += &compile(path, &variant)?;
        }
    }
    let out = std::env::var_os("OUT_DIR").ok_or("OUT_DIR is not set")?;
    std::fs::write(Path::new(&out).join("shaders.rs"), rust).map_err(|e| format!("OUT_DIR: {e}"))
}

/// A shader with values of its `override` constants; WGSL files list variants in lines `// variant NAME: A=1
/// B=0`.
struct Variant {
    /// Empty for a shader without variants.
    name: String,
    constants: Vec<(String, f64)>,
}

fn variants(path: &Path) -> Result<Vec<Variant>, String> {
    let file = path.display();
    let source = std::fs::read_to_string(path).map_err(|e| format!("{file}: {e}"))?;
    let mut variants = Vec::new();
    for (number, line) in source.lines().enumerate() {
        let Some(text) = line.strip_prefix("// variant ") else { continue };
        let wrong = || format!("{file}:{}: expected `// variant NAME: A=1 B=0`", number + 1);
        let (name, list) = text.split_once(':').ok_or_else(wrong)?;
        let constant = |part: &str| {
            let (key, value) = part.split_once('=').ok_or_else(wrong)?;
            Ok((key.to_owned(), value.parse::<f64>().map_err(|_| wrong())?))
        };
        let constants = list.split_whitespace().map(constant).collect::<Result<_, String>>()?;
        variants.push(Variant { name: name.to_owned(), constants });
    }
    if variants.is_empty() {
        variants.push(Variant { name: String::new(), constants: Vec::new() });
    }
    Ok(variants)
}

/// Returns the source of a shader, with each line `// include FILE` replaced by that file (relative to
/// `glsl/`).
fn with_includes(path: &Path) -> Result<String, String> {
    let file = path.display();
    let source = std::fs::read_to_string(path).map_err(|e| format!("{file}: {e}"))?;
    let line = |line: &str| match line.strip_prefix("// include ") {
        Some(name) => {
            let included = Path::new("glsl").join(name);
            std::fs::read_to_string(&included).map_err(|e| format!("{file}: {}: {e}", included.display()))
        }
        None => Ok(format!("{line}\n")),
    };
    source.lines().map(line).collect()
}

/// Compiles one shader and returns the source of its Rust module.
fn compile(path: &Path, variant: &Variant) -> Result<String, String> {
    let file = path.display().to_string();
    let source = with_includes(path)?;
    let parsed = parse(path, &file, &source)?;
    // Capabilities of Vulkan 1.1 drivers with the features that the device enables; any other is an error.
    let allowed = Capabilities::IMMEDIATES
        | Capabilities::SHADER_INT64
        | Capabilities::SHADER_INT64_ATOMIC_MIN_MAX
        | Capabilities::EARLY_DEPTH_TEST;
    let info = Validator::new(ValidationFlags::all(), allowed).validate(&parsed).map_err(|e| {
        let line = e.location(&source).map_or(0, |l| l.line_number);
        format!("{file}:{line}: {}", e.emit_to_string_with_path(&source, &file))
    })?;
    let constants = variant.constants.iter().cloned().collect();
    let (module, info) = process_overrides(&parsed, &info, None, &constants)
        .map_err(|e| format!("{file}:0: variant {}: {e}", variant.name))?;
    let entry = &module.entry_points[0];
    let options = spv::Options {
        lang_version: (1, 3),
        // No flipped y, no clamped depth: the shaders are written for Vulkan's own clip space.
        flags: spv::WriterFlags::empty(),
        // "Fake" bindings are the set and binding numbers of the shader.
        fake_missing_bindings: true,
        force_loop_bounding: false,
        zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::None,
        ..spv::Options::default()
    };
    let pipeline = spv::PipelineOptions { shader_stage: entry.stage, entry_point: entry.name.clone() };
    let words = spv::write_vec(&module, &info, &options, Some(&pipeline))
        .map_err(|e| format!("{file}:0: no SPIR-V: {e}"))?;
    let name = match variant.name.as_str() {
        "" => file.trim_start_matches("glsl/").to_owned(),
        variant => format!("{}.{variant}", file.trim_start_matches("glsl/")),
    };
    Ok(describe(&name, &module, &info, &without_contraction(&words))? + &constants_of(&parsed) + "}\n")
}

fn parse(path: &Path, file: &str, source: &str) -> Result<Module, String> {
    let stage = match path.extension().and_then(|e| e.to_str()) {
        Some("vert") => ShaderStage::Vertex,
        Some("frag") => ShaderStage::Fragment,
        Some("comp") => ShaderStage::Compute,
        Some("wgsl") => {
            return naga::front::wgsl::parse_str(source).map_err(|e| {
                let line = e.location(source).map_or(0, |l| l.line_number);
                format!("{file}:{line}: {}", e.emit_to_string_with_path(source, file))
            });
        }
        _ => return Err(format!("{file}:0: expected .vert, .frag, .comp or .wgsl")),
    };
    naga::front::glsl::Frontend::default().parse(&stage.into(), source).map_err(|e| {
        let line = e.errors.first().and_then(|e| e.location(source)).map_or(0, |l| l.line_number);
        format!("{file}:{line}: {}", e.emit_to_string_with_path(source, file))
    })
}

/// Decorates all float arithmetic with `NoContraction`: a driver that fuses a multiply with an add would
/// round differently from the CPU reference.
fn without_contraction(words: &[u32]) -> Vec<u32> {
    const HEADER: usize = 5;
    const OP_DECORATE: u32 = 71;
    const NO_CONTRACTION: u32 = 42;
    let (mut first_type, mut results) = (words.len(), Vec::new());
    let mut at = HEADER;
    while at < words.len() {
        let (opcode, length) = (words[at] & 0xffff, (words[at] >> 16) as usize);
        match opcode {
            19..=39 => first_type = first_type.min(at),
            // OpTypeVoid ..: first instruction after the decorations
            127 | 129 | 131 | 133 | 136 | 140..=146 | 148 => results.push(words[at + 2]),
            // OpFNegate .. OpDot
            _ => {}
        }
        at += length;
    }
    let decorate = |id| [3 << 16 | OP_DECORATE, id, NO_CONTRACTION];
    let decorations = results.into_iter().flat_map(decorate);
    words[..first_type]
        .iter()
        .copied()
        .chain(decorations)
        .chain(words[first_type..].iter().copied())
        .collect()
}

/// Returns the source of the shader's named integer constants, so that the host need not repeat them.
fn constants_of(module: &Module) -> String {
    let mut text = String::new();
    for (_, constant) in module.constants.iter() {
        let (Some(name), Expression::Literal(literal)) =
            (&constant.name, &module.global_expressions[constant.init])
        else {
            continue;
        };
        let (kind, value) = match literal {
            Literal::U32(value) => ("u32", value.to_string()),
            Literal::I32(value) => ("i32", value.to_string()),
            _ => continue,
        };
        text += &format!("    /// Constant of the shader.\n    pub const {name}: {kind} = {value};\n");
    }
    text
}

/// Returns the source of a compiled shader's Rust module, without its end.
fn describe(name: &str, module: &Module, info: &ModuleInfo, words: &[u32]) -> Result<String, String> {
    let entry = &module.entry_points[0];
    let used = info.get_entry_point(0);
    let (mut bindings, mut push_size) = (String::new(), 0);
    for (handle, global) in module.global_variables.iter().filter(|(h, _)| !used[*h].is_empty()) {
        if global.space == AddressSpace::Immediate {
            push_size = module.types[global.ty].inner.size(module.to_ctx());
        }
        if let Some(at) = &global.binding {
            let kind = binding_kind(module, handle).ok_or(format!("{name}: unknown kind of binding"))?;
            write!(
                bindings,
                "Binding {{ set: {}, binding: {}, kind: BindingKind::{kind} }}, ",
                at.group, at.binding
            )
            .map_err(|e| e.to_string())?;
        }
    }
    let mut text = format!(
        "/// `{name}`.\npub mod {} {{\n    use super::*;\n    /// The shader.\n    pub const SHADER: Shader \
            = Shader {{ \
         name: \"{name}\", entry: c\"{}\", stage: Stage::{:?}, push_size: {push_size}, bindings: \
         &[{bindings}], \
         inputs: &[{}], workgroup: {:?}, words: &{words:?} }};\n",
        name.replace('.', "_"),
        entry.name,
        entry.stage,
        inputs(module)?,
        entry.workgroup_size,
    );
    for (_, ty) in module.types.iter() {
        let (Some(name), TypeInner::Struct { members, span }) = (&ty.name, &ty.inner) else { continue };
        if name.starts_with("gl_") {
            continue;
        }
        text += &format!("    /// `{name}`.\n    pub mod {} {{\n", snake(name));
        text += &format!("        /// Bytes.\n        pub const SIZE: usize = {span};\n");
        for member in members {
            let name = member.name.as_deref().unwrap_or("unnamed");
            let (upper, offset) = (name.to_uppercase(), member.offset);
            text += &format!("        /// Offset in bytes.\n        pub const {upper}: usize = {offset};\n");
        }
        text += "    }\n";
    }
    Ok(text)
}

fn binding_kind(module: &Module, handle: naga::Handle<naga::GlobalVariable>) -> Option<&'static str> {
    let global = &module.global_variables[handle];
    match (global.space, &module.types[global.ty].inner) {
        (AddressSpace::Uniform, _) => Some("Uniform"),
        (AddressSpace::Storage { .. }, _) => Some("Storage"),
        (AddressSpace::Handle, TypeInner::Image { class: naga::ImageClass::Storage { .. }, .. }) => {
            Some("StorageImage")
        }
        (AddressSpace::Handle, TypeInner::Image { .. }) => Some("SampledImage"),
        _ => None,
    }
}

/// Returns the vertex inputs with their formats; empty for other stages.
fn inputs(module: &Module) -> Result<String, String> {
    let entry = &module.entry_points[0];
    let mut text = String::new();
    for argument in entry.function.arguments.iter().filter(|_| entry.stage == ShaderStage::Vertex) {
        let Some(Binding::Location { location, .. }) = argument.binding else { continue };
        let (count, kind) = match module.types[argument.ty].inner {
            TypeInner::Scalar(scalar) => (1, scalar.kind),
            TypeInner::Vector { size, scalar } => (size as u32, scalar.kind),
            _ => return Err(format!("input {location}: expected a scalar or a vector")),
        };
        let kind = if kind == ScalarKind::Uint { "U32" } else { "F32" };
        write!(text, "Input {{ location: {location}, format: InputFormat::{kind}x{count} }}, ")
            .map_err(|e| e.to_string())?;
    }
    Ok(text)
}

fn snake(name: &str) -> String {
    let mut text = String::new();
    for (i, c) in name.chars().enumerate() {
        if c.is_uppercase() && i > 0 {
            text.push('_');
        }
        text.extend(c.to_lowercase());
    }
    text
}
