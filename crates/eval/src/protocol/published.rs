//! Figures of the paper *Point as Skeleton* (arXiv 2607.06516), as published.

/// Published figures of a method.
pub(super) struct Published {
    /// Name of the protocol.
    pub(super) protocol: &'static str,
    /// Name of its part.
    pub(super) part: &'static str,
    /// Name of the method.
    pub(super) method: &'static str,
    /// Fréchet distance of Inception features.
    pub(super) fid: f64,
    /// Fréchet distance of I3D features.
    pub(super) fvd: Option<f64>,
    /// IoU of vehicles, percent.
    pub(super) iou: Option<f64>,
}

/// Data and lengths of these figures are those of the parts; their starts and references may differ.
pub(super) const PUBLISHED: [Published; 3] = [
    Published {
        protocol: "nuscenes-val",
        part: "6hz",
        method: "Point as Skeleton, video network",
        fid: 5.97,
        fvd: Some(58.3),
        iou: None,
    },
    Published {
        protocol: "nuscenes-val",
        part: "2hz",
        method: "Point as Skeleton, image network",
        fid: 7.09,
        fvd: Some(69.5),
        iou: None,
    },
    Published {
        protocol: "nuplan-simgen",
        part: "lane_change",
        method: "Point as Skeleton, image network",
        fid: 27.85,
        fvd: None,
        iou: Some(58.57),
    },
];
