//! Build script: nothing to compile yet.

fn main() {}
