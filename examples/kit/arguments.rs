//! The command line that every example takes.

use bevy::prelude::*;
use bevy_tessera::density::DensitySettings;
use bevy_tessera::gizmos::TerrainGizmos;
use bevy_tessera::render::{ComparisonView, TerrainOverlay, TerrainOverlays};
use std::ops::RangeInclusive;
use std::path::PathBuf;

const USAGE: &str = "\
Options:
  --headless             draw without a window
  --frames N             frames to draw once the terrain has streamed in (default 3), headless
  --screenshot PATH      save the last frame as a PNG, headless
  --size WxH             size of the picture (default 1280x720), headless
  --eye X,Y,Z            where the camera stands, in metres
  --look X,Y,Z           what it looks at
  --terrain DIR          a baked terrain instead of the bundled one
  --atmosphere           Bevy's atmosphere on a software renderer too (slow; crashes old Mesa)
  --density-preview      cover the ground with its densities: green low, red high (open_world)
  --density-gain X       the same, with this gain (default 1)
  --overlay NAME[,NAME]  lay colours over the ground that say what it is made of: density, level,
                         edge-factor, triangle-size, morph, residency, normals, slope, error-bound,
                         destruction, page-borders, wireframe
  --triangle-px X        width of triangles where the ground is roughest (open_world)
  --max-error-px X       as few triangles as keep the error below this, in place of that width
                         (open_world)
  --detail M             displacement of up to M metres finer than the samples (open_world)
  --compare              to the right of a line, the ground without its density map (open_world)
  --divider X            the same, with the line here: 0 left to 1 right (default 0.5)
  --difference GAIN      the difference the density map makes, so many times as strong, 1 to 64
                         (open_world)
  --beside X,Y,Z         freeze the ground as --eye sees it, and show it from here (open_world)
  --beside-look X,Y,Z    what is looked at from there
  --panel[=TAB]          open the terrain's panel, as F3 does, with that tab on top: settings,
                         views, statistics, map or edit (open_world, destruction)
  --gizmos LIST          lines over the terrain: tiles, edits, held-eyes, with commas between
  --help                 this text";

/// What the command line says.
#[derive(Resource, Clone, Debug, Default)]
pub struct Arguments {
    pub headless: bool,
    pub frames: Option<u32>,
    pub screenshot: Option<PathBuf>,
    pub size: Option<UVec2>,
    pub eye: Option<Vec3>,
    pub look: Option<Vec3>,
    pub terrain: Option<PathBuf>,
    pub atmosphere: bool,
    /// The gain of the preview of densities, where one is wanted.
    pub density_gain: Option<f32>,
    pub overlays: Option<TerrainOverlays>,
    pub triangle_px: Option<f32>,
    pub max_error_px: Option<f32>,
    /// How high detail displacement is, in metres.
    pub detail_m: Option<f32>,
    /// What is compared with the ground without its density map, and how.
    pub compare: Option<ComparisonView>,
    /// From where the ground is shown that the cameras see from their own places.
    pub beside: Option<Vec3>,
    pub beside_look: Option<Vec3>,
    /// The tab with which the panel is open; empty for any.
    pub panel: Option<String>,
    /// Which lines are drawn over the terrain.
    pub gizmos: Option<TerrainGizmos>,
}

impl Arguments {
    /// Reads the process's arguments; ends the process with a sentence where they can't be used.
    pub fn parse() -> Self {
        match Self::from_words(std::env::args().skip(1)) {
            Ok(Some(arguments)) => arguments,
            Ok(None) => {
                println!("{USAGE}");
                std::process::exit(0);
            }
            Err(error) => {
                eprintln!("{error}\n{USAGE}");
                std::process::exit(2);
            }
        }
    }

