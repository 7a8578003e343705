//! The order of things: from files and rig descriptions to results.

mod load;
mod png;

pub use load::load_image;
pub use png::png_bytes;
