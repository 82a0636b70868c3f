//! Cameras in world space.

use glam::{DVec3, Vec3};

use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::scene::CameraKeys;

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
    /// What is out of focus, in path tracing.
    pub lens: Lens,
}

/// A thin lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Radius of the aperture, world length; 0 has everything in focus.
    pub radius: f32,
    /// World length along the view that is in focus; `None`: where the middle ray meets the medium first.
    pub focus: Option<f32>,
    /// Corners of the aperture, a regular polygon in the circle of `radius`, the first on top; below 3 it is the circle.
    pub blades: u32,
}

impl Lens {
    /// Everything is in focus.
    pub const PINHOLE: Lens = Lens { radius: 0.0, focus: None, blades: 0 };
}

impl Camera {
    /// Looks from `eye` at `target`; `fov` is vertical, in degrees.
    pub fn look_at(eye: Vec3, target: Vec3, up: Vec3, fov: f32) -> Self {
        let forward = (target - eye).normalize();
        let right = forward.cross(up).normalize();
        Camera {
            eye,
            forward,
            right,
            up: right.cross(forward),
            tan: (0.5 * fov.to_radians()).tan(),
            lens: Lens::PINHOLE,
        }
    }

    /// Unit direction through the centre of pixel (x, y) of a picture of `size`.
    pub fn ray(&self, size: [usize; 2], x: f32, y: f32) -> Vec3 {
        let (w, h) = (size[0] as f32, size[1] as f32);
        let (px, py) = (self.tan * w / h * (2.0 * (x + 0.5) / w - 1.0), self.tan * (2.0 * (y + 0.5) / h - 1.0));
        (self.forward + px * self.right - py * self.up).normalize()
    }
    /// The camera of a scene at some step of a series: see the keys of [`CameraKeys`].
    ///
    /// - Azimuth 0 looks along +y with x to the right where z is up (along −z with x to the right where y is up); growing
    ///   azimuth carries the eye anticlockwise as seen from above.
    /// - Without a position the eye stands so that the volume's box fits the picture both ways with a small margin; where
    ///   the camera orbits, it fits at every azimuth, so that a movie is steady.
    /// - `orbit·steps_since_first` degrees are added to the azimuth, or turn a given position about the target.
    /// - `zoom` magnifies the picture as a lens does: the eye stays where it is.
    ///
    /// `aspect` is width over height of the picture. Errors are [`Error::Scene`] naming `cameras.KEY`.
    pub fn framed(keys: &CameraKeys, grid: &Grid, aspect: f64, steps_since_first: u64) -> Result<Self> {
        let wrong = |key: &str, message: String| {
            let of = if keys.name.is_empty() { String::new() } else { format!(" (camera \"{}\")", keys.name) };
            Err(Error::scene(format!("cameras.{key}"), message + &of))
        };
        if !(1.0..=170.0).contains(&keys.fov) {
            return wrong("fov", format!("{} is not between 1 and 170 degrees", keys.fov));
        }
        if !(keys.zoom > 0.0 && keys.zoom.is_finite()) {
            return wrong("zoom", format!("{} is not above 0; 1 shows the whole volume", keys.zoom));
        }
        for (key, degrees) in [("azimuth", keys.azimuth), ("elevation", keys.elevation), ("orbit", keys.orbit)] {
            if !degrees.is_finite() {
                return wrong(key, format!("{degrees} is not a number of degrees"));
            }
        }
        let given = [("position", keys.position), ("target", keys.target), ("up", Some(keys.up))];
        if let Some((key, _)) = given.iter().find(|(_, v)| v.is_some_and(|v| !v.iter().all(|c| c.is_finite()))) {
            return wrong(key, "every component must be a finite number".into());
        }
        let up = DVec3::from(keys.up).normalize_or_zero();
        if up == DVec3::ZERO {
            return wrong("up", "[0, 0, 0] is no direction; [0, 0, 1] is the default".into());
        }

        let (lo, hi) = grid.bounds();
        let target = keys.target.map_or(0.5 * (lo + hi), DVec3::from);
        let turn = (keys.orbit * steps_since_first as f64) % 360.0;
        let tan = (0.5 * keys.fov).to_radians().tan();
        let (eye, view, up) = match keys.position {
            Some(position) => {
                let offset = glam::DQuat::from_axis_angle(up, turn.to_radians()) * (DVec3::from(position) - target);
                let view = (-offset).normalize_or_zero();
                if view == DVec3::ZERO {
                    return wrong("position", "is where the camera looks at (`target`): move one of them".into());
                }
                if view.cross(up).length() < 1e-6 {
                    return wrong("up", "is along the view: choose another axis, such as [0, 1, 0]".into());
                }
                (target + offset, view, up)
            }
            None => {
                let orbit = Orbit::new(up, keys.elevation);
                let azimuth = keys.azimuth + turn;
                let azimuths = if keys.orbit == 0.0 { vec![azimuth] } else { (0..360).map(f64::from).collect() };
                let distance = azimuths
                    .iter()
                    .map(|&a| orbit.distance(a, [lo - target, hi - target], tan, aspect))
                    .fold(0.0, f64::max);
                let (view, up) = orbit.view(azimuth);
                (target - distance * view, view, up)
            }
        };
        let right = view.cross(up).normalize();
        Ok(Camera {
            eye: eye.as_vec3(),
            forward: view.as_vec3(),
            right: right.as_vec3(),
            up: right.cross(view).as_vec3(),
            tan: (tan / keys.zoom) as f32,
            lens: Lens {
                radius: (0.5 * keys.aperture) as f32,
                focus: keys.focus.map(|f| f as f32),
                blades: keys.blades,
            },
        })
    }
}

