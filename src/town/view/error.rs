use crate::gpu::GpuError;

/// What went wrong while filming.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// The device or driver.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// A triangle names a corner that its mesh does not have.
    #[error("expected corners below {corners} in the triangles of mesh {mesh}, found {corner}")]
    Corner {
        /// Which mesh.
        mesh: usize,
        /// Its corners.
        corners: usize,
        /// What a triangle names.
        corner: u32,
    },
    /// More than a number of 32 bits tells apart.
    #[error("expected fewer than 2^32 corners in all meshes, found more")]
    TooManyCorners,
    /// A draw names a mesh that there is not.
    #[error("expected meshes below {meshes}, found {mesh} in draw {draw}")]
    UnknownMesh {
        /// Which draw.
        draw: usize,
        /// What it names.
        mesh: usize,
        /// How many there are.
        meshes: usize,
    },
}
