//! Images for people: the contact sheet, its canvas, and the preview of templates.

pub mod canvas;
pub mod sheet;
pub mod template_preview;