/// Views from all azimuths at one elevation.
struct Orbit {
    up: DVec3,
    /// View and right at azimuth 0, horizontal.
    ahead: DVec3,
    right: DVec3,
    /// Sine and cosine of the elevation.
    elevation: (f64, f64),
}

impl Orbit {
    /// Share of the picture that a framed volume may fill.
    const FILL: f64 = 0.95;

    fn new(up: DVec3, elevation: f64) -> Self {
        let reference = if up.x.abs() < 0.9 { DVec3::X } else { DVec3::Y };
        let ahead = up.cross(reference).normalize();
        Orbit { up, ahead, right: ahead.cross(up), elevation: elevation.to_radians().sin_cos() }
    }

    /// Unit vectors of view and of the picture's top; defined at the poles too.
    fn view(&self, azimuth: f64) -> (DVec3, DVec3) {
        let (sin, cos) = azimuth.to_radians().sin_cos();
        let level = cos * self.ahead - sin * self.right;
        let (rise, run) = self.elevation;
        (run * level - rise * self.up, rise * level + run * self.up)
    }

    /// How far the eye must stand from the target for the box between `corners` (relative to the target) to fit.
    fn distance(&self, azimuth: f64, corners: [DVec3; 2], tan: f64, aspect: f64) -> f64 {
        let (view, up) = self.view(azimuth);
        let right = view.cross(up);
        (0..8)
            .map(|c| {
                let corner = DVec3::from_array(std::array::from_fn(|a| corners[c >> a & 1][a]));
                let needed = (corner.dot(up).abs() / tan).max(corner.dot(right).abs() / (tan * aspect));
                needed / Self::FILL - corner.dot(view)
            })
            .fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        Grid { size: [40, 20, 60], spacing: [0.5, 1.0, 0.25], origin: [3.0, -7.0, 100.0] }
    }

    /// Largest |x| and |y| of the box's corners on the picture, 1 at its border; `None` when a corner is behind the eye.
    fn extent(camera: &Camera, grid: &Grid, aspect: f64) -> Option<[f64; 2]> {
        let (lo, hi) = grid.bounds();
        let mut extent = [0.0f64; 2];
        for c in 0..8 {
            let corner = DVec3::from_array(std::array::from_fn(|a| if c >> a & 1 == 1 { hi[a] } else { lo[a] }));
            let q = corner - camera.eye.as_dvec3();
            let depth = q.dot(camera.forward.as_dvec3());
            if depth <= 0.0 {
                return None;
            }
            let half = depth * f64::from(camera.tan);
            extent[0] = extent[0].max(q.dot(camera.right.as_dvec3()).abs() / (half * aspect));
            extent[1] = extent[1].max(q.dot(camera.up.as_dvec3()).abs() / half);
        }
        Some(extent)
    }

    #[test]
    fn a_still_camera_fills_the_picture_and_no_more() {
        for (aspect, azimuth, elevation) in
            [(1.0, 0.0, 0.0), (16.0 / 9.0, 30.0, 20.0), (0.4, 200.0, -70.0), (1.0, 5.0, 90.0)]
        {
            let keys = CameraKeys { azimuth, elevation, ..Default::default() };
            let camera = Camera::framed(&keys, &grid(), aspect, 0).unwrap();
            let [x, y] = extent(&camera, &grid(), aspect).expect("in front of the eye");
            assert!((x.max(y) - 0.95).abs() < 1e-4, "fills {x} {y}");
            assert!(camera.forward.dot(camera.up).abs() < 1e-5 && camera.right.dot(camera.up).abs() < 1e-5);
        }
    }

