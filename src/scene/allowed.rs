//! The keys of the scene file and the values they take, in words: the one place that messages quote.

/// Every key as `(dotted name, allowed values)`; keys of `[[lights]]` and `[[cameras]]` are written without their index.
pub(super) const KEYS: &[(&str, &str)] = &[
    ("field.name", "the name of a dataset or field, as `gloaming info` lists it"),
    ("field.range", "\"series\", \"step\", or [lo, hi] with lo < hi"),
    ("field.component", "\"magnitude\", \"x\", \"y\", \"z\", or an index from 0"),
    ("field.level", "a level of refinement from 0, the coarsest"),
    ("noise.amplitude", "a fraction of the value, 0 or more"),
    ("noise.about", "a value, finite"),
    ("noise.warp", "a length in voxels from 0 to 64"),
    ("noise.scale", "a length in voxels above 0"),
    ("noise.octaves", "an integer from 1 to 16"),
    ("noise.gain", "a number from 0 to 1"),
    ("noise.drift", "[x, y, z], world lengths per unit of time, finite"),
    ("noise.refine", "an integer from 1 to 8"),
    ("noise.seed", "an integer, 0 or more"),
    ("transfer.colormap", "the name of a colour map"),
    ("transfer.points", "[[value, red, green, blue], …], all 0 to 1, values in ascending order"),
    ("transfer.opacity", "[[value, opacity], …], both 0 to 1, values in ascending order"),
    ("transfer.reference", "a length in voxels above 0"),
    ("transfer.extinction", "an extinction per world length, 0 or more"),
    ("transfer.chromatic", "[red, green, blue], each finite, 0 or more, not all 0"),
    ("transfer.albedo", "a number or [red, green, blue], each 0 to 1"),
    ("transfer.anisotropy", "a number between -1 and 1, both excluded"),
    ("transfer.emission", "[[value, radiance], …], values 0 to 1 in ascending order, radiance 0 or more"),
    (
        "lights.kind",
        "\"distant\", \"point\", \"cone\", \"environment\", \"rectangle\", \"disk\", \"ring\", \"box\" or \"sphere\"",
    ),
    ("transfer.regions", "[[transfer.regions]] tables of shape, value, gradient, opacity, color, emission and edge"),
    ("transfer.painting", "the path of an OpenEXR or PNG image"),
    ("transfer.steepest", "ranges of the values per voxel, above 0"),
    ("transfer.preintegrated", "true or false"),
    ("lights.direction", "[x, y, z], finite and not all 0"),
    ("lights.position", "[x, y, z], finite"),
    ("lights.radius", "a world length, 0 or more"),
    ("lights.inner_radius", "a world length, 0 or more, below the radius"),
    ("lights.size", "world lengths above 0: [width, height] of a rectangle, [x, y, z] of a box"),
    ("lights.up", "[x, y, z], finite and not all 0"),
    ("lights.two_sided", "true or false"),
    ("lights.visible", "true or false"),
    ("lights.units", "\"radiance\", \"power\", \"exitance\" or \"intensity\""),
    ("lights.texture", "\"uniform\", \"checker\", \"gradient\" or \"bitmap\""),
    ("lights.second_color", "[red, green, blue], each finite and 0 or more"),
    ("lights.tiles", "[across, upwards], integers from 1 to 4096"),
    ("lights.angle", "degrees above 0, at most 90"),
    ("lights.edge", "degrees, 0 or more, at most the angle"),
    ("lights.color", "[red, green, blue], each finite and 0 or more"),
    ("lights.intensity", "a finite number, 0 or more"),
    ("lights.softness", "degrees from 0 to 90"),
    ("lights.samples", "1, 7 or 19"),
    (
        "lights.image",
        "the path of an OpenEXR, Radiance HDR or PNG image: equirectangular, of an environment, or of a texture \"bitmap\"",
    ),
    ("lights.gradient", "[bottom, horizon, top], colours of three finite numbers, 0 or more, and no image beside it"),
    ("meshes.path", "the path of a .obj, .stl or .ply file"),
    ("meshes.color", "[red, green, blue], each 0 to 1"),
    ("meshes.scale", "a factor above 0"),
    ("meshes.rotate", "[x, y, z] in degrees, finite"),
    ("meshes.position", "[x, y, z], finite"),
    ("light.model", "\"physical\" or \"paper\""),
    ("light.resolution", "a fraction above 0, at most 1, or an integer size from 2 to 4096"),
    ("light.direct_resolution", "a fraction above 0, at most 1, or an integer size from 2 to 4096"),
    ("light.interpolation", "\"bilinear\" or \"cubic\""),
    ("light.scattering", "true or false"),
    ("light.directions", "8, 32 or 128"),
    ("light.sigma_s", "[red, green, blue], each finite and 0 or more"),
    ("light.opacity_scale", "\"calibrated\" or \"literal\""),
    ("light.convection", "\"layers\", \"volume\" or \"ordered\""),
    ("light.iterations", "an integer from 1 to 10000"),
    ("light.budget_ms", "milliseconds above 0"),
    ("light.diffusion", "\"exact\", \"gauss-seidel\" or \"multigrid\""),
    ("light.falloff", "\"gaussian\" or \"physical\""),
    ("light.width", "a world length above 0"),
    ("light.tolerance", "0 (bitwise the cold result), or 1e-6 to 1: the light is held in 32-bit floats"),
    ("light.warm", "true or false"),
    ("cameras.name", "a name of its own for each camera, without / or \\"),
    ("cameras.azimuth", "degrees, finite"),
    ("cameras.elevation", "degrees from -90 to 90"),
    ("cameras.zoom", "a factor above 0"),
    ("cameras.fov", "degrees from 1 to 170"),
    ("cameras.position", "[x, y, z], finite, away from the target"),
    ("cameras.target", "[x, y, z], finite, away from the position"),
    ("cameras.up", "[x, y, z], finite, not all 0 and not along the view"),
    ("cameras.orbit", "degrees per step, finite"),
    ("cameras.aperture", "a world length, 0 or more"),
    ("cameras.focus", "a world length above 0"),
    ("render.kind", "\"raycast\", \"isosurface\" or \"slices\" (\"pathtrace\" is to come)"),
    ("render.size", "[width, height], integers from 1 to 16384"),
    ("render.step", "a length in voxels above 0, at most 16"),
    ("render.preview", "an integer from 1, the data themselves, to 64"),
    ("render.samples", "an integer, 1 or more"),
    ("render.target_error", "a fraction of the mean radiance above 0, such as 0.02"),
    ("render.budget_ms", "milliseconds above 0"),
    ("render.shading", "\"none\" or \"phong\""),
    ("render.ambient", "a finite number, 0 or more"),
    ("render.diffuse", "a finite number, 0 or more"),
    ("render.specular", "a finite number, 0 or more"),
    ("render.shininess", "a finite number above 0"),
    ("render.background", "[red, green, blue], each finite and 0 or more"),
    ("render.exposure", "a finite factor above 0"),
    ("render.tonemap", "\"srgb\", \"exposure\" or \"none\""),
    ("render.overlay", "a list of \"time\", \"colorbar\" and \"axes\""),
    ("pathtrace.denoise", "\"none\", \"knn\" or \"guided\""),
    ("pathtrace.filter", "a standard deviation from 0 to 8 pixels"),
    ("slices.shadows", "true or false"),
    ("slices.resolution", "texels per voxel above 0, at most 8"),
    ("slices.attenuation", "a number or [red, green, blue], each finite and 0 or more"),
    ("slices.blur", "degrees from 0 to 120"),
    ("slices.spotlight", "the path of an OpenEXR, Radiance HDR or PNG image"),
    ("isosurface.values", "1 to 8 different numbers; 0 to 1 of the field's range unless isosurface.units = \"data\""),
    ("isosurface.units", "\"range\" or \"data\""),
    ("isosurface.color", "[red, green, blue], each 0 to 1, or a list of one for each value"),
    ("isosurface.opacity", "a number from 0 to 1, or a list of one for each value"),
    ("isosurface.diffuse", "a number from 0 to 1, or a list of one for each value"),
    ("isosurface.specular", "a number from 0 to 1, or a list of one for each value"),
    ("isosurface.exponent", "a number from 0 to 10000, or a list of one for each value"),
    ("isosurface.exponent_gradient", "a finite number, 0 or more, or a list of one for each value"),
    ("isosurface.transmission", "a number from 0 to 1, or a list of one for each value"),
    ("isosurface.spread", "a number from 0 to 10000, or a list of one for each value"),
    ("isosurface.ior", "a number from 1 to 4, or a list of one for each value"),
    ("isosurface.light", "\"environment\", \"volume\" or \"both\""),
    ("isosurface.sky", "a list of two or more [red, green, blue], each finite and 0 or more"),
    ("isosurface.beauty", "\"sampled\" or \"prefiltered\""),
    ("isosurface.estimator", "\"normalised\" or \"paper\""),
    ("isosurface.quality", "\"preview\" or \"final\""),
    ("isosurface.antialias", "an integer from 1 to 4"),
    ("isosurface.occlusion", "\"normal\", \"bent\" or \"none\""),
    ("isosurface.occlusion_radius", "a length in voxels above 0"),
    ("isosurface.sss", "\"none\", \"fast\" or \"accurate\""),
    ("isosurface.attenuation", "a number or [red, green, blue], each above 0, at most 1, or \"transfer\""),
    ("isosurface.refraction", "true or false"),
    ("isosurface.blend", "\"opacity\" or \"fresnel\""),
    ("isosurface.layers", "an integer from 1 to 8"),
    ("movie.fps", "frames per second above 0, at most 1000"),
    ("movie.seconds_per_time_unit", "seconds of movie above 0 for a unit of the series' time"),
    ("movie.quality", "an integer from 0 (best) to 51"),
    ("insitu.outputs", "a list of paths, such as [\"movie.mp4\", \"frame_{step:06}.png\"]"),
    ("insitu.ledger", "the path of a .csv or .json file"),
    ("insitu.device", "\"auto\", \"cpu\", \"gpu\", or part of an adapter's name"),
    ("insitu.threads", "an integer from 0 (one per core) to 4096"),
    ("insitu.cores", "a list of core numbers from 0 to 1023"),
    ("insitu.queue", "an integer from 1 to 1024"),
    ("insitu.policy", "\"block\", \"drop-newest\", \"drop-oldest\" or \"coalesce\""),
    ("insitu.every", "an integer, 1 or more"),
    ("insitu.every_time", "a simulation time above 0"),
    ("insitu.light_change", "a fraction of the brightest light, above 0"),
    ("insitu.resume", "true or false"),
    ("insitu.light_state", "the path of a file"),
    ("insitu.light_state_every", "an integer, 1 or more; insitu.light_state names the file"),
    ("insitu.steps_before", "an integer, 0 or more"),
];

