//! Transfer functions: from data values to optical properties.

/// A transfer function, tabulated: entry `i` of `n` stands for the normalised value `i/(n−1)`; in between it is linear, and
/// values outside 0..1 are clamped.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Data value that maps to 0.
    pub lo: f32,
    /// Data value that maps to 1.
    pub hi: f32,
    /// Extinction σ_t per world length.
    pub extinction: Vec<f32>,
    /// Single-scattering albedo ω per channel.
    pub albedo: Vec<[f32; 3]>,
    /// Emitted radiance per world length and channel; empty when nothing glows.
    pub emission: Vec<[f32; 3]>,
}

impl Table {
    /// Entries of every table.
    pub const ENTRIES: usize = 1024;

    /// The normalised value of a data value, clamped to 0..1.
    pub fn normalise(&self, value: f32) -> f32 {
        ((value - self.lo) * self.scale()).clamp(0.0, 1.0)
    }

    /// `1/(hi − lo)`, 0 when the range is a point.
    pub fn scale(&self) -> f32 {
        if self.hi > self.lo { 1.0 / (self.hi - self.lo) } else { 0.0 }
    }

    /// The albedo, when it is the same for every value.
    pub fn constant_albedo(&self) -> Option<[f32; 3]> {
        self.albedo.iter().all(|a| *a == self.albedo[0]).then(|| self.albedo[0])
    }

    /// True when the albedo is the same in all channels for every value.
    pub fn gray(&self) -> bool {
        self.albedo.iter().all(|a| a[0] == a[1] && a[1] == a[2])
    }
}