    #[test]
    fn an_orbiting_camera_keeps_its_distance_and_always_shows_the_box() {
        let keys = CameraKeys { orbit: 7.3, ..Default::default() };
        let (lo, hi) = grid().bounds();
        let centre = (0.5 * (lo + hi)).as_vec3();
        let at = |step| Camera::framed(&keys, &grid(), 1.5, step).unwrap();
        for step in 0..200 {
            let camera = at(step);
            assert!((camera.eye.distance(centre) - at(0).eye.distance(centre)).abs() < 1e-4);
            let [x, y] = extent(&camera, &grid(), 1.5).expect("in front of the eye");
            assert!(x.max(y) < 0.96, "step {step}: {x} {y}");
        }
        // 360/7.3 steps later it has gone round nearly once; ten turns of 36° are a full turn exactly.
        let keys = CameraKeys { orbit: 36.0, ..keys };
        let [first, tenth] = [0, 10].map(|step| Camera::framed(&keys, &grid(), 1.5, step).unwrap());
        assert_eq!(first, tenth);
    }

    #[test]
    fn azimuth_elevation_and_up_point_where_the_docs_say() {
        let camera = |azimuth, elevation, up| {
            Camera::framed(&CameraKeys { azimuth, elevation, up, ..Default::default() }, &grid(), 1.0, 0).unwrap()
        };
        let near = |a: Vec3, b: Vec3| assert!((a - b).length() < 1e-5, "{a} is not {b}");
        near(camera(0.0, 0.0, [0.0, 0.0, 1.0]).forward, Vec3::Y);
        near(camera(0.0, 0.0, [0.0, 0.0, 1.0]).right, Vec3::X);
        near(camera(90.0, 0.0, [0.0, 0.0, 2.0]).forward, -Vec3::X);
        near(camera(0.0, 90.0, [0.0, 0.0, 1.0]).forward, -Vec3::Z);
        near(camera(0.0, 90.0, [0.0, 0.0, 1.0]).up, Vec3::Y);
        near(camera(0.0, 0.0, [0.0, 1.0, 0.0]).forward, -Vec3::Z);
        near(camera(0.0, 0.0, [0.0, 1.0, 0.0]).right, Vec3::X);
    }

    #[test]
    fn position_target_and_zoom_are_honoured() {
        let keys = CameraKeys {
            position: Some([1.0, 2.0, 3.0]),
            target: Some([1.0, 5.0, 3.0]),
            zoom: 2.0,
            fov: 90.0,
            orbit: 90.0,
            ..Default::default()
        };
        let camera = Camera::framed(&keys, &grid(), 1.0, 0).unwrap();
        assert_eq!((camera.eye, camera.forward), (Vec3::new(1.0, 2.0, 3.0), Vec3::Y));
        assert!((camera.tan - 0.5).abs() < 1e-6);
        let turned = Camera::framed(&keys, &grid(), 1.0, 1).unwrap();
        assert!((turned.eye - Vec3::new(4.0, 5.0, 3.0)).length() < 1e-5, "{}", turned.eye);
    }

    #[test]
    fn impossible_cameras_are_named_by_their_key() {
        let good = || CameraKeys::default();
        let cases = [
            ("cameras.fov", CameraKeys { fov: 0.5, ..good() }),
            ("cameras.fov", CameraKeys { fov: f64::NAN, ..good() }),
            ("cameras.zoom", CameraKeys { zoom: 0.0, ..good() }),
            ("cameras.elevation", CameraKeys { elevation: f64::INFINITY, ..good() }),
            ("cameras.up", CameraKeys { up: [0.0; 3], ..good() }),
            ("cameras.position", CameraKeys { position: Some([1.0; 3]), target: Some([1.0; 3]), ..good() }),
            ("cameras.position", CameraKeys { position: Some([f64::NAN, 0.0, 0.0]), ..good() }),
            ("cameras.up", CameraKeys { position: Some([0.0; 3]), target: Some([0.0, 0.0, -4.0]), ..good() }),
        ];
        for (expected, keys) in cases {
            match Camera::framed(&keys, &grid(), 1.0, 0) {
                Err(Error::Scene { key, .. }) => assert_eq!(key, expected),
                other => panic!("{expected}: {other:?}"),
            }
        }
    }
}
