//! Each kernel of a device on volumes larger than memory: by slabs, or on whole volumes in files.

use std::ops::Range;
use std::sync::Arc;

use super::store::{Content, Data, Index, Recipe, Store};
use super::stream::Feed;
use super::{LEAST, Paged, slabs, store, store_mut};
use crate::device::convection::{Convected, Convection, Layers};
use crate::device::slices::Slices;
use crate::device::surface::{Beauty, Environment, Hit, Occlusion, Samples, Subsurface, Surfaces};
use crate::device::{
    Behind, Buffer, Device, Lamp, March, Optic, Part, PointSweep, RUN, Ray, Rays, SourceTerm, Storage, Sweep, Tally,
    Term, Trace, Traced, Transport,
};
use crate::error::{Error, Result};
use crate::field::Field;
use crate::frame::Frame;
use crate::grid::{BrickLayout, Grid, Region, Slab};
use crate::transfer::Table;

impl Device for Paged {
    fn name(&self) -> String {
        format!("{}, {} MiB at a time", self.inner.name(), self.budget >> 20)
    }

    fn pages(&self) -> bool {
        true
    }

    /// Half as much at a time on the same device, down to an eighth of a GiB; then what would go on with that device's work.
    fn instead(&self) -> Option<Arc<dyn Device>> {
        let other = self.inner.instead()?;
        let (inner, budget) = match self.budget / 2 {
            half if half >= LEAST => (self.inner.clone(), half),
            _ => (other, self.budget.max(LEAST)),
        };
        Some(Arc::new(Paged::new(inner, budget, &self.folder).keeping(self.precision)))
    }

    fn alloc(&self, len: usize) -> Result<Buffer> {
        Ok(Buffer(Storage::Paged(Box::new(Store::new(len, Content::Zero)))))
    }

    fn upload(&self, values: &[f32], into: &mut Buffer) -> Result<()> {
        let store = store_mut(into);
        self.prepare(store)?;
        match &mut store.content {
            Content::Resident(buffer, _) => self.inner.upload(values, buffer),
            Content::Scratch(scratch) => scratch.write(0, values),
            _ => unreachable!("just prepared"),
        }
    }

    fn download(&self, from: &Buffer, out: &mut [f32]) -> Result<()> {
        match &store(from).content {
            Content::Zero => out.fill(0.0),
            Content::Resident(buffer, _) => self.inner.download(buffer, out)?,
            Content::Scratch(scratch) => scratch.read(0, out)?,
            Content::Data(data) => drop(data.read(&Slab::whole(data.size), out, &self.read)?),
            Content::Optic(_) => self.parts(store(from), |at, len, values| {
                out[at..at + len].copy_from_slice(self.on_host(values, 0, len, &mut vec![])?);
                Ok(())
            })?,
        }
        Ok(())
    }

    fn take(
        &self,
        grid: &Grid,
        field: &Arc<dyn Field>,
        bricks: &BrickLayout,
        _: &mut Vec<f32>,
        into: &mut Buffer,
    ) -> Result<(u64, Vec<[f32; 2]>)> {
        let mut data = Data { field: field.clone(), size: grid.size, clean: false, index: None };
        let taken = self.look_through(&data, bricks)?;
        data.clean = taken.0 == 0;
        data.index = Some(Arc::new(Index { bricks: *bricks, ranges: taken.1.clone() }));
        *store_mut(into) = Store::new(grid.len(), Content::Data(data));
        Ok(taken)
    }

    fn copy(&self, from: &Buffer, start: usize, len: usize, into: &mut Buffer, at: usize) -> Result<()> {
        self.whole(&[from], &mut [into], 0, |device, from, into| device.copy(from[0], start, len, into[0], at))
    }

