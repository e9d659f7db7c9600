//! The logical device, its one queue, and its memory.

pub(super) mod drivers;
pub(super) mod fork;
pub(super) mod gate;
pub(super) mod identity;
pub(super) mod instance;
pub(super) mod select;
pub(super) mod validation;

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ash::{ext, khr, vk};
use gpu_allocator::vulkan::{
    Allocation, AllocationCreateDesc, AllocationScheme, Allocator, AllocatorCreateDesc,
};
use gpu_allocator::{AllocationSizes, MemoryLocation};

use self::fork::check_process;
use self::gate::Calls;
use self::identity::DeviceIdentity;
use self::instance::Instance;
use self::select::{Candidate, choose};
use super::error::call;
use super::{DeviceDesc, GpuError, ImageDesc, Messages};
use crate::threads;

/// An open device. Every object created from it holds an `Arc` of it.
pub struct Device {
    /// Dropped explicitly before the device itself.
    allocator: Mutex<Option<Allocator>>,
    utils: Option<ext::debug_utils::Device>,
    raw: ash::Device,
    pub(super) queue_family: u32,
    queue: Mutex<vk::Queue>,
    facts: DeviceProperties,
    /// Numbers of allocations, pipelines and descriptor sets created.
    made: [AtomicU64; 3],
    physical: vk::PhysicalDevice,
    instance: Instance,
}

/// Numbers of objects created on a device since it was opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct ObjectCounts {
    /// Memory allocations.
    pub allocations: u64,
    /// Compute and graphics pipelines.
    pub pipelines: u64,
    /// Descriptor sets of any layout.
    pub descriptor_sets: u64,
}

/// Name, properties, limits and supported features of a physical device.
#[derive(Clone, Debug)]
pub(super) struct DeviceProperties {
    pub(super) name: String,
    pub(super) kind: vk::PhysicalDeviceType,
    pub(super) driver: String,
    pub(super) limits: vk::PhysicalDeviceLimits,
    pub(super) max_allocation: u64,
    pub(super) large_points: bool,
    pub(super) atomics_64: bool,
    pub(super) timestamp_bits: u32,
}

const QUEUE_NEEDS: vk::QueueFlags =
    vk::QueueFlags::from_raw(vk::QueueFlags::GRAPHICS.as_raw() | vk::QueueFlags::COMPUTE.as_raw());

impl Device {
    /// Opens a device.
    ///
    /// # Errors
    /// Fails if there is no Vulkan loader, driver or suitable device, if no device has the requested name, if
    /// the validation layer is missing, or if that layer reports any message.
    pub fn new(desc: &DeviceDesc) -> Result<Arc<Self>, GpuError> {
        check_process()?;
        let instance = Instance::new(desc.validation)?;
        let physical = instance.physical_devices()?;
        let candidates: Vec<Candidate> = physical.iter().map(|p| candidate(&instance, *p)).collect();
        let chosen = choose(&candidates, desc.device.as_deref())?;
        if candidates[chosen].kind == vk::PhysicalDeviceType::CPU {
            // Mesa 22.3 waits forever for threads that it could not start.
            threads::probe(
                threads::of_cpu_driver(),
                &format!("the threads of the driver of {}", candidates[chosen].name),
            )?;
        }
        let physical = physical[chosen];
        let (queue_family, timestamp_bits) = queue_family(&instance, physical).unwrap_or_default();
        let facts = facts(&instance, physical, timestamp_bits)?;
        let raw = create(instance.raw(), physical, queue_family, &facts)?;
        // SAFETY: the device was created with this family and index.
        let queue = unsafe { instance.calls_of(&raw).get_device_queue(queue_family, 0) };
        let utils = instance.validation.then(|| ext::debug_utils::Device::new(&instance.calls(), &raw));
        let (allocator, queue, made) = (Mutex::new(None), Mutex::new(queue), Default::default());
        let device = Self { allocator, utils, raw, queue_family, queue, facts, made, physical, instance };
        *lock(&device.allocator) = Some(device.new_allocator(physical)?);
        device.check_validation()?;
        Ok(Arc::new(device))
    }

    fn new_allocator(&self, physical_device: vk::PhysicalDevice) -> Result<Allocator, GpuError> {
        const BLOCK: u64 = 16 << 20;
        let desc = AllocatorCreateDesc {
            instance: self.instance.raw().clone(),
            device: self.raw.clone(),
            physical_device,
            debug_settings: gpu_allocator::AllocatorDebugSettings::default(),
            buffer_device_address: false,
            allocation_sizes: AllocationSizes::new(BLOCK, BLOCK),
        };
        let _share = self.instance.share();
        Allocator::new(&desc).map_err(|source| GpuError::Memory {
            bytes: 0,
            name: "the allocator".into(),
            source,
        })
    }

