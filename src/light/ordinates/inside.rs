//! The box of the medium, on a grid of its own. Outside of it radiance goes on as it came: a pass has something to do only
//! inside, and what light is to be had outside is found once, when the light inside is.
//!
//! σ is 0 in the voxels along its faces, or they are the grid's, and in all voxels beside them. So what enters the box is what
//! enters the grid, and a pass over the box gives the bits of a pass over the grid.

use super::ScatterProblem;
use super::equation::State;
use crate::device::{Buffer, Device};
use crate::error::Result;
use crate::grid::{Grid, Region};

/// Voxels along an edge of the cells that the box is made of.
const CELL: usize = 2;

/// Share of the grid above which a box is not worth its last pass over the grid.
const LARGE: f64 = 0.8;

/// Delta-scaled optics of the channel at work in the box of the medium.
pub(super) struct Inside {
    pub region: Region,
    pub grid: Grid,
    pub sigma: Buffer,
    pub scattering: Buffer,
    pub emission: Buffer,
    pub first: Vec<Buffer>,
    /// σ of cells.
    cells: Buffer,
    found: Vec<f32>,
}

impl Inside {
    pub fn new(device: &dyn Device, grid: &Grid) -> Result<Self> {
        let volume = || device.alloc(grid.len());
        let cells: usize = cells(grid.size).into_iter().product();
        Ok(Inside {
            region: grid.region(),
            grid: *grid,
            sigma: volume()?,
            scattering: volume()?,
            emission: device.alloc(0)?,
            first: vec![],
            cells: device.alloc(cells)?,
            found: vec![0.0; cells],
        })
    }

    /// Finds the box outside of which `sigma` is 0; empty where there is no medium.
    pub fn find(&mut self, device: &dyn Device, grid: &Grid, sigma: &Buffer) -> Result<()> {
        let (size, cells) = (grid.size, cells(grid.size));
        device.restrict(size, sigma, cells, &mut self.cells)?;
        device.download(&self.cells, &mut self.found)?;
        let (mut low, mut high) = (cells, [0; 3]);
        for (row, values) in self.found.chunks_exact(cells[0]).enumerate() {
            let holds = |v: &f32| *v > 0.0;
            let (Some(first), Some(last)) = (values.iter().position(holds), values.iter().rposition(holds)) else {
                continue;
            };
            let [j, k] = [row % cells[1], row / cells[1]];
            low = [low[0].min(first), low[1].min(j), low[2].min(k)];
            high = [high[0].max(last + 1), high[1].max(j + 1), high[2].max(k + 1)];
        }
        // And a voxel where there is nothing: light is looked up there too.
        let start: [usize; 3] = std::array::from_fn(|a| (low[a] * size[a] / cells[a]).saturating_sub(1));
        let end: [usize; 3] = std::array::from_fn(|a| ((high[a] * size[a]).div_ceil(cells[a]) + 1).min(size[a]));
        let region = Region { start, size: std::array::from_fn(|a| end[a].saturating_sub(start[a])) };
        let share = region.len() as f64 / grid.len() as f64;
        self.region = match high {
            [0, ..] => Region { start: [0; 3], size: [0; 3] },
            _ if share > LARGE => grid.region(),
            _ => region,
        };
        let origin = std::array::from_fn(|a| grid.origin[a] + self.region.start[a] as f64 * grid.spacing[a]);
        self.grid = Grid { size: self.region.size, origin, ..*grid };
        Ok(())
    }

    /// Room for the optics of a problem in the box.
    pub fn fit(&mut self, device: &dyn Device, problem: &ScatterProblem) -> Result<()> {
        let (len, most) = (self.grid.len(), problem.sigma.len());
        while self.first.len() < problem.first.len() {
            self.first.push(device.alloc(most)?);
        }
        if !problem.emission.is_empty() && self.emission.is_empty() {
            self.emission = device.alloc(most)?;
        }
        let given = [&mut self.sigma, &mut self.scattering].into_iter().chain(&mut self.first);
        let all = given.chain((!problem.emission.is_empty()).then_some(&mut self.emission));
        all.into_iter().try_for_each(|b| device.resize(b, len))
    }

    /// True where the box is the grid.
    pub fn is_all_of(&self, grid: &Grid) -> bool {
        self.region == grid.region()
    }
}

/// Cells along each axis.
fn cells(size: [usize; 3]) -> [usize; 3] {
    size.map(|n| n.div_ceil(CELL))
}

/// What passes over the grid need beside what passes over the box do.
pub(super) struct Whole<'a> {
    pub grid: &'a Grid,
    pub region: Region,
    pub sigma: &'a Buffer,
    /// Scratch: S and its gradient.
    pub source: &'a mut State,
    /// φ and J of the latest pass over the grid.
    pub out: &'a mut State,
}

impl State {
    /// Takes the values of a region of a state on a grid of `size`.
    pub fn crop(&mut self, device: &dyn Device, from: &State, size: [usize; 3], region: Region) -> Result<()> {
        self.parts_mut().zip(from.parts()).try_for_each(|(into, from)| device.crop(size, from, region, into))
    }

    /// Takes the values of a state of a region, 0 elsewhere.
    pub fn embed(&mut self, device: &dyn Device, from: &State, region: Region, size: [usize; 3]) -> Result<()> {
        self.parts_mut().zip(from.parts()).try_for_each(|(into, from)| device.embed(region, from, size, into))
    }
}
