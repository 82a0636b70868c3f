//! gloaming lights time-varying volumes.
//!
//! It takes one timestep after another from a file series or a running simulation, solves where the light goes
//! **starting from the previous step's light**, and writes lit frames, a movie or the illuminated volume itself.
//!
//! The modules, from the bottom up (imports point only downwards):
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`error`], [`grid`], [`dtype`], [`field`] | errors by who can act; grids, regions and bricks; types of numbers; timesteps readable by region |
//! | [`geometry`] | opaque meshes in the volume |
//! | [`detail`] | noise finer than the data |
//! | [`transfer`], [`lights`], [`camera`], [`scene`] | what the user describes: the TOML scene file |
//! | [`device`] | kernels: arithmetic on voxels and rays, on the CPU and as WGSL |
//! | [`medium`], [`light`], [`render`] | algorithms: what to classify, sweep, iterate, skip and march |
//! | [`source`], [`sink`] | file formats in, file formats out |
//! | [`mod@compare`] | how far two pictures are apart |
//! | [`clip`] | media that are cut away |
//! | [`light_state`] | light kept in a file between runs |
//! | [`session`], [`pipeline`] | one timestep; a whole series, reading, lighting and writing at once |
//! | [`insitu`] | a running simulation that hands over its steps |
//! | [`preview`] | a series seen through means over blocks of its voxels |
//! | [`memory`] | what a run takes, and volumes larger than that |
//! | [`histogram`] | how often values and gradients occur, to design transfer functions by |
//! | [`savings`] | what the warm start saves, measured |
//!
//! Axis order is (z, y, x) in memory, x fastest; sizes are written `[nx, ny, nz]`.

pub mod camera;
pub mod clip;
pub mod compare;
pub mod detail;
pub mod device;
pub mod dtype;
pub mod error;
pub mod field;
pub mod frame;
#[doc(hidden)]
pub mod fuzz;
pub mod geometry;
pub mod grid;
pub mod histogram;
pub mod insitu;
pub mod ledger;
pub mod light;
pub mod light_state;
pub mod lights;
pub mod medium;
pub mod memory;
pub mod pipeline;
pub mod preview;
pub mod render;
pub mod savings;
pub mod scene;
pub mod session;
pub mod sink;
pub mod source;
pub mod transfer;
mod whole;

pub use error::{Error, Result};
pub use grid::{BrickLayout, Grid, Region};

/// The examples of the readme are tested.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