    /// Returns the device's functions for one call.
    pub(super) fn calls(&self) -> Calls<'_, ash::Device> {
        self.instance.calls_of(&self.raw)
    }

    /// Returns the device's name.
    pub fn name(&self) -> &str {
        &self.facts.name
    }

    /// Returns the driver's name and version.
    pub fn driver(&self) -> &str {
        &self.facts.driver
    }

    /// Returns the limits, with Vulkan's names.
    pub fn limits(&self) -> &vk::PhysicalDeviceLimits {
        &self.facts.limits
    }

    /// Returns the size of the largest buffer that a shader can bind as a whole, bytes.
    pub(crate) fn max_storage_buffer(&self) -> u64 {
        u64::from(self.facts.limits.max_storage_buffer_range).min(self.facts.max_allocation)
    }

    /// Returns the maximum size of one allocation, bytes.
    pub fn max_allocation(&self) -> u64 {
        self.facts.max_allocation
    }

    /// Returns the maximum side length of an image, pixels.
    pub(crate) fn max_image_side(&self) -> u32 {
        self.facts.limits.max_image_dimension2_d
    }

    /// Returns whether points may be larger than one pixel; see also the limit `point_size_range`.
    pub(crate) fn large_points(&self) -> bool {
        self.facts.large_points
    }

    /// Returns whether compute shaders have 64-bit integers and 64-bit atomics on storage buffers.
    pub fn atomics_64(&self) -> bool {
        self.facts.atomics_64
    }

    /// Returns the number of valid bits in the queue's timestamps; 0 without timestamps.
    pub(super) fn timestamp_bits(&self) -> u32 {
        self.facts.timestamp_bits
    }

    /// Returns whether images of this format, tiling, usage and size can be created.
    pub(super) fn has_image(
        &self,
        format: vk::Format,
        tiling: vk::ImageTiling,
        usage: vk::ImageUsageFlags,
        [width, height]: [u32; 2],
    ) -> Result<bool, GpuError> {
        match self.image_extent(format, tiling, usage)? {
            Some(can) => Ok(width <= can.width && height <= can.height),
            None => Ok(false),
        }
    }

    /// Returns the maximum extent for images with this format, tiling and usage; `None` if unsupported.
    fn image_extent(
        &self,
        format: vk::Format,
        tiling: vk::ImageTiling,
        usage: vk::ImageUsageFlags,
    ) -> Result<Option<vk::Extent3D>, GpuError> {
        let (kind, flags) = (vk::ImageType::TYPE_2D, vk::ImageCreateFlags::empty());
        let (calls, physical) = (self.instance.calls(), self.physical);
        // SAFETY: the handle comes from this instance.
        let can = unsafe {
            calls.get_physical_device_image_format_properties(physical, format, kind, tiling, usage, flags)
        };
        match can {
            Ok(can) => Ok(Some(can.max_extent)),
            Err(vk::Result::ERROR_FORMAT_NOT_SUPPORTED) => Ok(None),
            Err(source) => Err(GpuError::Call { call: "vkGetPhysicalDeviceImageFormatProperties", source }),
        }
    }

    /// Validates that an image can be created with optimal tiling.
    pub(super) fn check_image(&self, desc: &ImageDesc<'_>) -> Result<(), GpuError> {
        let (format, usage, layers) = (desc.format, desc.usage, desc.layers.unwrap_or(1));
        let expected =
            || format!("{format:?} images of {layers}x{}x{} for {usage:?}", desc.height, desc.width);
        let most = self.facts.limits.max_image_array_layers;
        match self.image_extent(format, vk::ImageTiling::OPTIMAL, usage)? {
            Some(can) if desc.width <= can.width && desc.height <= can.height && layers <= most => Ok(()),
            Some(can) => {
                let found = format!("at most {most}x{}x{}", can.height, can.width);
                Err(self.unsupported(expected(), found))
            }
            None => Err(self.unsupported(expected(), "no such format")),
        }
    }

    /// Returns the numbers of allocations, pipelines and descriptor sets created so far. They are constant
    /// after a program's warm-up.
    pub fn made(&self) -> ObjectCounts {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let [allocations, pipelines, descriptor_sets] = self.made.each_ref().map(count);
        ObjectCounts { allocations, pipelines, descriptor_sets }
    }

    pub(super) fn count_pipeline(&self) {
        self.made[1].fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn count_descriptor_set(&self) {
        self.made[2].fetch_add(1, Ordering::Relaxed);
    }

    /// Returns whether host and device share memory, so that the device may write directly to host-visible
    /// memory.
    pub(crate) fn shares_memory(&self) -> bool {
        matches!(self.facts.kind, vk::PhysicalDeviceType::CPU | vk::PhysicalDeviceType::INTEGRATED_GPU)
    }

    /// Returns whether the device is the host's own processor.
    pub(crate) fn is_cpu(&self) -> bool {
        self.facts.kind == vk::PhysicalDeviceType::CPU
    }

    /// Returns a [`GpuError::Unsupported`] that names this device.
    pub(crate) fn unsupported(&self, expected: impl Into<String>, found: impl Into<String>) -> GpuError {
        GpuError::Unsupported {
            expected: expected.into(),
            found: found.into(),
            device: self.facts.name.clone(),
        }
    }

    /// Returns the validation layer's messages since the last check; always empty without validation. The
    /// handle outlives the device, so that messages about its destruction can be read too.
    pub fn validation_messages(&self) -> Arc<Messages> {
        self.instance.messages.clone()
    }

    /// Fails on any pending message of the validation layer.
    ///
    /// # Errors
    /// Returns [`GpuError::Validation`] if there is a message.
    pub fn check_validation(&self) -> Result<(), GpuError> {
        self.instance.messages.check()
    }

    /// Sets the name that validation messages show for an object.
    pub(super) fn set_name<H: vk::Handle>(&self, handle: H, name: &str) -> Result<(), GpuError> {
        let (Some(utils), Ok(name)) = (&self.utils, std::ffi::CString::new(name)) else { return Ok(()) };
        let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(handle).object_name(&name);
        // SAFETY: the handle is alive and belongs to this device; the name lives until after the call.
        unsafe { self.instance.calls_of(utils).set_debug_utils_object_name(&info) }
            .map_err(call("vkSetDebugUtilsObjectNameEXT"))
    }

    pub(super) fn allocate(
        &self,
        name: &str,
        requirements: vk::MemoryRequirements,
        location: MemoryLocation,
        linear: bool,
    ) -> Result<Allocation, GpuError> {
        let allocation_scheme = AllocationScheme::GpuAllocatorManaged;
        let desc = AllocationCreateDesc { name, requirements, location, linear, allocation_scheme };
        let failed = |source| GpuError::Memory { bytes: requirements.size, name: name.to_owned(), source };
        self.made[0].fetch_add(1, Ordering::Relaxed);
        let no_allocator = || failed(gpu_allocator::AllocationError::NoCompatibleMemoryTypeFound);
        let mut allocator = lock(&self.allocator);
        let _share = self.instance.share();
        allocator.as_mut().ok_or_else(no_allocator)?.allocate(&desc).map_err(failed)
    }

    pub(super) fn free(&self, allocation: Allocation) {
        let mut allocator = lock(&self.allocator);
        let _share = self.instance.share();
        if let Some(allocator) = allocator.as_mut() {
            // Freeing only fails for allocations of another allocator.
            let freed = allocator.free(allocation);
            debug_assert!(freed.is_ok(), "{freed:?}");
        }
    }

    /// Submits commands to the queue; the device signals the fence when they are complete.
    pub(super) fn submit(&self, commands: vk::CommandBuffer, fence: vk::Fence) -> Result<(), GpuError> {
        let buffers = [commands];
        let info = vk::SubmitInfo::default().command_buffers(&buffers);
        let queue = lock(&self.queue);
        // SAFETY: the lock gives this thread exclusive access to the queue; the command buffer is recorded
        // and not pending.
        unsafe { self.calls().queue_submit(*queue, &[info], fence) }.map_err(call("vkQueueSubmit"))
    }

    /// Waits for a submit. Afterwards all of its commands are complete, and the host may read results.
    pub(super) fn wait(&self, fence: vk::Fence) -> Result<(), GpuError> {
        let longest = self.instance.longest_wait();
        let waited = loop {
            // SAFETY: the fence belongs to this device and was submitted.
            match unsafe { self.calls().wait_for_fences(&[fence], true, longest) } {
                Err(vk::Result::TIMEOUT) => {}
                waited => break waited,
            }
        };
        if waited.is_err() {
            // Nothing may run after this function returns, whatever the error; a lost device runs nothing.
            let _queue = lock(&self.queue);
            // SAFETY: the lock gives this thread exclusive access to the queue.
            let _ = unsafe { self.calls().device_wait_idle() };
        }
        waited.map_err(call("vkWaitForFences"))?;
        // SAFETY: the fence is signaled, so no submit uses it.
        unsafe { self.calls().reset_fences(&[fence]) }.map_err(call("vkResetFences"))?;
        self.check_validation()
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn candidate(instance: &Instance, physical: vk::PhysicalDevice) -> Candidate {
    // SAFETY: the handle comes from this instance.
    let properties = unsafe { instance.calls().get_physical_device_properties(physical) };
    let is_new = properties.api_version >= vk::API_VERSION_1_1;
    Candidate {
        name: text(properties.device_name_as_c_str()),
        kind: properties.device_type,
        identity: DeviceIdentity::read(instance, physical, is_new),
        usable: is_new && queue_family(instance, physical).is_some(),
    }
}

/// Returns the first queue family with graphics and compute, and the number of valid bits in its timestamps.
fn queue_family(instance: &Instance, physical: vk::PhysicalDevice) -> Option<(u32, u32)> {
    // SAFETY: the handle comes from this instance.
    let families = unsafe { instance.calls().get_physical_device_queue_family_properties(physical) };
    let index = families.iter().position(|f| f.queue_flags.contains(QUEUE_NEEDS))?;
    Some((index as u32, families[index].timestamp_valid_bits))
}

fn facts(
    instance: &Instance,
    physical: vk::PhysicalDevice,
    timestamp_bits: u32,
) -> Result<DeviceProperties, GpuError> {
    // SAFETY: the handle comes from this instance.
    let extensions = unsafe { instance.calls().enumerate_device_extension_properties(physical) };
    let extensions = extensions.map_err(call("vkEnumerateDeviceExtensionProperties"))?;
    let has_driver =
        extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(khr::driver_properties::NAME));
    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut maintenance = vk::PhysicalDeviceMaintenance3Properties::default();
    let mut all = vk::PhysicalDeviceProperties2::default().push_next(&mut maintenance);
    if has_driver {
        all = all.push_next(&mut driver);
    }
    // SAFETY: the handle comes from this 1.1 instance; the device supports each chained structure.
    unsafe { instance.calls().get_physical_device_properties2(physical, &mut all) };
    let properties = all.properties;
    let has_atomics =
        extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(khr::shader_atomic_int64::NAME));
    let mut atomics = vk::PhysicalDeviceShaderAtomicInt64Features::default();
    let mut all_features = vk::PhysicalDeviceFeatures2::default();
    if has_atomics {
        all_features = all_features.push_next(&mut atomics);
    }
    // SAFETY: as above.
    unsafe { instance.calls().get_physical_device_features2(physical, &mut all_features) };
    let features = all_features.features;
    let atomics_64 = features.shader_int64 == vk::TRUE && atomics.shader_buffer_int64_atomics == vk::TRUE;
    let (name, info) = (text(driver.driver_name_as_c_str()), text(driver.driver_info_as_c_str()));
    let version = properties.driver_version;
    Ok(DeviceProperties {
        name: text(properties.device_name_as_c_str()),
        kind: properties.device_type,
        driver: if has_driver { format!("{name} {info}") } else { format!("version {version:#x}") },
        limits: properties.limits,
        max_allocation: maintenance.max_memory_allocation_size,
        large_points: features.large_points == vk::TRUE,
        atomics_64,
        timestamp_bits,
    })
}

