//! Pinhole cameras in world space.

use glam::Vec3;

/// A perspective camera. Pixel (x, y) of a `w`×`h` picture looks along
/// `forward + tan·(aspect·(2(x+½)/w − 1)·right − (2(y+½)/h − 1)·up)`, row 0 on top.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Eye.
    pub eye: Vec3,
    /// Unit vector of view.
    pub forward: Vec3,
    /// Unit vector to the right of the picture.
    pub right: Vec3,
    /// Unit vector to the top of the picture.
    pub up: Vec3,
    /// Tangent of half the vertical field of view.
    pub tan: f32,
}

impl Camera {
    /// Looks from `eye` at `target`; `fov` is vertical, in degrees.
    pub fn look_at(eye: Vec3, target: Vec3, up: Vec3, fov: f32) -> Self {
        let forward = (target - eye).normalize();
        let right = forward.cross(up).normalize();
        Camera { eye, forward, right, up: right.cross(forward), tan: (0.5 * fov.to_radians()).tan() }
    }

    /// Unit direction through the centre of pixel (x, y) of a picture of `size`.
    pub fn ray(&self, size: [usize; 2], x: f32, y: f32) -> Vec3 {
        let (w, h) = (size[0] as f32, size[1] as f32);
        let (px, py) = (self.tan * w / h * (2.0 * (x + 0.5) / w - 1.0), self.tan * (2.0 * (y + 0.5) / h - 1.0));
        (self.forward + px * self.right - py * self.up).normalize()
    }
}
impl Camera {
    /// Looks at the centre of the volume from its front.
    pub fn framed(_k: &crate::scene::CameraKeys, grid: &crate::Grid, _aspect: f64, _s: u64) -> crate::Result<Camera> {
        let (lo, hi) = grid.bounds();
        let c = ((lo + hi) * 0.5).as_vec3();
        Ok(Camera::look_at(c + Vec3::new(0.3, -2.5, 0.6) * (hi - lo).as_vec3().x, c, Vec3::Z, 35.0))
    }
}