/// The tables that are lists of tables.
pub(super) const LISTS: [&str; 3] = ["lights", "cameras", "meshes"];

/// What a key may be; `lights.2.color` is looked up as `lights.color`.
pub(super) fn allowed(key: &str) -> &'static str {
    let plain = plain(key);
    KEYS.iter().find(|(name, _)| *name == plain).map_or("another value", |(_, words)| words)
}

/// Names of the tables.
pub(super) fn tables() -> Vec<&'static str> {
    let mut tables: Vec<_> = KEYS.iter().filter_map(|(name, _)| name.split_once('.')).map(|(table, _)| table).collect();
    tables.dedup();
    tables
}

/// Names of the keys in a table.
pub(super) fn keys_of(table: &str) -> Vec<&'static str> {
    KEYS.iter().filter_map(|(name, _)| name.split_once('.')).filter(|(t, _)| *t == table).map(|(_, key)| key).collect()
}

/// The known name nearest to a wrong one.
pub(crate) fn nearest<'a>(wrong: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let wrong = wrong.to_lowercase();
    known.into_iter().max_by(|a, b| strsim::jaro_winkler(&wrong, a).total_cmp(&strsim::jaro_winkler(&wrong, b)))
}

/// A dotted key without the indices of lists.
fn plain(key: &str) -> String {
    key.split('.').filter(|part| part.parse::<usize>().is_err()).collect::<Vec<_>>().join(".")
}
