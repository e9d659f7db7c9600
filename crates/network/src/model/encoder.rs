use super::images::{Images, Stage};
use super::parameters::{Arrays, Module};
use crate::NetworkConfig;
use crate::inputs::PLANES;

/// Encoder of conditions at a quarter of the size.
#[derive(Clone, Debug)]
pub(super) struct Encoder {
    at4: Stage,
    at8: Stage,
    at16: Stage,
    at32: Stage,
    up16: Stage,
}

/// Features of a frame at 1/4, 1/8 and 1/16 of the size, `[V, H, W, C]`.
#[derive(Clone, Debug)]
pub(super) struct Features {
    pub(super) at4: Images,
    pub(super) at8: Images,
    pub(super) at16: Images,
}

impl Encoder {
    pub(super) fn read<A: Arrays>(
        config: &NetworkConfig,
        mut module: Module<'_, A>,
    ) -> Result<Self, A::Error> {
        let [c4, c8, c16, c32] = config.encoder;
        Ok(Self {
            at4: module.stage("at4", PLANES, c4)?,
            at8: module.stage("at8", c4, c8)?,
            at16: module.stage("at16", c8, c16)?,
            at32: module.stage("at32", c16, c32)?,
            up16: module.stage("up16", c32 + c16, c16)?,
        })
    }

    /// Encodes the conditions of 4x4 pixels, `[V, H/4, W/4, 16]`.
    pub(super) fn encode(&self, planes: &Images) -> Features {
        let at4 = self.at4.of(planes);
        let at8 = self.at8.of(&at4.halved());
        let at16 = self.at16.of(&at8.halved());
        let at32 = self.at32.of(&at16.halved());
        let at16 = self.up16.of(&Images::joined(&[&at32.doubled(), &at16]));
        Features { at4, at8, at16 }
    }
}