    fn classify_slab(
        &self,
        optic: Optic,
        table: &Table,
        data: &Slab,
        field: &Buffer,
        light: &Slab,
        out: &mut Buffer,
    ) -> Result<()> {
        assert!(*data == Slab::whole(data.size) && *light == Slab::whole(light.size), "slabs are cut here");
        let Content::Data(of) = &store(field).content else {
            return Err(Error::Unsupported("extinction of what is not a step's data".into()));
        };
        let recipe = Recipe { optic, table: table.clone(), data: of.clone(), size: light.size };
        let recipe = Store::new(light.len(), Content::Optic(Box::new(recipe)));
        let out = store_mut(out);
        if !self.small(out.len) {
            *out = recipe;
            return Ok(());
        }
        self.map(
            (&recipe, light.size),
            (out, light.size),
            |p| p,
            |v, slab, out| self.inner.copy(v, 0, slab.len(), out, 0),
        )
    }

    fn classify_each(
        &self,
        optics: &mut [(Optic, &mut Buffer)],
        table: &Table,
        data: [usize; 3],
        field: &Buffer,
        size: [usize; 3],
    ) -> Result<()> {
        let plane = size[0] * size[1];
        let of = store(field);
        let each = Feed::weight(of, data, size[2]) + plane as f64;
        let more = 4.0 * (data[0] * data[1]) as f64;
        optics.iter_mut().try_for_each(|(_, out)| self.prepare(store_mut(out)))?;
        let depth = self.depth(size[2], each, more)?;
        let slabs = slabs(size[2], depth);
        let light = |n: usize| Slab { size, planes: slabs[n].clone() };
        let planes: Vec<_> = (0..slabs.len()).map(|n| light(n).under(data[2])).collect();
        let mut made = self.inner.alloc(plane * depth)?;
        let rows = match &of.content {
            Content::Data(data) => data.shown(table, &planes),
            _ => vec![0..data[1]; planes.len()],
        };
        self.stream_rows(&[Feed { store: of, size: data, planes: planes.clone() }], &[rows], |n, volumes| {
            let (light, data) = (light(n), Slab { size: data, planes: planes[n].clone() });
            optics.iter_mut().try_for_each(|(optic, out)| {
                self.inner.classify_slab(*optic, table, &data, volumes[0], &light, &mut made)?;
                self.put(&made, 0, light.len(), store_mut(out), light.planes.start * plane)
            })
        })
    }

    fn brick_range(&self, layout: &BrickLayout, field: &Buffer) -> Result<Vec<[f32; 2]>> {
        match &store(field).content {
            Content::Data(data) => Ok(self.look_through(data, layout)?.1),
            _ => self.whole(&[field], &mut [], 0, |device, from, _| device.brick_range(layout, from[0])),
        }
    }

    /// Anything may have changed: to find out would be to read the data once more and extinction before, and a cold sweep reads
    /// the data alone.
    fn change(&self, layout: &BrickLayout, _: &Buffer, _: &Buffer) -> Result<Vec<[f32; 3]>> {
        Ok(vec![[f32::INFINITY; 3]; layout.len()])
    }

    fn restrict_slab(&self, fine: &Slab, values: &Buffer, coarse: &Slab, out: &mut Buffer) -> Result<()> {
        assert!(*fine == Slab::whole(fine.size) && *coarse == Slab::whole(coarse.size), "slabs are cut here");
        let under = |planes: Range<usize>| Slab { size: coarse.size, planes }.under(fine.size[2]);
        self.map((store(values), fine.size), (store_mut(out), coarse.size), under, |v, slab, out| {
            let held = Slab { size: fine.size, planes: under(slab.planes.clone()) };
            self.inner.restrict_slab(&held, v, slab, out)
        })
    }

    fn sweep(
        &self,
        sweep: &Sweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        self.sweep_slabs(sweep, layout, sigma, rho, fronts)
    }

    fn sweep_each(&self, lights: &mut [(Sweep, &mut Buffer)], layout: &BrickLayout, sigma: &Buffer) -> Result<()> {
        for upward in [false, true] {
            let way = lights.iter_mut().filter(|(sweep, _)| sweep.ascending()[2] == upward);
            let mut way: Vec<_> = way.map(|(sweep, rho)| (*sweep, &mut **rho)).collect();
            self.sweep_alike(&mut way, layout, sigma)?;
        }
        Ok(())
    }

