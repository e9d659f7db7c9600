//! Tests that the validation layer is on and that its messages are reported: a check that cannot fail proves
//! nothing.

use std::sync::Arc;

use ash::vk::BufferUsageFlags as Usage;

use super::*;

fn device() -> Arc<Device> {
    let desc = DeviceDesc { validation: true, ..DeviceDesc::from_env() };
    Device::new(&desc).unwrap_or_else(|e| panic!("{e}"))
}

fn buffer(device: &Arc<Device>, usage: Usage, memory: Memory) -> Result<Buffer, GpuError> {
    Buffer::new(device, &BufferDesc { name: "test", size: 64, usage, memory })
}

#[test]
fn bytes_round_trip() {
    let device = device();
    let mut upload = buffer(&device, Usage::TRANSFER_SRC, Memory::Upload).unwrap();
    let middle = buffer(&device, Usage::TRANSFER_SRC | Usage::TRANSFER_DST, Memory::Device).unwrap();
    let mut back = buffer(&device, Usage::TRANSFER_DST, Memory::Readback).unwrap();
    upload.bytes_mut().unwrap().copy_from_slice(&[7; 64]);
    let mut commands = Commands::new(&device).unwrap();
    let mut recorder = commands.begin().unwrap();
    recorder.copy((&upload, 0), (&middle, 0), 64).unwrap();
    recorder.barrier(Scope::CopyWrite, Scope::CopyWrite);
    recorder.update(&middle, 32, &[9; 32]).unwrap();
    recorder.barrier(Scope::CopyWrite, Scope::CopyRead);
    recorder.copy((&middle, 0), (&back, 0), 64).unwrap();
    recorder.barrier(Scope::CopyWrite, Scope::Host);
    recorder.stamp("copy");
    let stages = recorder.submit().unwrap();
    assert!(stages.len() == 1 && ["copy", "gpu"].contains(&stages[0].0), "{stages:?}");
    let bytes = back.bytes_mut().unwrap();
    assert!(bytes[..32] == [7; 32] && bytes[32..] == [9; 32]);
    // A copy out of range is an error and never reaches Vulkan.
    let mut recorder = commands.begin().unwrap();
    let text = recorder.copy((&middle, 8), (&back, 0), 64).unwrap_err().to_string();
    assert_eq!(text, "expected 72 bytes in test, found 64");
    drop(recorder);
    let mut middle = middle;
    assert!(matches!(middle.bytes_mut(), Err(GpuError::Range { found: 0, .. })));
}

#[test]
fn validation_reports_a_wrong_call() {
    let device = device();
    let made = buffer(&device, Usage::empty(), Memory::Device);
    let text = device.check_validation().unwrap_err().to_string();
    assert!(text.contains("VkBufferCreateInfo"), "{text}");
    drop(made);
}

#[test]
fn validation_reports_a_missing_barrier() {
    let device = device();
    let from = buffer(&device, Usage::TRANSFER_SRC | Usage::TRANSFER_DST, Memory::Device).unwrap();
    let to = buffer(&device, Usage::TRANSFER_DST, Memory::Readback).unwrap();
    let mut commands = Commands::new(&device).unwrap();
    let mut recorder = commands.begin().unwrap();
    recorder.update(&from, 0, &[1; 64]).unwrap();
    recorder.copy((&from, 0), (&to, 0), 64).unwrap();
    let error = recorder.submit().unwrap_err();
    assert!(matches!(&error, GpuError::Validation(_)), "{error}");
    assert!(error.to_string().contains("SYNC-HAZARD-READ-AFTER-WRITE"), "{error}");
}

#[test]
fn validation_reports_a_leak_after_the_device_is_destroyed() {
    let device = device();
    let messages = device.validation_messages();
    let info = ash::vk::FenceCreateInfo::default();
    // SAFETY: the create info contains no pointers; the fence leaks with the device, which the layer should
    // report.
    let leaked = unsafe { device.calls().create_fence(&info, None) };
    assert!(leaked.is_ok());
    drop(device);
    let text = messages.check().unwrap_err().to_string();
    assert!(text.contains("vkDestroyDevice"), "{text}");
}

#[test]
fn rejects_too_large_images_by_name() {
    let device = device();
    let usage = ash::vk::ImageUsageFlags::SAMPLED;
    let format = ash::vk::Format::R32G32_UINT;
    let desc = ImageDesc { name: "huge", width: 1 << 24, height: 4, layers: None, format, usage };
    let text = Image::new(&device, &desc).err().unwrap().to_string();
    assert!(text.contains("4x16777216") && text.contains(device.name()), "{text}");
    device.check_validation().unwrap();
}

#[test]
fn indices_bound_the_vertices_of_a_draw() {
    let device = device();
    let mut commands = Commands::new(&device).unwrap();
    let indices = Indices::new(&device, &mut commands, &[4, 0, 7]).unwrap();
    assert_eq!(indices.end(), 8);
    indices.check(&(0..3)).unwrap();
    let text = indices.check(&(1..4)).unwrap_err().to_string();
    assert_eq!(text, "expected 16 bytes in indices, found 12");
    assert_eq!(Indices::new(&device, &mut commands, &[]).unwrap().end(), 0);
    let text = Indices::new(&device, &mut commands, &[1, u32::MAX]).err().unwrap().to_string();
    assert!(text.contains("indices up to 4294967295") && text.contains(device.name()), "{text}");
    device.check_validation().unwrap();
}

#[test]
fn host_memory_in_use_cannot_be_mapped() {
    let device = device();
    let usage = Usage::TRANSFER_SRC | Usage::TRANSFER_DST;
    let back = Arc::new(buffer(&device, usage, Memory::Readback).unwrap());
    let mut flight = PendingSubmit::new(&device, back.clone()).unwrap();
    let shared = Arc::new(());
    let fill = |flight: &mut PendingSubmit<(), Arc<Buffer>>, word| {
        flight.start(&shared, |recorder, _, back| {
            recorder.fill(back, 0, 64, word)?;
            recorder.barrier(Scope::CopyWrite, Scope::Host);
            Ok::<(), GpuError>(())
        })
    };
    fill(&mut flight, 0x0102_0304).unwrap();
    assert!(matches!(back.map(), Err(GpuError::Busy { .. })));
    flight.wait().unwrap();
    let mapped = back.map().unwrap();
    assert!(mapped.chunks(4).all(|word| word == [4, 3, 2, 1]));
    // A mapped buffer can neither be used nor be mapped again.
    assert!(matches!(back.map(), Err(GpuError::Busy { .. })));
    assert!(matches!(fill(&mut flight, 5), Err(GpuError::Busy { .. })));
    drop(mapped);
    fill(&mut flight, 5).unwrap();
    drop(flight);
    assert_eq!(back.map().unwrap()[0], 5);
}
