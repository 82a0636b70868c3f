//! The medium of one step: data values on the device, the transfer function that gives them optics, and what each brick
//! holds, so that empty space is never marched.

use std::sync::{Arc, OnceLock};

use crate::clip::Clipped;
use crate::device::{Buffer, Clip, Device, Optic};
use crate::error::{Error, Result};
use crate::field::Timestep;
use crate::grid::{BrickLayout, Grid};
use crate::transfer::Table;

/// Classified data of one step. Its memory is used again for the next.
pub struct Medium {
    /// Where the values sit.
    pub grid: Grid,
    /// The values; holes are [`EMPTY`](crate::field::EMPTY).
    pub field: Buffer,
    /// Their gradient magnitudes, where the table is two-dimensional.
    pub gradient: Option<Buffer>,
    /// Values to optics.
    pub table: Table,
    /// Where it is kept: cut away, it neither shows nor casts shadows.
    pub clips: Vec<Clip>,
    /// Bricks for empty-space skipping.
    pub bricks: BrickLayout,
    /// Smallest and largest value of each brick with a halo of one.
    pub ranges: Vec<[f32; 2]>,
    /// Largest extinction or emission in each brick; 0 where nothing can be seen.
    pub majorant: Vec<f32>,
    /// The same of the step before.
    majorant_before: Vec<f32>,
    host: Vec<f32>,
    /// Values of the step before, once anybody asks what changed.
    before: Option<Buffer>,
    /// True when `before` holds a step.
    follows: bool,
    taken: bool,
    changed: OnceLock<Vec<bool>>,
    same_table: bool,
}

impl Medium {
    /// Edge of the bricks that rays skip: small, since smoke is thin and a skipped brick saves 8 samples of each ray.
    pub const EDGE: usize = 8;

    /// Allocates room for steps on `grid`.
    pub fn new(device: &dyn Device, grid: Grid, table: Table) -> Result<Self> {
        let bricks = BrickLayout::new(grid.size, Self::EDGE);
        Ok(Medium {
            field: device.alloc(grid.len())?,
            gradient: table.graded.is_some().then(|| device.alloc(grid.len())).transpose()?,
            clips: vec![],
            ranges: vec![],
            majorant: vec![],
            majorant_before: vec![],
            host: Vec::new(),
            before: None,
            follows: false,
            taken: false,
            changed: OnceLock::new(),
            same_table: false,
            grid,
            table,
            bricks,
        })
    }

    /// Keeps the values of the step before from now on, so that [`Medium::changed`] can tell: one more volume.
    pub fn remember(&mut self, device: &dyn Device) -> Result<()> {
        if self.before.is_none() {
            self.before = Some(device.alloc(self.grid.len())?);
        }
        Ok(())
    }

    /// For each of [`Medium::bricks`] whether its values, with a halo of one, differ in any bit from those of the step before; `None`
    /// when they are not known ([`Medium::remember`]). Looks once a step, and only when asked.
    pub fn changed(&self, device: &dyn Device) -> Result<Option<&[bool]>> {
        let Some(before) = self.before.as_ref().filter(|_| self.follows) else { return Ok(None) };
        if self.changed.get().is_none() {
            let change = device.change(&self.bricks, &self.field, before)?;
            // Not a number where both differ beyond what f32 holds: a change too.
            let _ = self.changed.set(change.iter().map(|c| !(c[0] == 0.0)).collect());
        }
        Ok(self.changed.get().map(|c| &c[..]))
    }

    /// True when the transfer function is that of the step before.
    pub fn same_table(&self) -> bool {
        self.same_table
    }

    /// For each of [`Medium::bricks`] whether it may look different than in the step before: what changed there, or in a halo of one
    /// value, can or could be seen; or of two values, where gradients are looked at. `None` when that is not known, or when everything
    /// may.
    pub fn looks_changed(&self, device: &dyn Device, gradients: bool) -> Result<Option<Vec<bool>>> {
        if !self.same_table || self.majorant_before.len() != self.majorant.len() {
            return Ok(None);
        }
        let seen = self.majorant.iter().zip(&self.majorant_before).map(|(now, before)| *now > 0.0 || *before > 0.0);
        let Some(changed) = self.changed(device)? else { return Ok(None) };
        // Gradients in the halo depend on the values beyond it.
        let beside = (gradients || self.gradient.is_some()).then(|| self.dilated(changed, |a, b| *a || b));
        let changed = beside.as_deref().unwrap_or(changed);
        Ok(Some(changed.iter().zip(seen).map(|(c, s)| *c && s).collect()))
    }