    fn sweep_point(
        &self,
        sweep: &PointSweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        self.sweep_point_slabs(sweep, layout, sigma, rho, fronts)
    }

    fn irradiate(&self, lamp: &Lamp, grid: &Grid, planes: Range<usize>, rho: &Buffer, out: &mut Buffer) -> Result<()> {
        assert!(planes == (0..grid.size[2]), "slabs are cut here");
        self.planes(grid.size, 0, &[rho], &mut [out], |held, volumes, made| {
            self.inner.irradiate(lamp, grid, held, volumes[0], made[0])
        })
    }

    fn source(&self, term: &SourceTerm, source: &mut Buffer, gradient: Option<[&mut Buffer; 3]>) -> Result<()> {
        self.source_slabs(term, source, gradient)
    }

    fn transport(&self, t: &Transport, phi: &mut Buffer, current: Option<[&mut Buffer; 3]>) -> Result<(f32, f32)> {
        self.transport_slabs(t, phi, current)
    }

    fn convect_layers(
        &self,
        convection: &Convection,
        layers: Layers,
        sigma: &Buffer,
        before: &Buffer,
        rho: &mut Buffer,
    ) -> Result<Convected> {
        self.whole(&[sigma, before], &mut [rho], 0, |device, from, into| {
            device.convect_layers(convection, layers, from[0], from[1], into[0])
        })
    }

    fn convect_whole(&self, convection: &Convection, sigma: &Buffer, before: &Buffer, rho: &mut Buffer) -> Result<f32> {
        self.whole(&[sigma, before], &mut [rho], 0, |device, from, into| {
            device.convect_whole(convection, from[0], from[1], into[0])
        })
    }

    fn convect_ordered(
        &self,
        convection: &Convection,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        self.whole(&[sigma], &mut [rho], 0, |device, from, into| {
            device.convect_ordered(convection, layout, from[0], into[0], fronts)
        })
    }

    fn diffuse(&self, size: [usize; 3], weights: [&[f32]; 3], values: &mut Buffer) -> Result<()> {
        self.whole(&[], &mut [values], 0, |device, _, into| device.diffuse(size, weights, into[0]))
    }

    fn relax(
        &self,
        size: [usize; 3],
        coupling: [f32; 3],
        rhs: &Buffer,
        values: &mut Buffer,
        colour: usize,
    ) -> Result<()> {
        self.whole(&[rhs], &mut [values], 0, |device, from, into| {
            device.relax(size, coupling, from[0], into[0], colour)
        })
    }

    fn residual(
        &self,
        size: [usize; 3],
        coupling: [f32; 3],
        rhs: &Buffer,
        values: &Buffer,
        out: &mut Buffer,
    ) -> Result<f32> {
        self.whole(&[rhs, values], &mut [out], 0, |device, from, into| {
            device.residual(size, coupling, from[0], from[1], into[0])
        })
    }

    fn prolong(&self, coarse: [usize; 3], values: &Buffer, size: [usize; 3], into: &mut Buffer) -> Result<()> {
        self.prolong_slabs(coarse, values, size, into)
    }

    fn prolong_slab(&self, _: &Slab, _: &Buffer, _: &Slab, _: &mut Buffer) -> Result<()> {
        Err(Error::Unsupported("a slab of a volume that is paged already".into()))
    }

    fn combine(&self, terms: &[(&Buffer, f32)], out: &mut Buffer) -> Result<()> {
        self.combine_runs(terms, out)
    }

    fn dot_parts(&self, a: &Buffer, b: &Buffer) -> Result<Vec<f64>> {
        self.dot_runs(a, b)
    }

    fn distance(&self, a: &Buffer, b: &Buffer) -> Result<f32> {
        self.largest_of(a, b, |a, b| self.inner.distance(a, b))
    }

    fn largest_ratio(&self, a: &Buffer, b: &Buffer) -> Result<f32> {
        self.largest_of(a, b, |a, b| self.inner.largest_ratio(a, b))
    }

