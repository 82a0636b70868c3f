//! Direct light slab after slab: only the last plane of one is carried to the next.

use super::store::Content;
use super::stream::Feed;
use super::{Paged, slabs, store, store_mut};
use crate::device::{Buffer, Sweep};
use crate::error::{Error, Result};
use crate::grid::BrickLayout;

impl Paged {
    /// See [`Device::sweep`](crate::device::Device::sweep).
    pub(super) fn sweep_slabs(
        &self,
        sweep: &Sweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        if let Content::Resident(sigma, _) = &store(sigma).content
            && (matches!(store(rho).content, Content::Resident(..)) || self.small(rho.len()))
        {
            return self.inner.sweep(sweep, layout, sigma, self.near_mut(rho)?, fronts);
        }
        let listed = fronts.iter().map(|f| f.len()).sum::<usize>();
        if listed != layout.len() {
            return Err(Error::Unsupported("sweeping some bricks of a volume that does not fit in memory".into()));
        }
        if sweep.cubic {
            let remedy = "light.interpolation = \"bilinear\", or more --memory";
            return Err(Error::Unsupported(format!(
                "light.interpolation = \"cubic\" where a volume does not fit in memory\n  try: {remedy}"
            )));
        }
        self.sweep_all(sweep, layout, sigma, rho)?;
        Ok(vec![f32::INFINITY; listed])
    }

    fn sweep_all(&self, sweep: &Sweep, layout: &BrickLayout, sigma: &Buffer, rho: &mut Buffer) -> Result<()> {
        let [nx, ny, nz] = sweep.size;
        let plane = nx * ny;
        let rho = store_mut(rho);
        self.prepare(rho)?;
        let sigma = store(sigma);
        let each = Feed::weight(sigma, sweep.size, nz) + plane as f64;
        // σ and ρ of the plane before, once more where it is kept, and data under it.
        let depth = self.depth(nz, each, each + plane as f64)?;
        let ascending = sweep.ascending()[2];
        let mut slabs = slabs(nz, depth);
        if !ascending {
            slabs.reverse();
        }
        let planes = slabs.iter().map(|s| match ascending {
            true => s.start.saturating_sub(1)..s.end,
            false => s.start..(s.end + 1).min(nz),
        });
        let feed = Feed { store: sigma, size: sweep.size, planes: planes.collect() };
        let mut light = self.inner.alloc(plane * (depth + 1).min(nz))?;
        let mut face = self.inner.alloc(plane)?;
        self.stream(&[feed], |n, volumes| {
            let (slab, given) = (&slabs[n], n > 0);
            let size = [nx, ny, slab.len() + usize::from(given)];
            // Where the slab's own planes begin, where the one before it is, and where its last is.
            let own = if given && ascending { plane } else { 0 };
            let before = if ascending { 0 } else { plane * slab.len() };
            let last = if ascending { own + plane * (slab.len() - 1) } else { 0 };
            if given {
                self.inner.copy(&face, 0, plane, &mut light, before)?;
            }
            let bricks = BrickLayout::new(size, layout.edge);
            let fronts = bricks.fronts(sweep.ascending());
            let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
            self.inner.sweep(&Sweep { size, given, ..*sweep }, &bricks, volumes[0], &mut light, &fronts)?;
            self.inner.copy(&light, last, plane, &mut face, 0)?;
            self.put(&light, own, plane * slab.len(), rho, plane * slab.start)
        })
    }
}
