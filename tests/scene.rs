//! The scene file: every class of mistake is refused with the key, the line and what is allowed.

use gloaming::Error;
use gloaming::scene::{ComponentKey, Model, NumberOrRgb, Overlay, RangeKey, Scene, SolverKeys};
use proptest::prelude::*;

fn parse(text: &str) -> Result<Scene, Error> {
    Scene::parse(text, "test.toml", &[])
}

fn with(sets: &[&str]) -> Result<Scene, Error> {
    Scene::load(None, &sets.iter().map(|s| s.to_string()).collect::<Vec<_>>())
}

/// The key, line and message of a scene error.
#[track_caller]
fn refused(result: Result<Scene, Error>) -> (String, Option<usize>, String) {
    match result {
        Err(Error::Scene { key, line, message }) => (key, line, message),
        other => panic!("expected an error about the scene, not {other:?}"),
    }
}

#[test]
fn an_empty_scene_is_the_default_and_the_default_is_valid() {
    assert_eq!(parse("").unwrap(), Scene::default());
    Scene::default().validate().unwrap();
}

#[test]
fn the_documented_scene_is_read() {
    let text = r#"
        [field]
        name = "density"
        range = [0, 2.5]
        component = 1
        [transfer]
        colormap = "inferno"
        opacity = [[0.0, 0.0], [1, 0.5]]
        albedo = [0.8, 0.7, 0.6]
        [[lights]]
        kind = "distant"
        direction = [-0.5, -1.0, -0.4]
        intensity = 3
        [[lights]]
        kind = "environment"
        color = [0.2, 0.2, 0.3]
        [light]
        model = "paper"
        resolution = 1
        tolerance = 0
        [[cameras]]
        name = "front"
        [[cameras]]
        name = "side"
        azimuth = 120
        position = [9, 0, 0]
        [render]
        size = [640, 360]
        overlay = ["time", "colorbar", "axes"]
        [movie]
        fps = 30
        quality = 20
    "#;
    let scene = parse(text).unwrap();
    assert_eq!(scene.field.name.as_deref(), Some("density"));
    assert_eq!(scene.field.range, RangeKey::Fixed([0.0, 2.5]));
    assert_eq!(scene.field.component, ComponentKey::Index(1));
    assert_eq!(scene.transfer.opacity, Some(vec![[0.0, 0.0], [1.0, 0.5]]));
    assert_eq!(scene.transfer.albedo, NumberOrRgb::Rgb([0.8, 0.7, 0.6]));
    assert_eq!((scene.lights.len(), scene.lights[0].intensity), (2, 3.0));
    assert_eq!((scene.light.model, scene.light.tolerance), (Model::Paper, 0.0));
    assert_eq!((scene.cameras[1].name.as_str(), scene.cameras[1].azimuth), ("side", 120.0));
    assert_eq!(scene.render.overlay, [Overlay::Time, Overlay::Colorbar, Overlay::Axes]);
    assert_eq!((scene.movie.fps, scene.movie.quality), (30.0, 20));
}

#[test]
fn a_scene_survives_being_written() {
    let scene = with(&["light.model=paper", "lights.0.intensity=5", "cameras.0.zoom=2", "field.range=step"]).unwrap();
    assert_eq!(parse(&toml::to_string(&scene).unwrap()).unwrap(), scene);
}

