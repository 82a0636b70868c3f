//! Direct light slab after slab: only the last plane of one is carried to the next.

use super::store::Content;
use super::stream::Feed;
use super::{Paged, slabs, store, store_mut};
use crate::device::{Buffer, Sweep};
use crate::error::Result;
use crate::grid::BrickLayout;

impl Paged {
    /// True where extinction is in memory, and its light may be too.
    fn fits_beside(&self, sigma: &Buffer, rho: &Buffer) -> bool {
        let near = |b: &Buffer| matches!(store(b).content, Content::Resident(..));
        near(sigma) && (near(rho) || self.small(rho.len()))
    }

    /// See [`Device::sweep`](crate::device::Device::sweep).
    pub(super) fn sweep_slabs(
        &self,
        sweep: &Sweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        if let Content::Resident(near, _) = &store(sigma).content
            && self.fits_beside(sigma, rho)
        {
            return self.inner.sweep(sweep, layout, near, self.near_mut(rho)?, fronts);
        }
        if sweep.cubic {
            // A cubic foot reaches beyond the plane that slabs leave.
            return self.whole(&[sigma], &mut [rho], 0, |device, from, into| {
                device.sweep(sweep, layout, from[0], into[0], fronts)
            });
        }
        // All bricks, also where only some are asked for: light comes through the others.
        self.sweep_alike(&mut [(*sweep, rho)], layout, sigma)?;
        Ok(vec![f32::INFINITY; fronts.iter().map(|f| f.len()).sum()])
    }

    /// Sweeps for lights that cross planes the same way, in one reading of extinction where that has to be read.
    pub(super) fn sweep_alike(
        &self,
        lights: &mut [(Sweep, &mut Buffer)],
        layout: &BrickLayout,
        sigma: &Buffer,
    ) -> Result<()> {
        let alone = |(sweep, rho): &(Sweep, &mut Buffer)| sweep.cubic || self.fits_beside(sigma, rho);
        if lights.iter().any(alone) {
            return lights.iter_mut().try_for_each(|(sweep, rho)| {
                let fronts = layout.fronts(sweep.ascending());
                let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
                self.sweep_slabs(sweep, layout, sigma, rho, &fronts).map(drop)
            });
        }
        let Some((first, _)) = lights.first() else { return Ok(()) };
        let ([nx, ny, nz], ascending) = (first.size, first.ascending()[2]);
        let plane = nx * ny;
        for (_, rho) in &mut *lights {
            self.prepare_in(store_mut(rho), self.precision)?;
        }
        let sigma = store(sigma);
        let each = Feed::weight(sigma, [nx, ny, nz], nz) + plane as f64;
        // σ and ρ of the plane before and data under it; ρ of that plane once more for each light.
        let depth = self.depth(nz, each, each + (plane * lights.len()) as f64)?;
        let mut slabs = slabs(nz, depth);
        if !ascending {
            slabs.reverse();
        }
        let planes = slabs.iter().map(|s| match ascending {
            true => s.start.saturating_sub(1)..s.end,
            false => s.start..(s.end + 1).min(nz),
        });
        let feed = Feed { store: sigma, size: [nx, ny, nz], planes: planes.collect() };
        let mut light = self.inner.alloc(plane * (depth + 1).min(nz))?;
        let mut faces = lights.iter().map(|_| self.inner.alloc(plane)).collect::<Result<Vec<_>>>()?;
        self.stream(&[feed], |n, volumes| {
            let (slab, given) = (&slabs[n], n > 0);
            let size = [nx, ny, slab.len() + usize::from(given)];
            // Where the slab's own planes begin, where the one before it is, and where its last is.
            let own = if given && ascending { plane } else { 0 };
            let before = if ascending { 0 } else { plane * slab.len() };
            let last = if ascending { own + plane * (slab.len() - 1) } else { 0 };
            let bricks = BrickLayout::new(size, layout.edge);
            for ((sweep, rho), face) in lights.iter_mut().zip(&mut faces) {
                if given {
                    self.inner.copy(face, 0, plane, &mut light, before)?;
                }
                let fronts = bricks.fronts(sweep.ascending());
                let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
                self.inner.sweep(&Sweep { size, given, ..*sweep }, &bricks, volumes[0], &mut light, &fronts)?;
                self.inner.copy(&light, last, plane, face, 0)?;
                self.put(&light, own, plane * slab.len(), store_mut(rho), plane * slab.start)?;
            }
            Ok(())
        })
    }
}
