//! Opens and closes devices on several threads, under the validation layer.
//!
//! The layer looks up a device's state in a map that it does not lock: opening or closing a device on one
//! thread while another thread calls Vulkan crashed the process (`src/gpu/gate.rs`). Some threads here open a
//! device, copy with it, sometimes make a mistake, and close it; others copy continuously with their own
//! device. Every byte must arrive, and every message must reach only the device that caused it.
//!
//! The test takes 10 seconds. `PSKEL_STRESS_S=600 cargo test --test devices` takes 10 minutes;
//! `PSKEL_STRESS_THREADS=8` uses eight threads of each kind instead of three.
#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers are outside `#[test]` functions

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use ash::vk::BufferUsageFlags as Usage;
use point_skeleton::gpu::{Buffer, BufferDesc, Commands, Device, DeviceDesc, GpuError, Memory, Scope};

const BYTES: usize = 256;

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |value| value.parse().unwrap())
}

fn open(validation: bool) -> Arc<Device> {
    Device::new(&DeviceDesc { validation, ..DeviceDesc::from_env() }).unwrap_or_else(|e| panic!("{e}"))
}

fn buffer(device: &Arc<Device>, usage: Usage, memory: Memory) -> Result<Buffer, GpuError> {
    Buffer::new(device, &BufferDesc { name: "stress", size: BYTES as u64, usage, memory })
}

/// Copies bytes to the device and back.
fn copy(device: &Arc<Device>, commands: &mut Commands, byte: u8) -> Result<(), GpuError> {
    let mut upload = buffer(device, Usage::TRANSFER_SRC, Memory::Upload)?;
    let middle = buffer(device, Usage::TRANSFER_SRC | Usage::TRANSFER_DST, Memory::Device)?;
    let mut back = buffer(device, Usage::TRANSFER_DST, Memory::Readback)?;
    upload.bytes_mut()?.fill(byte);
    back.bytes_mut()?.fill(!byte);
    let mut recorder = commands.begin()?;
    recorder.copy((&upload, 0), (&middle, 0), BYTES as u64)?;
    recorder.barrier(Scope::CopyWrite, Scope::CopyRead);
    recorder.copy((&middle, 0), (&back, 0), BYTES as u64)?;
    recorder.barrier(Scope::CopyWrite, Scope::Host);
    recorder.submit()?;
    assert_eq!(back.bytes_mut()?, [byte; BYTES]);
    Ok(())
}

/// Opens, uses and closes a device. Every fourth time it makes a mistake, which only this device must report.
fn come_and_go(round: u64) -> Result<(), GpuError> {
    // Devices without the layer are opened and closed beside the others.
    let validation = !round.is_multiple_of(5);
    let device = open(validation);
    let messages = device.validation_messages();
    copy(&device, &mut Commands::new(&device)?, round as u8)?;
    if round.is_multiple_of(4) {
        let wrong = buffer(&device, Usage::empty(), Memory::Device);
        let heard = messages.take();
        assert_eq!(heard.len(), usize::from(validation), "{heard:?}");
        assert!(heard.iter().all(|message| message.contains("VkBufferCreateInfo")), "{heard:?}");
        drop(wrong);
    }
    drop(device);
    messages.check()
}

#[test]
fn devices_open_and_close_while_others_work() {
    let (seconds, threads) = (number("PSKEL_STRESS_S", 10), number("PSKEL_STRESS_THREADS", 3));
    let (end, failed) = (Instant::now() + Duration::from_secs(seconds), AtomicBool::new(false));
    let (opened, copied) = (AtomicU64::new(0), AtomicU64::new(0));
    let until_end = |work: &mut dyn FnMut(u64) -> Result<(), GpuError>, count: &AtomicU64| {
        for round in 0.. {
            if Instant::now() >= end || failed.load(Ordering::Relaxed) {
                return;
            }
            if let Err(error) = work(round) {
                failed.store(true, Ordering::Relaxed);
                panic!("round {round}: {error}");
            }
            count.fetch_add(1, Ordering::Relaxed);
        }
    };
    thread::scope(|scope| {
        for thread in 0..threads {
            scope.spawn({
                let (until_end, opened) = (&until_end, &opened);
                move || until_end(&mut |round| come_and_go(round + thread), opened)
            });
            scope.spawn({
                let (until_end, copied) = (&until_end, &copied);
                move || {
                    let device = open(true);
                    let mut commands = Commands::new(&device).unwrap();
                    until_end(&mut |round| copy(&device, &mut commands, round as u8), copied);
                }
            });
        }
    });
    let (opened, copied) = (opened.into_inner(), copied.into_inner());
    println!("{opened} devices opened and closed beside {copied} copies in {seconds} s");
    assert!(opened >= threads && copied >= threads);
}
