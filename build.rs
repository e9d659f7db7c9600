//! Compiles the shaders of the renderer.

fn main() -> std::process::ExitCode {
    pskel_shaders::build_script()
}
