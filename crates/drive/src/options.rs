use std::net::SocketAddr;
use std::path::PathBuf;

use point_skeleton::raster::RasterizerDesc;

/// Options of a live page.
#[derive(Clone, Debug)]
pub struct DriveOptions {
    /// Address to listen on; port 0 for any free one.
    pub address: SocketAddr,
    /// Folder for saved drives.
    pub out: PathBuf,
    /// Rasterizer and device.
    pub rasterizer: RasterizerDesc,
    /// Template library, used for kinds without a template in the skeleton.
    pub templates: Option<PathBuf>,
}
