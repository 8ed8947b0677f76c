//! The command line that every example takes.

use bevy::prelude::*;
use bevy_tessera::density::DensitySettings;
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
  --triangle-px X        width of triangles where the ground is roughest (open_world)
  --max-error-px X       as few triangles as keep the error below this, in place of that width
                         (open_world)
  --detail M             displacement of up to M metres finer than the samples (open_world)
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
    pub triangle_px: Option<f32>,
    pub max_error_px: Option<f32>,
    /// How high detail displacement is, in metres.
    pub detail_m: Option<f32>,
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
                "--triangle-px" => arguments.triangle_px = Some(number(&word, &value()?)?),
                "--max-error-px" => arguments.max_error_px = Some(number(&word, &value()?)?),
                "--detail" => arguments.detail_m = Some(number(&word, &value()?)?),
                "--help" | "-h" => return Ok(None),
                _ => return Err(format!("{word} is no option")),
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