    fn fill(&self, value: f32, into: &mut Buffer) -> Result<()> {
        let store = store_mut(into);
        self.prepare(store)?;
        if let Content::Resident(inner, _) = &mut store.content {
            return self.inner.fill(value, inner);
        }
        let values = vec![value; RUN.min(store.len)];
        let Content::Scratch(scratch) = &store.content else { unreachable!("just prepared") };
        let runs = slabs(store.len, RUN);
        runs.into_iter().try_for_each(|run| scratch.write(run.start, &values[..run.len()]))
    }

    fn compose(&self, terms: &[(&Buffer, [f32; 3])], out: &mut [[f32; 3]]) -> Result<()> {
        // Value by value: planes may as well be single values.
        let size = [1, 1, out.len()];
        let each = terms.iter().map(|(v, _)| Feed::weight(store(v), size, out.len())).sum();
        let parts = slabs(out.len(), self.depth(out.len(), each, 0.0)?);
        let feeds: Vec<Feed> =
            terms.iter().map(|(v, _)| Feed { store: store(v), size, planes: parts.clone() }).collect();
        if feeds.is_empty() {
            return self.inner.compose(&[], out);
        }
        self.stream(&feeds, |n, volumes| {
            let terms: Vec<_> = volumes.iter().zip(terms).map(|(v, (_, weight))| (*v, *weight)).collect();
            self.inner.compose(&terms, &mut out[parts[n].clone()])
        })
    }

    fn march(&self, march: &March, frame: &mut Frame) -> Result<()> {
        match reaches_beyond(march) {
            true => self.march_whole(march, size_of_val(&frame.pixels[..]), |device, march| device.march(march, frame)),
            false => self.march_slabs(march, frame),
        }
    }

    fn march_slab(&self, _: &March, _: &Part, _: &mut Rays) -> Result<()> {
        Err(Error::Unsupported("a slab of volumes that are cut into slabs already".into()))
    }

    fn gradient(&self, grid: &Grid, field: &Buffer, out: &mut Buffer) -> Result<()> {
        self.whole(&[field], &mut [out], 0, |device, from, into| device.gradient(grid, from[0], into[0]))
    }

    fn classify_graded(
        &self,
        optic: Optic,
        table: &Table,
        (data, field, gradient): ([usize; 3], &Buffer, &Buffer),
        size: [usize; 3],
        out: &mut Buffer,
    ) -> Result<()> {
        self.whole(&[field, gradient], &mut [out], 0, |device, from, into| {
            device.classify_graded(optic, table, (data, from[0], from[1]), size, into[0])
        })
    }

    fn slice(&self, slices: &Slices, rays: &mut [Ray]) -> Result<()> {
        let from: Vec<&Buffer> = [slices.field].into_iter().chain(slices.gradient).collect();
        self.whole(&from, &mut [], size_of_val(rays), |device, from, _| {
            device.slice(&Slices { field: from[0], gradient: from.get(1).copied(), ..*slices }, rays)
        })
    }

    fn surface_hits(&self, surfaces: &Surfaces, hits: &mut [Hit]) -> Result<()> {
        self.whole(&[surfaces.field], &mut [], size_of_val(hits), |device, from, _| {
            device.surface_hits(&Surfaces { field: from[0], ..*surfaces }, hits)
        })
    }

    fn surface_occlusion(
        &self,
        surfaces: &Surfaces,
        occlusion: &Occlusion,
        samples: Samples,
        hits: &[Hit],
        sums: &mut [[f32; 4]],
    ) -> Result<()> {
        self.whole(&[surfaces.field], &mut [], size_of_val(hits), |device, from, _| {
            device.surface_occlusion(&Surfaces { field: from[0], ..*surfaces }, occlusion, samples, hits, sums)
        })
    }

    fn surface_beauty(
        &self,
        surfaces: &Surfaces,
        beauty: &Beauty,
        hits: &[Hit],
        sums: &mut [[[f32; 3]; 2]],
    ) -> Result<()> {
        self.whole(&[surfaces.field, beauty.environment.texels], &mut [], size_of_val(hits), |device, from, _| {
            let environment = Environment { texels: from[1], ..beauty.environment };
            let (surfaces, beauty) = (Surfaces { field: from[0], ..*surfaces }, Beauty { environment, ..*beauty });
            device.surface_beauty(&surfaces, &beauty, hits, sums)
        })
    }

