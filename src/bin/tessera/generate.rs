//! `tessera generate`.

use crate::bake::{bake_shown, print_report};
use crate::density::DensityArgs;
use crate::text::{named, size, whole};
use bevy_tessera::bake::generate::{
    GenerateSettings, GeneratedSource, GeneratorKind, MAX_WAVELENGTH_M, OCTAVES_RANGE,
};
use bevy_tessera::bake::{self, BakeSettings};
use bevy_tessera::density::DensitySettings;
use clap::Args;
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;

/// The most relief that is chosen where none is given, in metres: about what the Earth's highest
/// mountains rise above their surroundings.
const MAX_CHOSEN_RELIEF_M: f64 = 8000.0;

#[derive(Args)]
pub struct GenerateArgs {
    /// How the ground is made: rolling hills (fbm), sharp crests (ridged), crests among hills
    /// (hybrid), or the classic (diamond-square).
    #[arg(value_name = "KIND", value_parser = named(GeneratorKind::ALL, GeneratorKind::as_str))]
    kind: GeneratorKind,
    /// The terrain's folder, which will be made.
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
    /// What tells this ground from others.
    #[arg(
        long,
        value_name = "NUMBER",
        default_value_t = 0,
        allow_hyphen_values = true,
        value_parser = whole(0..=u64::MAX)
    )]
    seed: u64,
    /// Samples in x and z.
    #[arg(
        long,
        value_name = "WIDTHxHEIGHT",
        value_parser = size,
        default_value = "1025x1025",
        allow_hyphen_values = true
    )]
    size: [u32; 2],
    /// Metres between samples.
    #[arg(
        long,
        value_name = "METRES",
        default_value_t = 1.0,
        allow_hyphen_values = true
    )]
    spacing_m: f64,
    /// Metres that the largest features are wide; a third of the longer side unless given, so that
    /// a larger terrain of the same seed shows the same ground only where this is given.
    #[arg(long, value_name = "METRES", allow_hyphen_values = true)]
    wavelength_m: Option<f64>,
    /// Metres between the lowest and the highest ground that may be; in keeping with the features'
    /// width, and at most 8000, unless given.
    #[arg(long, value_name = "METRES", allow_hyphen_values = true)]
    relief_m: Option<f64>,
    /// How fast features become lower as they become smaller, 0 to 4: the larger, the smoother.
    #[arg(long, value_name = "EXPONENT", allow_hyphen_values = true)]
    roughness: Option<f64>,
    /// How many noises, each half as wide as the one before, are added up, 1 to 32.
    #[arg(
        long,
        value_name = "NUMBER",
        allow_hyphen_values = true,
        value_parser = whole(OCTAVES_RANGE)
    )]
    octaves: Option<u32>,
    /// Make opposite edges equal, so that copies can be laid side by side.
    #[arg(long)]
    wrap: bool,
    /// Metres kept free below and above the ground, for digging and piling up.
    #[arg(
        long,
        value_name = "METRES",
        default_value_t = bake::DEFAULT_HEADROOM_M,
        allow_hyphen_values = true
    )]
    headroom_m: f64,
    #[command(flatten)]
    density: DensityArgs,
    /// Replace a terrain that exists.
    #[arg(long)]
    force: bool,
}

impl GenerateArgs {
    fn settings(&self) -> GenerateSettings {
        let plain = GenerateSettings::new(self.kind, self.size);
        let longer_m = f64::from(self.size[0].max(self.size[1])) * self.spacing_m;
        let wavelength_m = self.wavelength_m.unwrap_or(
            (longer_m / 3.0)
                .max(2.0 * self.spacing_m)
                .min(MAX_WAVELENGTH_M),
        );
        let larger = match self.kind {
            GeneratorKind::DiamondSquare => self.spacing_m,
            _ => wavelength_m / plain.wavelength_m,
        };
        // A spacing or a wavelength that is out of range is refused as such, and not as a relief
        // that nobody gave.
        let relief_m = match plain.relief_m * larger {
            relief_m if relief_m >= 0.0 => relief_m.min(MAX_CHOSEN_RELIEF_M),
            _ => 0.0,
        };
        GenerateSettings {
            seed: self.seed,
            spacing_m: self.spacing_m,
            wavelength_m,
            relief_m: self.relief_m.unwrap_or(relief_m),
            roughness: self.roughness.unwrap_or(plain.roughness),
            octaves: self.octaves.unwrap_or(plain.octaves),
            wrap: self.wrap,
            ..plain
        }
    }
}

pub fn generate(args: &GenerateArgs) -> Result<ExitCode, Box<dyn Error>> {
    let mut source = GeneratedSource::new(args.settings())?;
    let settings = BakeSettings {
        headroom_m: args.headroom_m,
        density: args.density.over(DensitySettings::default())?,
        force: args.force,
        ..Default::default()
    };
    let report = bake_shown(&mut source, &args.out, &settings)?;
    print_report(&mut std::io::stdout().lock(), &args.out, &report)?;
    Ok(ExitCode::SUCCESS)
}
