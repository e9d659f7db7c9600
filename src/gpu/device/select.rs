//! Device selection: a pure choice among candidates.

use ash::vk;

use super::identity::DeviceIdentity;
use crate::gpu::GpuError;

/// Which device to open, and how.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceDesc {
    /// Index, UUID (`GPU-..` or hexadecimal digits), PCI address (`0000:65:00.0`), or a part of the name
    /// (case-insensitive). `None` selects the best: discrete before
    /// integrated before virtual before CPU, the first among equals.
    pub device: Option<String>,
    /// Run under the validation layer with synchronization validation; any message is then an error.
    pub validation: bool,
}

impl DeviceDesc {
    /// Reads `PSKEL_DEVICE` (empty counts as unset) and `PSKEL_VALIDATION` (`1` enables it).
    pub fn from_env() -> Self {
        let device = std::env::var("PSKEL_DEVICE").ok().filter(|name| !name.is_empty());
        Self { device, validation: std::env::var("PSKEL_VALIDATION").is_ok_and(|v| v == "1") }
    }
}

/// A physical device to choose from.
#[derive(Clone, Debug)]
pub(in super::super) struct Candidate {
    pub(in super::super) name: String,
    pub(in super::super) kind: vk::PhysicalDeviceType,
    pub(in super::super) identity: DeviceIdentity,
    /// Whether the device has the required version and queue.
    pub(in super::super) usable: bool,
}

/// Returns the index of the selected candidate.
pub(in super::super) fn choose(candidates: &[Candidate], wanted: Option<&str>) -> Result<usize, GpuError> {
    if !candidates.iter().any(|c| c.usable) {
        let found = if candidates.is_empty() { "no device".into() } else { list(candidates) };
        return Err(GpuError::NoDevice { found });
    }
    let index = wanted.and_then(|w| w.trim().parse::<usize>().ok()).filter(|i| *i < candidates.len());
    let fits = |i: usize, candidate: &Candidate| match (index, wanted) {
        (Some(index), _) => i == index,
        (None, Some(id)) if candidates.iter().any(|c| c.identity.is(id)) => candidate.identity.is(id),
        (None, Some(part)) => candidate.name.to_lowercase().contains(&part.trim().to_lowercase()),
        (None, None) => true,
    };
    let fitting = candidates.iter().enumerate().filter(|(i, c)| c.usable && fits(*i, c));
    fitting.min_by_key(|(i, c)| (rank(c.kind), *i)).map(|(i, _)| i).ok_or_else(|| GpuError::UnknownDevice {
        wanted: wanted.unwrap_or_default().to_owned(),
        found: list(candidates),
    })
}

fn rank(kind: vk::PhysicalDeviceType) -> u32 {
    match kind {
        vk::PhysicalDeviceType::DISCRETE_GPU => 0,
        vk::PhysicalDeviceType::INTEGRATED_GPU => 1,
        vk::PhysicalDeviceType::VIRTUAL_GPU => 2,
        vk::PhysicalDeviceType::CPU => 3,
        _ => 4,
    }
}

fn list(candidates: &[Candidate]) -> String {
    let line = |(i, c): (usize, &Candidate)| {
        let note = if c.usable { "" } else { " (lacks Vulkan 1.1 or a graphics and compute queue)" };
        format!("{i}: {}{note}", c.name)
    };
    candidates.iter().enumerate().map(line).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidates() -> Vec<Candidate> {
        let candidate = |name: &str, kind| {
            let identity = DeviceIdentity::default();
            Candidate { name: name.into(), kind, identity, usable: true }
        };
        vec![
            candidate("llvmpipe (LLVM 15)", vk::PhysicalDeviceType::CPU),
            candidate("Graphics 770", vk::PhysicalDeviceType::INTEGRATED_GPU),
            candidate("RTX 4090", vk::PhysicalDeviceType::DISCRETE_GPU),
            candidate("RTX 4090", vk::PhysicalDeviceType::DISCRETE_GPU),
        ]
    }

    #[test]
    fn selects_the_best_device_unless_one_is_named() {
        let all = candidates();
        let take = |wanted| choose(&all, wanted).unwrap();
        assert_eq!([take(None), take(Some("LLVM")), take(Some("3")), take(Some("rtx"))], [2, 0, 3, 2]);
        assert_eq!((take(Some("770")), take(Some("4090"))), (1, 2));
        assert_eq!(choose(&all[..2], None).unwrap(), 1);
    }

    #[test]
    fn never_selects_an_unusable_device() {
        let mut all = candidates();
        all[2].usable = false;
        assert_eq!(choose(&all, None).unwrap(), 3);
        assert!(choose(&all, Some("2")).unwrap_err().to_string().contains("2: RTX 4090 (lacks"));
    }

    #[test]
    fn errors_list_the_available_devices() {
        let text = choose(&candidates(), Some("radeon")).unwrap_err().to_string();
        assert!(text.contains("\"radeon\"") && text.contains("1: Graphics 770"), "{text}");
        assert!(choose(&[], None).unwrap_err().to_string().contains("found no device"));
    }
}
