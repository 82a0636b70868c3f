//! Frames: scene-linear pictures before exposure and tone mapping.

/// A picture. Pixels are scene-linear radiance, premultiplied by coverage, RGBA, row 0 on top, before background,
/// exposure and tone mapping.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Width and height in pixels.
    pub size: [usize; 2],
    /// `width·height` pixels.
    pub pixels: Vec<[f32; 4]>,
}

impl Frame {
    /// A transparent frame.
    pub fn new(size: [usize; 2]) -> Self {
        Frame { size, pixels: vec![[0.0; 4]; size[0] * size[1]] }
    }
}