fn create(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    queue_family: u32,
    facts: &DeviceProperties,
) -> Result<ash::Device, GpuError> {
    let queue =
        vk::DeviceQueueCreateInfo::default().queue_family_index(queue_family).queue_priorities(&[1.0]);
    let queues = [queue];
    let features =
        vk::PhysicalDeviceFeatures::default().large_points(facts.large_points).shader_int64(facts.atomics_64);
    let extensions = [khr::shader_atomic_int64::NAME.as_ptr()];
    let mut atomics =
        vk::PhysicalDeviceShaderAtomicInt64Features::default().shader_buffer_int64_atomics(true);
    let mut info = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_features(&features);
    if facts.atomics_64 {
        info = info.enabled_extension_names(&extensions).push_next(&mut atomics);
    }
    let _alone = gate::alone();
    // SAFETY: the handle comes from this instance; the device has this queue family, these features and the
    // extension.
    unsafe { instance.create_device(physical, &info, None) }.map_err(call("vkCreateDevice"))
}

fn text(name: Result<&std::ffi::CStr, std::ffi::FromBytesUntilNulError>) -> String {
    name.map_or_else(|_| "(unnamed)".into(), |n| n.to_string_lossy().into_owned())
}

impl Drop for Device {
    fn drop(&mut self) {
        // Frees all memory. No buffer or image is left, since each holds an `Arc` of the device.
        let allocator = lock(&self.allocator).take();
        let share = self.instance.share();
        drop(allocator);
        drop(share);
        let _alone = gate::alone();
        // SAFETY: all child objects are destroyed for the same reason, and every submit was waited for.
        unsafe { self.raw.destroy_device(None) };
    }
}
