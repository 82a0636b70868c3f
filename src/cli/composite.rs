//! `gloaming composite`: another picture of the layers of isosurfaces, without rendering again.

use std::path::PathBuf;

use anyhow::{Context as _, bail};
use clap::{Args, ValueEnum};
use gloaming::frame::Display;
use gloaming::render::isosurface::{Weights, composite};
use gloaming::scene::{Blend, Scene};
use gloaming::sink::exr::{self, Attributes};

/// Weigh the layers of an isosurface picture anew
#[derive(Args)]
#[command(after_help = "\
Examples:
  gloaming composite frame.exr --out picture.png
  gloaming composite frame.exr --specular 0.3 --occlusion 0.5 --out picture.png --set render.exposure=1.5
  gloaming composite frame.exr --blend fresnel --sss 2 --out picture.exr

frame.exr is what render.kind = \"isosurface\" writes. Without weights the picture is the one in it.")]
pub struct CompositeArgs {
    /// The frame with its layers
    #[arg(value_name = "FRAME.exr")]
    frame: PathBuf,
    /// Where the picture goes: .png with background, exposure and tone map, or scene-linear .exr with all layers and what FRAME.exr says
    /// of its step, time and camera
    #[arg(long, value_name = "PATH")]
    out: Vec<PathBuf>,
    /// Factor on diffuse light
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    diffuse: f32,
    /// Factor on specular light
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    specular: f32,
    /// Factor on the light of the environment
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    environment: f32,
    /// Factor on the light of the light volume
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    volume: f32,
    /// Strength of ambient occlusion, 0 none
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    occlusion: f32,
    /// Factor on light from beneath the surface
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    sss: f32,
    /// What weighs a surface against what is beneath it; as rendered when absent
    #[arg(long, value_enum, value_name = "opacity|fresnel")]
    blend: Option<BlendBy>,
    /// Scene file of background, exposure and tone map
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Override a key of the scene, such as render.exposure=2
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

/// `isosurface.blend`
#[derive(Clone, Copy, ValueEnum)]
enum BlendBy {
    Opacity,
    Fresnel,
}

/// Writes the pictures.
pub fn run(args: &CompositeArgs) -> anyhow::Result<()> {
    if args.out.is_empty() {
        bail!("no output\n  try: --out picture.png");
    }
    let factors = [
        ("--diffuse", args.diffuse),
        ("--specular", args.specular),
        ("--environment", args.environment),
        ("--volume", args.volume),
        ("--occlusion", args.occlusion),
        ("--sss", args.sss),
    ];
    if let Some((name, value)) = factors.iter().find(|(_, v)| !(*v >= 0.0 && v.is_finite())) {
        bail!("{name} {value} is not allowed; allowed: a finite number, 0 or more");
    }
    let scene = Scene::load(args.scene.as_deref(), &args.set)?;
    let weights = Weights {
        diffuse: args.diffuse,
        specular: args.specular,
        environment: args.environment,
        volume: args.volume,
        occlusion: args.occlusion,
        sss: args.sss,
        blend: args.blend.map(|b| match b {
            BlendBy::Opacity => Blend::Opacity,
            BlendBy::Fresnel => Blend::Fresnel,
        }),
    };
    let frame = composite(&exr::read(&args.frame)?, &weights).with_context(|| args.frame.display().to_string())?;
    let attributes = Attributes::of(&args.frame)?;
    for path in &args.out {
        match path.extension().and_then(|e| e.to_str()) {
            Some("exr") => attributes.write(path, &frame)?,
            Some("png") => {
                Display::from(&scene.render).picture(&frame).save(path).with_context(|| path.display().to_string())?
            }
            _ => bail!("{}: a composite is written as .png or .exr", path.display()),
        }
    }
    Ok(())
}