    /// True when every value and the transfer function are those of the step before.
    pub fn still(&self, device: &dyn Device) -> Result<bool> {
        Ok(self.same_table && self.changed(device)?.is_some_and(|c| !c.contains(&true)))
    }

    /// Takes in the values of a step: reads them, marks what is not finite or cut away as holes, hands them to the device and finds each
    /// brick's range. Returns the number of holes and the range of the other values (`None` when there are none).
    pub fn take(&mut self, device: &dyn Device, step: &Timestep) -> Result<(u64, Option<[f32; 2]>)> {
        if step.grid != self.grid {
            return Err(Error::Unsupported(format!(
                "step {} is on a grid of {:?} with spacing {:?}, the steps before on {:?} with spacing {:?}",
                step.step, step.grid.size, step.grid.spacing, self.grid.size, self.grid.spacing
            )));
        }
        self.changed.take();
        // A step that fails half-way leaves neither.
        let follows = std::mem::take(&mut self.taken);
        self.follows = false;
        if let Some(before) = &mut self.before {
            std::mem::swap(before, &mut self.field);
        }
        let field = match self.clips.is_empty() {
            true => step.field.clone(),
            false => Arc::new(Clipped { field: step.field.clone(), clips: self.clips.clone() }),
        };
        let (holes, ranges) = device.take(&self.grid, &field, &self.bricks, &mut self.host, &mut self.field)?;
        self.ranges = ranges;
        if let Some(gradient) = &mut self.gradient {
            device.gradient(&self.grid, &self.field, gradient)?;
        }
        (self.follows, self.taken) = (follows && self.before.is_some(), true);
        let (lo, hi) =
            self.ranges.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), r| (l.min(r[0]), h.max(r[1])));
        Ok((holes, (lo <= hi).then_some([lo, hi])))
    }

    /// Sets the transfer function and finds which bricks can be seen at all.
    pub fn classify(&mut self, table: Table) {
        self.same_table = self.table == table;
        self.table = table;
        let mut majorant = self.table.majorants(&self.ranges);
        if self.table.preintegrated {
            // An interval reaches beyond the brick that its middle is in.
            majorant = self.dilated(&majorant, |a, b| a.max(b));
        }
        self.majorant_before = std::mem::replace(&mut self.majorant, majorant);
    }

    /// For each brick what `join` makes of it and those around it.
    fn dilated<T: Copy>(&self, of: &[T], join: impl Fn(&T, T) -> T) -> Vec<T> {
        let counts = self.bricks.counts();
        let around = |b: usize| {
            let c = self.bricks.coords(b);
            let range = |a: usize| c[a].saturating_sub(1)..(c[a] + 2).min(counts[a]);
            let near = range(2).flat_map(move |z| range(1).flat_map(move |y| range(0).map(move |x| [x, y, z])));
            near.fold(of[b], |sum, at| join(&sum, of[self.bricks.number(at)]))
        };
        (0..self.bricks.len()).map(around).collect()
    }

    /// An optical property on a grid of `size` that fills the same box: see [`Device::classify`].
    pub fn property(&self, device: &dyn Device, optic: Optic, size: [usize; 3], out: &mut Buffer) -> Result<()> {
        match &self.gradient {
            Some(gradient) => {
                device.classify_graded(optic, &self.table, (self.grid.size, &self.field, gradient), size, out)
            }
            None => device.classify(optic, &self.table, self.grid.size, &self.field, size, out),
        }
    }

    /// Several of them; where data have to be read, once for all.
    pub fn properties(&self, device: &dyn Device, wanted: &mut [(Optic, &mut Buffer)], size: [usize; 3]) -> Result<()> {
        match &self.gradient {
            Some(_) => wanted.iter_mut().try_for_each(|(optic, out)| self.property(device, *optic, size, out)),
            None => device.classify_each(wanted, &self.table, self.grid.size, &self.field, size),
        }
    }
}