    fn surface_subsurface(
        &self,
        surfaces: &Surfaces,
        subsurface: &Subsurface,
        hits: &[Hit],
        sums: &mut [[f32; 3]],
    ) -> Result<()> {
        self.whole(&[surfaces.field, subsurface.environment.texels], &mut [], size_of_val(hits), |device, from, _| {
            let environment = Environment { texels: from[1], ..subsurface.environment };
            let surfaces = Surfaces { field: from[0], ..*surfaces };
            device.surface_subsurface(&surfaces, &Subsurface { environment, ..*subsurface }, hits, sums)
        })
    }

    fn surface_light(&self, surfaces: &Surfaces, term: &Term, hits: &[Hit], sums: &mut [[[f32; 3]; 2]]) -> Result<()> {
        self.whole(&[surfaces.field, term.values], &mut [], size_of_val(hits), |device, from, _| {
            let (surfaces, term) = (Surfaces { field: from[0], ..*surfaces }, Term { values: from[1], ..*term });
            device.surface_light(&surfaces, &term, hits, sums)
        })
    }

    fn march_before(&self, march: &March, behind: &[Behind], frame: &mut Frame) -> Result<()> {
        if reaches_beyond(march) {
            let beside = size_of_val(behind) + size_of_val(&frame.pixels[..]);
            return self.march_whole(march, beside, |device, march| device.march_before(march, behind, frame));
        }
        let mut rays = Rays::new(frame.size, behind.iter().map(Behind::ray).collect());
        self.march_rays(march, &mut rays)?;
        let pixels = behind.iter().zip(&rays.each).map(|(behind, ray)| behind.pixel(ray));
        frame.pixels.iter_mut().zip(pixels).for_each(|(to, pixel)| *to = pixel);
        Ok(())
    }

    fn sample(&self, size: [usize; 3], values: &Buffer, points: &[[f32; 3]], out: &mut [f32]) -> Result<()> {
        self.whole(&[values], &mut [], size_of_val(points), |device, from, _| device.sample(size, from[0], points, out))
    }

    fn trace(&self, trace: &Trace, picture: [usize; 2], tallies: &mut [Tally]) -> Result<Traced> {
        let from: Vec<&Buffer> = [trace.field].into_iter().chain(trace.gradient).collect();
        self.whole(&from, &mut [], size_of_val(tallies), |device, from, _| {
            let (gradient, samples) = (from.get(1).copied(), trace.samples.clone());
            device.trace(&Trace { field: from[0], gradient, samples, ..*trace }, picture, tallies)
        })
    }

    fn trace_tiles(
        &self,
        trace: &Trace,
        tiles: &[u32],
        picture: [usize; 2],
        tallies: &mut [Tally],
        touched: &mut [u64],
    ) -> Result<Traced> {
        let from: Vec<&Buffer> = [trace.field].into_iter().chain(trace.gradient).collect();
        let beside = size_of_val(tallies) + size_of_val(touched);
        self.whole(&from, &mut [], beside, |device, from, _| {
            let (gradient, samples) = (from.get(1).copied(), trace.samples.clone());
            let trace = Trace { field: from[0], gradient, samples, ..*trace };
            device.trace_tiles(&trace, tiles, picture, tallies, touched)
        })
    }

    fn on_threads(&self, work: &mut (dyn FnMut() + Send)) {
        self.inner.on_threads(work);
    }

    fn crop(&self, size: [usize; 3], values: &Buffer, region: Region, out: &mut Buffer) -> Result<()> {
        self.crop_slabs(size, values, region, out)
    }

    fn embed(&self, region: Region, values: &Buffer, size: [usize; 3], out: &mut Buffer) -> Result<()> {
        self.embed_slabs(region, values, size, out)
    }
}

/// True where a sample looks farther than a slab's planes.
fn reaches_beyond(march: &March) -> bool {
    march.table.preintegrated || march.table.graded.is_some()
}
