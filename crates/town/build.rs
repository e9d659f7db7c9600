//! Compiles the shaders of the town's views.

fn main() -> std::process::ExitCode {
    pskel_shaders::build_script()
}
