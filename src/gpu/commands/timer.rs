//! Durations of stages, measured with the device's timestamps.

use std::sync::Arc;
use std::time::Duration;

use ash::vk;

use crate::gpu::error::call;
use crate::gpu::{Device, GpuError};

/// A pool of timestamp queries; one more than there are stages.
pub(in super::super) struct Timer {
    device: Arc<Device>,
    pub(in super::super) pool: vk::QueryPool,
}

impl Timer {
    /// Maximum timestamp count of one command buffer.
    pub(in super::super) const MAX: u32 = 16;

    /// Creates a pool; `None` if the queue has no timestamps.
    pub(in super::super) fn new(device: &Arc<Device>) -> Result<Option<Self>, GpuError> {
        if device.timestamp_bits() == 0 {
            return Ok(None);
        }
        let kind = vk::QueryType::TIMESTAMP;
        let info = vk::QueryPoolCreateInfo::default().query_type(kind).query_count(Self::MAX);
        // SAFETY: the create info contains no pointers.
        let pool = unsafe { device.calls().create_query_pool(&info, None) };
        let pool = pool.map_err(call("vkCreateQueryPool"))?;
        Ok(Some(Self { device: device.clone(), pool }))
    }

    /// Returns the durations between consecutive timestamps. `count + 1` of them must have been written
    /// and waited for.
    pub(in super::super) fn durations(&self, count: usize) -> Result<Vec<Duration>, GpuError> {
        let mut ticks = vec![0_u64; count + 1];
        let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WAIT;
        // SAFETY: the pool has `count + 1` queries, and completed commands wrote all of them.
        let got = unsafe { self.device.calls().get_query_pool_results(self.pool, 0, &mut ticks, flags) };
        got.map_err(call("vkGetQueryPoolResults"))?;
        let mask = u64::MAX >> (64 - self.device.timestamp_bits().clamp(1, 64));
        let ns_per_tick = f64::from(self.device.limits().timestamp_period);
        let time = |pair: &[u64]| {
            let ticks = pair[1].wrapping_sub(pair[0]) & mask;
            Duration::from_nanos((ticks as f64 * ns_per_tick) as u64)
        };
        Ok(ticks.windows(2).map(time).collect())
    }
}

impl Drop for Timer {
    fn drop(&mut self) {
        // SAFETY: no commands use the pool, since every submit is waited for.
        unsafe { self.device.calls().destroy_query_pool(self.pool, None) };
    }
}