#[test]
fn unknown_keys_name_the_nearest_known_key_and_the_line() {
    for (text, key, line, nearest) in [
        ("[light]\n\ntolerence = 1", "light.tolerence", 3, "`tolerance`"),
        ("[transfer]\ncolourmap = \"hot\"", "transfer.colourmap", 2, "`colormap`"),
        ("[rendr]\nstep = 1", "rendr", 1, "`render`"),
        ("[[lights]]\n[[lights]]\ncolour = [1, 1, 1]", "lights.1.colour", 3, "`color`"),
        ("[[cameras]]\nazimut = 3", "cameras.0.azimut", 2, "`azimuth`"),
        ("[movie]\nfp = 3", "movie.fp", 2, "`fps`"),
        ("[light]\nazimuth = 3", "light.azimuth", 2, "`cameras.azimuth`"),
        ("[field]\nRange = 3", "field.Range", 2, "`range`"),
        ("tolerance = 1", "tolerance", 1, "`light.tolerance`"),
    ] {
        let (k, l, message) = refused(parse(text));
        assert_eq!((k.as_str(), l), (key, Some(line)), "{message}");
        assert!(message.contains("unknown") && message.contains(nearest), "{key}: {message}");
    }
}

#[test]
fn wrong_syntax_has_a_line() {
    let (key, line, message) = refused(parse("[light]\nmodel = physical\n"));
    assert_eq!((key.as_str(), line), ("test.toml", Some(2)), "{message}");
    let (_, line, message) = refused(parse("[light]\nwarm = true\nwarm = true"));
    assert_eq!(line, Some(3), "{message}");
    let (key, line, message) = refused(parse("\n[lights]\ncolor = [1, 1, 1]"));
    assert_eq!((key.as_str(), line), ("lights", Some(2)));
    assert!(message.contains("[[lights]]"), "{message}");
    let (_, _, message) = refused(parse("light = 3"));
    assert!(message.contains("[light]"), "{message}");
}

