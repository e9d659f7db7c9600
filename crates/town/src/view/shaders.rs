//! Compiled shaders (`glsl/`), with their reflection.

use point_skeleton::gpu::{Binding, BindingKind, Input, InputFormat, Shader, Stage};

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));
