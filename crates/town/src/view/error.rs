use point_skeleton::gpu::GpuError;
use point_skeleton::memory::MemoryError;

/// Error of rendering the town.
#[derive(Debug, thiserror::Error)]
pub enum MeshRenderError {
    /// The device or driver failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// More memory is needed than available.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// A triangle has a corner that its mesh does not have.
    #[error("expected corners below {corners} in the triangles of mesh {mesh}, found {corner}")]
    Corner {
        /// Index of the mesh.
        mesh: usize,
        /// Number of its corners.
        corners: usize,
        /// The invalid index.
        corner: u32,
    },
    /// There are more corners than 32-bit indices can address.
    #[error("expected fewer than 2^32 corners in all meshes, found more")]
    TooManyCorners,
    /// A draw has the index of a mesh that does not exist.
    #[error("expected meshes below {meshes}, found {mesh} in draw {draw}")]
    UnknownMesh {
        /// Index of the draw.
        draw: usize,
        /// The invalid index.
        mesh: usize,
        /// Number of meshes.
        meshes: usize,
    },
}