#[test]
fn values_outside_their_range_name_the_key_the_line_and_what_is_allowed() {
    for (text, key, allowed) in [
        ("[field]\nrange = \"frame\"", "field.range", "\"series\", \"step\""),
        ("[field]\nrange = [2, 1]", "field.range", "lo < hi"),
        ("[field]\nrange = [0, nan]", "field.range", "lo < hi"),
        ("[field]\ncomponent = -1", "field.component", "\"magnitude\""),
        ("[field]\ncomponent = \"w\"", "field.component", "\"magnitude\""),
        ("[field]\nname = 3", "field.name", "the name"),
        ("[transfer]\nalbedo = 1.5", "transfer.albedo", "0 to 1"),
        ("[transfer]\nalbedo = [0.5, -0.1, 1]", "transfer.albedo", "0 to 1"),
        ("[transfer]\nalbedo = nan", "transfer.albedo", "0 to 1"),
        ("[transfer]\nextinction = -1", "transfer.extinction", "0 or more"),
        ("[transfer]\nchromatic = [1, -1, 1]", "transfer.chromatic", "not all 0"),
        ("[transfer]\nchromatic = [1, nan, 1]", "transfer.chromatic", "not all 0"),
        ("[transfer]\nextinction = inf", "transfer.extinction", "0 or more"),
        ("[transfer]\nanisotropy = 1", "transfer.anisotropy", "between -1 and 1"),
        ("[transfer]\nanisotropy = -1.0", "transfer.anisotropy", "between -1 and 1"),
        ("[transfer]\nopacity = [[0, 0], [0.5, 1], [0.2, 0]]", "transfer.opacity", "ascending"),
        ("[transfer]\nopacity = [[0, 0], [2, 1]]", "transfer.opacity", "0 to 1"),
        ("[transfer]\nopacity = [[0, 0], [1, 2]]", "transfer.opacity", "0 to 1"),
        ("[transfer]\nopacity = []", "transfer.opacity", "[[value, opacity]"),
        ("[transfer]\nopacity = [[0, 0, 1]]", "transfer.opacity", "[[value, opacity]"),
        ("[transfer]\npoints = [[0, 0, 1]]", "transfer.points", "[[value, red"),
        ("[transfer]\npoints = [[0, 0, 1, 255]]", "transfer.points", "0 to 1"),
        ("[transfer]\nemission = [[0, -1]]", "transfer.emission", "0 or more"),
        ("[transfer]\nreference = 0", "transfer.reference", "above 0"),
        ("[transfer]\ncolormap = \"infernal\"", "transfer.colormap", "`inferno`"),
        ("[[lights]]\ndirection = [0, 0, 0]", "lights.0.direction", "not all 0"),
        ("[[lights]]\ndirection = [nan, 0, 1]", "lights.0.direction", "finite"),
        ("[[lights]]\nkind = \"spot\"", "lights.0.kind", "\"distant\""),
        ("[[lights]]\ncolor = [1, 1]", "lights.0.color", "[red, green, blue]"),
        ("[[lights]]\nintensity = -3", "lights.0.intensity", "0 or more"),
        ("[[lights]]\nsoftness = 91", "lights.0.softness", "0 to 90"),
        ("[[lights]]\nkind = \"point\"\nposition = [nan, 0, 1]", "lights.0.position", "finite"),
        ("[[lights]]\nkind = \"point\"\nradius = -1", "lights.0.radius", "0 or more"),
        ("[[lights]]\nkind = \"cone\"\nangle = 0", "lights.0.angle", "above 0, at most 90"),
        ("[[lights]]\nkind = \"cone\"\nangle = 91", "lights.0.angle", "above 0, at most 90"),
        ("[[lights]]\nangle = 20\nedge = 21", "lights.0.edge", "at most the angle"),
        ("[[lights]]\nkind = \"cone\"\ndirection = [0, 0, 0]", "lights.0.direction", "not all 0"),
        ("[[lights]]\nsoftness = 3\nsamples = 5", "lights.0.samples", "1, 7 or 19"),
        ("[[lights]]\nimage = \"sky.exr\"", "lights.0.image", "of an environment"),
        ("[light]\nmodel = \"exact\"", "light.model", "\"physical\""),
        ("[light]\nresolution = 0", "light.resolution", "above 0"),
        ("[light]\nresolution = -0.5", "light.resolution", "above 0"),
        ("[light]\nresolution = 1.5", "light.resolution", "integer"),
        ("[light]\ndirect_resolution = 1e9", "light.direct_resolution", "4096"),
        ("[light]\ndirections = 16", "light.directions", "8, 32 or 128"),
        ("[light]\nsigma_s = [1, -1, 1]", "light.sigma_s", "0 or more"),
        ("[light]\niterations = 0", "light.iterations", "from 1"),
        ("[light]\niterations = -5", "light.iterations", "from 1"),
        ("[light]\npasses = 1", "light.passes", "from 2"),
        ("[light]\nbudget_ms = 0", "light.budget_ms", "above 0"),
        ("[light]\ntolerance = -1e-3", "light.tolerance", "1e-6 to 1"),
        ("[light]\ntolerance = 1e-9", "light.tolerance", "1e-6 to 1"),
        ("[light]\ntolerance = nan", "light.tolerance", "1e-6 to 1"),
        ("[light]\ntolerance = \"small\"", "light.tolerance", "1e-6 to 1"),
        ("[light]\nwarm = 1", "light.warm", "true or false"),
        ("[[cameras]]\nfov = 180", "cameras.0.fov", "1 to 170"),
        ("[[cameras]]\nfov = 0", "cameras.0.fov", "1 to 170"),
        ("[[cameras]]\nzoom = 0", "cameras.0.zoom", "above 0"),
        ("[[cameras]]\nelevation = 91", "cameras.0.elevation", "-90 to 90"),
        ("[[cameras]]\nname = \"\"", "cameras.0.name", "a name"),
        ("[[cameras]]\nname = \"a/b\"", "cameras.0.name", "without /"),
        ("[[cameras]]\nposition = [1, 2, 3]\ntarget = [1, 2, 3]", "cameras.0.position", "away from"),
        ("[[cameras]]\nposition = [0, 0, 3]\ntarget = [0, 0, 0]", "cameras.0.up", "along the view"),
        ("[[cameras]]\nup = [0, 0, 0]", "cameras.0.up", "not all 0"),
        ("[render]\nsize = [0, 720]", "render.size", "1 to 16384"),
        ("[render]\nsize = [1280, 16385]", "render.size", "1 to 16384"),
        ("[render]\nsize = [1280]", "render.size", "[width, height]"),
        ("[render]\nstep = 0", "render.step", "above 0"),
        ("[render]\nstep = nan", "render.step", "above 0"),
        ("[render]\nsamples = 0", "render.samples", "1 or more"),
        ("[render]\nexposure = 0", "render.exposure", "above 0"),
        ("[render]\nbackground = [0, -1, 0]", "render.background", "0 or more"),
        ("[render]\noverlay = [\"legend\"]", "render.overlay", "\"colorbar\""),
        ("[render]\ntonemap = \"aces\"", "render.tonemap", "\"srgb\""),
        ("[movie]\nfps = 0", "movie.fps", "above 0"),
        ("[movie]\nquality = 52", "movie.quality", "0 (best) to 51"),
        ("[movie]\nquality = 300", "movie.quality", "0 (best) to 51"),
    ] {
        let (k, line, message) = refused(parse(text));
        assert_eq!(k, key, "{text}: {message}");
        assert!(matches!(line, Some(1..=3)), "{text}: line {line:?}");
        assert!(message.contains(allowed), "{text}: {message}");
    }
}