    fn from_words(mut words: impl Iterator<Item = String>) -> Result<Option<Self>, String> {
        let mut arguments = Self::default();
        while let Some(word) = words.next() {
            let mut value = || {
                words
                    .next()
                    .ok_or_else(|| format!("{word} needs a value after it"))
            };
            match word.as_str() {
                "--headless" => arguments.headless = true,
                "--atmosphere" => arguments.atmosphere = true,
                "--frames" => arguments.frames = Some(number(&word, &value()?)?),
                "--screenshot" => arguments.screenshot = Some(value()?.into()),
                "--size" => {
                    let text = value()?;
                    let (w, h) = text
                        .split_once('x')
                        .ok_or_else(|| format!("--size is {text}: write WxH, like 1280x720"))?;
                    let size = UVec2::new(number(&word, w)?, number(&word, h)?);
                    if size.min_element() == 0 || size.max_element() > 8192 {
                        return Err(format!("--size is {text}: use 1 to 8192 a side"));
                    }
                    arguments.size = Some(size);
                }
                "--eye" => arguments.eye = Some(place(&word, &value()?)?),
                "--look" => arguments.look = Some(place(&word, &value()?)?),
                "--terrain" => {
                    let folder = PathBuf::from(value()?);
                    if !folder.join("terrain.ron").exists() {
                        return Err(format!(
                            "{} holds no terrain.ron: name a folder that `tessera bake` wrote",
                            folder.display()
                        ));
                    }
                    arguments.terrain = Some(folder);
                }
                "--density-preview" => {
                    arguments.density_gain.get_or_insert(1.0);
                }
                "--density-gain" => {
                    let gain = number(&word, &value()?)?;
                    let settings = DensitySettings {
                        gain,
                        ..Default::default()
                    };
                    settings.validate().map_err(|error| error.to_string())?;
                    arguments.density_gain = Some(gain);
                }
                "--overlay" => arguments.overlays = Some(overlays(&value()?)?),
                "--triangle-px" => arguments.triangle_px = Some(number(&word, &value()?)?),
                "--max-error-px" => arguments.max_error_px = Some(number(&word, &value()?)?),
                "--detail" => arguments.detail_m = Some(number(&word, &value()?)?),
                "--compare" => {
                    arguments.compare.get_or_insert_default();
                }
                "--divider" => {
                    let divider = within(&word, &value()?, 0.0..=1.0)?;
                    arguments.compare = Some(ComparisonView::Split { divider });
                }
                "--difference" => {
                    let gain = within(&word, &value()?, 1.0..=64.0)?;
                    arguments.compare = Some(ComparisonView::Difference { gain });
                }
                "--beside" => arguments.beside = Some(place(&word, &value()?)?),
                "--beside-look" => arguments.beside_look = Some(place(&word, &value()?)?),
                "--panel" => arguments.panel = Some(String::new()),
                "--gizmos" => arguments.gizmos = Some(gizmos(&value()?)?),
                "--help" | "-h" => return Ok(None),
                _ => match word.strip_prefix("--panel=") {
                    Some(tab) => arguments.panel = Some(tab.to_owned()),
                    None => return Err(format!("{word} is no option")),
                },
            }
        }
        Ok(Some(arguments))
    }
}

fn number<T: std::str::FromStr>(option: &str, text: &str) -> Result<T, String> {
    text.trim()
        .parse()
        .map_err(|_| format!("{option} is {text}: write a number"))
}

/// The overlays of these names, lit like the ground.
fn overlays(names: &str) -> Result<TerrainOverlays, String> {
    let all = TerrainOverlay::ALL.map(|overlay| overlay.name().replace(' ', "-"));
    let mut overlays = TerrainOverlays::default();
    for name in names.split(',') {
        let known = all.iter().position(|known| known == name.trim());
        let Some(number) = known else {
            return Err(format!(
                "--overlay is {name}: use some of {}",
                all.join(", ")
            ));
        };
        overlays.opacities[number] = 1.0;
    }
    Ok(overlays)
}

fn within(option: &str, text: &str, range: RangeInclusive<f32>) -> Result<f32, String> {
    let value = number(option, text)?;
    if !range.contains(&value) {
        let (least, most) = (range.start(), range.end());
        return Err(format!("{option} is {text}: use {least} to {most}"));
    }
    Ok(value)
}

fn gizmos(list: &str) -> Result<TerrainGizmos, String> {
    let mut gizmos = TerrainGizmos {
        held_eye_reach_m: 4000.0,
        ..Default::default()
    };
    for name in list.split(',') {
        match name.trim() {
            "tiles" => gizmos.tiles = true,
            "edits" => gizmos.edits = true,
            "held-eyes" => gizmos.held_eyes = true,
            _ => return Err(format!("--gizmos is {list}: use tiles, edits or held-eyes")),
        }
    }
    Ok(gizmos)
}

fn place(option: &str, text: &str) -> Result<Vec3, String> {
    let parts: Vec<&str> = text.split(',').collect();
    let [x, y, z] = parts[..] else {
        return Err(format!("{option} is {text}: write X,Y,Z"));
    };
    let place = Vec3::new(number(option, x)?, number(option, y)?, number(option, z)?);
    if !place.is_finite() {
        return Err(format!("{option} is {text}: write finite numbers"));
    }
    Ok(place)
}
