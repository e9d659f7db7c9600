//! The state of one step: where ego, cameras and actors stand. What the rasterizer and the layout are fed.

mod state;

pub use state::{ActorState, SceneCamera, SceneState};