#[test]
fn opacity_and_extinction_exclude_each_other_and_names_of_cameras_differ() {
    let (key, _, message) = refused(parse("[transfer]\nextinction = 3\nopacity = [[0, 0], [1, 1]]"));
    assert_eq!(key, "transfer.extinction");
    assert!(message.contains("transfer.opacity"), "{message}");
    let (key, line, _) = refused(parse("[[cameras]]\nname = \"a\"\n[[cameras]]\nname = \"a\""));
    assert_eq!((key.as_str(), line), ("cameras.1.name", Some(4)));
}

#[test]
fn what_is_not_built_is_refused_by_name_with_what_works() {
    for (text, names) in [
        (
            "[render]\ntarget_error = 0.1\n[pathtrace]\nreplay = true",
            ["pathtrace.replay", "render.target_error", "render.samples"],
        ),
        ("[[cameras]]\naperture = 0.1", ["cameras.0.aperture", "0.1", "leave it 0"]),
    ] {
        let error = parse(text).unwrap_err();
        assert!(matches!(error, Error::Unsupported(_)), "{error}");
        names.iter().for_each(|name| assert!(error.to_string().contains(name), "{error}"));
    }
}

#[test]
fn overrides_take_words_lists_and_indices() {
    let scene = with(&[
        "light.model=paper",
        "light.tolerance = 1e-4",
        "transfer.opacity=[[0,0],[0.3,0.1],[1,0.5]]",
        "render.overlay=[time, axes]",
        "render.size=[64,48]",
        "cameras.0.azimuth=20",
        "cameras.1.name=side",
        "lights.0.intensity=5",
        "field.name=2020-01-01",
        "light.warm=false",
        "transfer.colormap=\"viridis\"",
    ])
    .unwrap();
    assert_eq!((scene.light.model, scene.light.tolerance, scene.light.warm), (Model::Paper, 1e-4, false));
    assert_eq!(scene.transfer.opacity.unwrap()[1], [0.3, 0.1]);
    assert_eq!(scene.render.overlay, [Overlay::Time, Overlay::Axes]);
    assert_eq!(scene.render.size, [64, 48]);
    assert_eq!((scene.cameras[0].azimuth, scene.cameras[1].name.as_str()), (20.0, "side"));
    assert_eq!((scene.lights.len(), scene.lights[0].intensity), (1, 5.0));
    assert_eq!(scene.field.name.as_deref(), Some("2020-01-01"));
    assert_eq!(with(&["field.name=42"]).unwrap().field.name.as_deref(), Some("42"));
    assert_eq!(with(&["light.tolerance=1e-3", "light.tolerance=0"]).unwrap().light.tolerance, 0.0, "the last one wins");
}

