//! Rays through slab after slab, outward from the eye: a ray crosses planes in one order, so all slabs that it has met are
//! done before the next that it meets, and takes its samples in the order in which it always does.

use std::ops::Range;

use glam::DVec3;

use super::store::Content;
use super::stream::Feed;
use super::{Paged, slabs, store};
use crate::device::{March, Part, Ray, Rays, Term};
use crate::error::Result;
use crate::frame::Frame;

impl Paged {
    /// See [`Device::march`](crate::device::Device::march).
    pub(super) fn march_slabs(&self, march: &March, frame: &mut Frame) -> Result<()> {
        let mut rays = Rays::new(frame.size, vec![Ray::FRESH; frame.pixels.len()]);
        self.march_rays(march, &mut rays)?;
        frame.pixels.iter_mut().zip(&rays.each).for_each(|(p, r)| *p = r.pixel());
        Ok(())
    }

    /// Carries the rays of a picture through all slabs.
    pub(super) fn march_rays(&self, march: &March, rays: &mut Rays) -> Result<()> {
        let size = march.grid.size;
        if march.grid.is_empty() || rays.each.is_empty() {
            return Ok(());
        }
        let (data, cells) = (store(march.field), (size[2] - 1).max(1));
        let sizes: Vec<[usize; 3]> = march.terms.iter().map(|t| t.grid.size).collect();
        let lit = march.terms.iter().zip(&sizes).map(|(t, &s)| (store(t.values), s));
        // Those that are in memory stay there as a whole.
        let paged = |t: &Term| !matches!(store(t.values).content, Content::Resident(..));
        let volumes = || std::iter::once((data, size)).chain(lit.clone().filter(|(s, _)| !is_near(s)));
        let each: f64 = volumes().map(|(s, size)| Feed::weight(s, size, cells)).sum();
        let shade = usize::from(march.phong.is_some());
        let held_by_rays = size_of_val(&rays.each[..]) as f64 / 4.0;
        // Planes beyond the cells: one above, with shading one more on both sides, and of light two for rounding.
        let depth = self.depth(cells, each, (3.0 + 2.0 * shade as f64) * each + held_by_rays)?;
        let order = outward(slabs(cells, depth), eye(march));
        let order: Vec<Range<usize>> = order.into_iter().filter(|slab| visible(march, slab)).collect();

        let held = |slab: &Range<usize>| slab.start.saturating_sub(shade)..(slab.end + 1 + shade).min(size[2]);
        let over = |slab: &Range<usize>, of: usize| {
            // Where the ends of the slab lie on a term's grid, and a plane more for rounding.
            let at = |z: usize| (z as f64 + 0.5) * of as f64 / size[2] as f64 - 0.5;
            let lo = if slab.start == 0 { 0.0 } else { at(slab.start).floor() - 1.0 };
            let hi = if slab.end == cells { of as f64 } else { at(slab.end).floor() + 3.0 };
            (lo.max(0.0) as usize).min(of.saturating_sub(2))..(hi.max(2.0) as usize).min(of)
        };
        let mut feeds = vec![Feed { store: data, size, planes: order.iter().map(held).collect() }];
        for term in march.terms {
            let of = term.grid.size;
            let planes = match paged(term) && of != size {
                _ if !paged(term) => vec![0..of[2]; order.len()],
                true => order.iter().map(|slab| over(slab, of[2])).collect(),
                false => order.iter().map(held).collect(),
            };
            feeds.push(Feed { store: store(term.values), size: of, planes });
        }
        let seen = seen(march);
        let rows: Vec<Vec<Range<usize>>> = feeds
            .iter()
            .map(|feed| {
                let at = |y: usize| (y as f64 + 0.5) * feed.size[1] as f64 / size[1] as f64 - 0.5;
                let end = (at(seen.end).ceil() as usize + 2).min(feed.size[1]);
                vec![(at(seen.start).floor() as usize).saturating_sub(1).min(end)..end; order.len()]
            })
            .collect();
        self.stream_rows(&feeds, &rows, |n, volumes| {
            let terms: Vec<Term> = march
                .terms
                .iter()
                .zip(&volumes[1..])
                .map(|(t, values)| Term { values, grid: t.grid, weight: t.weight })
                .collect();
            let part = Part {
                cells: order[n].clone(),
                field: feeds[0].planes[n].clone(),
                terms: feeds[1..].iter().map(|f| f.planes[n].clone()).collect(),
            };
            let march = March { field: volumes[0], terms: &terms, ..*march };
            self.inner.march_slab(&march, &part, rays)
        })
    }
}

fn is_near(store: &super::Store) -> bool {
    matches!(store.content, Content::Resident(..))
}

/// The cell along z that the eye is in, or the nearest.
fn eye(march: &March) -> usize {
    let eye = (march.camera.eye.as_dvec3() - DVec3::from(march.grid.origin)) / DVec3::from(march.grid.spacing);
    // As the kernel rounds it; the cast takes what is below to 0.
    (eye.as_vec3().z as usize).min(march.grid.size[2].saturating_sub(2))
}

/// Slabs in the order in which rays from cell `eye` meet them: its own, those above, those below.
fn outward(slabs: Vec<Range<usize>>, eye: usize) -> Vec<Range<usize>> {
    let own = slabs.iter().position(|s| s.contains(&eye)).unwrap_or(0);
    let (below, above) = slabs.split_at(own);
    above.iter().chain(below.iter().rev()).cloned().collect()
}

/// Rows of the data between which lies all that can be seen, with a brick more on both sides.
fn seen(march: &March) -> Range<usize> {
    let [bx, by, _] = march.bricks.counts();
    let of_row = |row: &[f32]| row.iter().any(|&m| m > 0.0);
    let shows: Vec<usize> = match march.majorant.is_empty() {
        true => (0..by).collect(),
        false => march.majorant.chunks_exact(bx).enumerate().filter(|(_, r)| of_row(r)).map(|(n, _)| n % by).collect(),
    };
    let (first, last) = (shows.iter().min().copied().unwrap_or(0), shows.iter().max().copied().unwrap_or(0));
    let edge = march.bricks.edge;
    first.saturating_sub(1) * edge..((last + 2) * edge).min(march.grid.size[1])
}

/// True where some brick that a sample of the slab may be in shows something.
fn visible(march: &March, slab: &Range<usize>) -> bool {
    if march.majorant.is_empty() {
        return true;
    }
    let [bx, by, bz] = march.bricks.counts();
    let edge = march.bricks.edge;
    let layers = slab.start / edge..slab.end.div_ceil(edge).min(bz);
    march.majorant[layers.start * bx * by..layers.end * bx * by].iter().any(|&m| m > 0.0)
}
