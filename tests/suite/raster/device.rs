//! Opening a device, and the errors if that fails.

use point_skeleton::gpu::{Device, DeviceDesc, GpuError};
use point_skeleton::raster::{RasterizerDesc, RasterizerKind, create};

use pskel_testing::devices::with_device;

#[test]
fn an_unknown_device_lists_the_available_ones() {
    let name = with_device(|device| device.name().to_owned());
    let desc = DeviceDesc { device: Some("no such device".into()), validation: false };
    let error = Device::new(&desc).err().unwrap();
    assert!(matches!(error, GpuError::UnknownDevice { .. }));
    let text = error.to_string();
    assert!(text.contains("no such device") && text.contains(&name), "{text}");
    let made = |kind| {
        let device = Some("no such device".into());
        create(&RasterizerDesc { kind, device, ..RasterizerDesc::default() }, vec![]).is_ok()
    };
    use RasterizerKind as Kind;
    assert_eq!([Kind::Auto, Kind::Compute, Kind::Graphics, Kind::Cpu].map(made), [false, false, false, true]);
}

#[test]
fn a_device_is_found_by_part_of_its_name() {
    let name = with_device(|device| device.name().to_owned());
    let part = name.split_whitespace().next().unwrap().to_uppercase();
    let made = |kind| {
        let desc = RasterizerDesc { kind, device: Some(part.clone()), ..RasterizerDesc::default() };
        let info = create(&desc, vec![]).unwrap().info();
        assert!(info.device == name && !info.driver.is_empty(), "{info:?}");
        info.rasterizer
    };
    let best = if with_device(|device| device.atomics_64()) { "compute" } else { "graphics" };
    assert_eq!((made(RasterizerKind::Auto), made(RasterizerKind::Graphics)), (best, "graphics"));
}

/// Runs a loader without drivers, in a child process because the environment belongs to the process.
#[test]
fn a_missing_driver_error_says_what_to_install() {
    const INNER: &str = "PSKEL_TEST_WITHOUT_DRIVER";
    if std::env::var_os(INNER).is_some() {
        let error = Device::new(&DeviceDesc::default()).err().unwrap();
        assert!(matches!(error, GpuError::NoDevice { .. }), "{error}");
        assert!(error.to_string().contains("apt-get install libvulkan1 mesa-vulkan-drivers"), "{error}");
        return;
    }
    let output = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "raster::device::a_missing_driver_error_says_what_to_install", "--nocapture"])
        .env(INNER, "1")
        .env("VK_DRIVER_FILES", "/nonexistent.json")
        .env("VK_ICD_FILENAMES", "/nonexistent.json")
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("1 passed"));
}
