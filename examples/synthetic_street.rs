//! Writes a drive down a synthetic street as a nuScenes data set, true images included.
//!
//! `cargo run --release --example synthetic_street -- --out DIR [--frames N] [--seed S] [--size HxW]`
#![allow(clippy::print_stdout)]

use std::path::PathBuf;

use clap::Parser;
use point_skeleton::conditions::ImageSize;
use point_skeleton::dataset::nuscenes;
use point_skeleton::town::{Street, StreetOptions};

/// Writes a drive down a synthetic street as a nuScenes data set
#[derive(Parser)]
struct Args {
    /// Folder to write
    #[arg(long)]
    out: PathBuf,
    /// Annotated frames, five a second
    #[arg(long, default_value_t = 8)]
    frames: usize,
    /// What the street looks like
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Size of the images
    #[arg(long, default_value = "288x512", value_name = "HxW")]
    size: ImageSize,
}

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let size = [args.size.height, args.size.width];
    let street = Street::new(&StreetOptions { seed: args.seed, frames: args.frames, size })?;
    nuscenes::write_log(&args.out, "v1.0-street", &street)?;
    println!("wrote {} frames of a street: nuscenes:{}", args.frames, args.out.display());
    Ok(())
}
