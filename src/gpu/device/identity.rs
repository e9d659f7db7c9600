//! Identity of a physical device, which job schedulers name instead of an index.

use ash::{ext, vk};

use super::instance::Instance;

/// UUID and PCI address of a device.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in super::super) struct DeviceIdentity {
    uuid: Option<[u8; vk::UUID_SIZE]>,
    /// Domain, bus, device and function.
    pci: Option<[u32; 4]>,
}

impl DeviceIdentity {
    /// Reads the identity of a device. `has_properties_2`: whether it supports Vulkan 1.1.
    pub(in super::super) fn read(
        instance: &Instance,
        physical: vk::PhysicalDevice,
        has_properties_2: bool,
    ) -> Self {
        if !has_properties_2 {
            return Self::default();
        }
        // SAFETY: the handle comes from this instance.
        let extensions = unsafe { instance.calls().enumerate_device_extension_properties(physical) };
        let is_pci = |e: &vk::ExtensionProperties| e.extension_name_as_c_str() == Ok(ext::pci_bus_info::NAME);
        let has_pci = extensions.unwrap_or_default().iter().any(is_pci);
        let mut id = vk::PhysicalDeviceIDProperties::default();
        let mut pci = vk::PhysicalDevicePCIBusInfoPropertiesEXT::default();
        let mut all = vk::PhysicalDeviceProperties2::default().push_next(&mut id);
        if has_pci {
            all = all.push_next(&mut pci);
        }
        // SAFETY: the device supports Vulkan 1.1 and the extensions of the chained structures.
        unsafe { instance.calls().get_physical_device_properties2(physical, &mut all) };
        let pci = [pci.pci_domain, pci.pci_bus, pci.pci_device, pci.pci_function];
        Self { uuid: Some(id.device_uuid), pci: has_pci.then_some(pci) }
    }

    /// Returns whether a text is the UUID (`GPU-6f1c..` or hexadecimal digits) or the PCI address
    /// (`0000:65:00.0`, with or without the domain) of the device.
    pub(in super::super) fn is(&self, text: &str) -> bool {
        let text = text.trim();
        (self.uuid.is_some() && self.uuid == uuid(text)) || (self.pci.is_some() && self.pci == pci(text))
    }
}

fn uuid(text: &str) -> Option<[u8; vk::UUID_SIZE]> {
    let digits = text.strip_prefix("GPU-").unwrap_or(text).replace('-', "");
    let is_hex = digits.len() == 2 * vk::UUID_SIZE && digits.bytes().all(|c| c.is_ascii_hexdigit());
    let number = is_hex.then(|| u128::from_str_radix(&digits, 16).ok()).flatten()?;
    Some(number.to_be_bytes())
}

fn pci(text: &str) -> Option<[u32; 4]> {
    let number = |digits: &str| u32::from_str_radix(digits, 16).ok();
    let (head, function) = text.rsplit_once('.')?;
    let (head, device) = head.rsplit_once(':')?;
    let (domain, bus) = head.rsplit_once(':').unwrap_or(("0", head));
    Some([number(domain)?, number(bus)?, number(device)?, number(function)?])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_match_by_uuid_and_address() {
        let uuid = core::array::from_fn(|i| 0x10 + i as u8);
        let device = DeviceIdentity { uuid: Some(uuid), pci: Some([0, 0x65, 0, 1]) };
        for text in [
            "GPU-10111213-1415-1617-1819-1a1b1c1d1e1f",
            "101112131415161718191A1B1C1D1E1F",
            "0000:65:00.1",
            "00000000:65:00.1",
            " 65:0.1 ",
        ] {
            assert!(device.is(text), "{text}");
        }
        for text in [
            "",
            "65",
            "0001:65:00.1",
            "65:00.0",
            "GPU-10111213",
            "RTX",
            "1.5",
            "101112131415161718191A1B1C1D1E20",
        ] {
            assert!(!device.is(text), "{text}");
        }
        assert!(!DeviceIdentity::default().is("0000:00:00.0"));
    }
}