#[test]
fn an_override_replaces_what_the_file_says() {
    let text = "[light]\ntolerance = 1e-2\n[[lights]]\nintensity = 2\ncolor = [1, 0, 0]";
    let sets = ["light.tolerance=1e-4".to_string(), "lights.0.intensity=7".to_string()];
    let scene = Scene::parse(text, "test.toml", &sets).unwrap();
    assert_eq!(scene.light.tolerance, 1e-4);
    assert_eq!((scene.lights[0].intensity, scene.lights[0].color), (7.0, [1.0, 0.0, 0.0]));
}

#[test]
fn wrong_overrides_say_how_to_write_them() {
    for (set, key, hint) in [
        ("light.tolerance", "light.tolerance", "key=value"),
        ("light.tolerence=1", "light.tolerence", "`tolerance`"),
        ("tolerance=1", "tolerance", "`light.tolerance`"),
        ("lights.intensity=5", "lights.intensity", "lights.0."),
        ("lights.3.intensity=5", "lights.3.intensity", "0 to 0"),
        ("lights.x.intensity=5", "lights.x.intensity", "0 to 0"),
        ("light.tolerance=often", "light.tolerance", "1e-6 to 1"),
        ("transfer.albedo=2", "transfer.albedo", "0 to 1"),
        ("scene.light.model.deep=1", "scene.light.model.deep", "`light.model`"),
    ] {
        let (k, line, message) = refused(with(&[set]));
        assert_eq!((k.as_str(), line), (key, None), "{message}");
        assert!(message.contains(hint), "{set}: {message}");
    }
    let (_, line, _) =
        refused(Scene::parse("[light]\ntolerance = 1e-2", "test.toml", &["light.tolerance=-1".to_string()]));
    assert_eq!(line, None, "the mistake is not in the file");
}

#[test]
fn a_missing_file_is_named() {
    let error = Scene::load(Some(std::path::Path::new("no/such/scene.toml")), &[]).unwrap_err();
    assert!(matches!(error, Error::Io { .. }) && error.to_string().contains("no/such/scene.toml"), "{error}");
}

proptest! {
    /// Whatever the text, reading ends with a scene or an error.
    #[test]
    fn no_text_and_no_override_panics(text in "[\\[\\]a-z.=0-9\" \n,é-]{0,60}", set in "[a-z.0-9=\\[\\]\", é]{0,40}") {
        let _ = Scene::parse(&text, "test.toml", &[]);
        let _ = Scene::load(None, std::slice::from_ref(&set));
        let _ = Scene::load(None, &[format!("render.overlay={set}")]);
        let _ = Scene::load(None, &[format!("lights.0.{set}")]);
    }

    /// A light grid has the size or fraction asked for, keeps the data's aspect to half a voxel, and is never empty.
    #[test]
    fn light_grids_keep_the_aspect(nx in 1usize..300, ny in 1usize..300, nz in 1usize..300, fraction in 0.05f64..1.0, size in 2usize..300) {
        let data = [nx, ny, nz];
        let longest = nx.max(ny).max(nz);
        let by_size = SolverKeys::grid_size(size as f64, data);
        prop_assert_eq!(by_size.into_iter().max().unwrap(), size);
        let by_fraction = SolverKeys::grid_size(fraction, data);
        for a in 0..3 {
            prop_assert!(by_size[a] >= 1 && by_fraction[a] >= 1);
            let exact = data[a] as f64 * fraction;
            prop_assert!((by_fraction[a] as f64 - exact.max(1.0)).abs() <= 0.5 + 1e-9);
            let exact = (data[a] * size) as f64 / longest as f64;
            prop_assert!((by_size[a] as f64 - exact.max(1.0)).abs() <= 0.5 + 1e-9);
        }
        prop_assert_eq!(SolverKeys::grid_size(1.0, data), data);
    }
}
