//! `tessera generate`.

use crate::bake::print_report;
use crate::density::DensityArgs;
use crate::progress::Bar;
use crate::text::size;
use bevy_tessera::bake::generate::{GenerateSettings, GeneratedSource, GeneratorKind};
use bevy_tessera::bake::{self, BakeSettings};
use bevy_tessera::density::DensitySettings;
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Args)]
pub struct GenerateArgs {
    /// How the ground is made: rolling hills (fbm), sharp crests (ridged), crests among hills
    /// (hybrid), or the classic (diamond-square).
    #[arg(value_name = "KIND", value_parser = kinds())]
    kind: GeneratorKind,
    /// The terrain's folder, which will be made.
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
    /// What tells this ground from others.
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    seed: u64,
    /// Samples in x and z.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size, default_value = "1025x1025")]
    size: [u32; 2],
    /// Metres between samples.
    #[arg(long, value_name = "METRES", default_value_t = 1.0)]
    spacing_m: f64,
    /// Metres that the largest features are wide; a third of the longer side unless given, so that
    /// a larger terrain of the same seed shows the same ground only where this is given.
    #[arg(long, value_name = "METRES")]
    wavelength_m: Option<f64>,
    /// Metres between the lowest and the highest ground that may be; in keeping with the features'
    /// width unless given.
    #[arg(long, value_name = "METRES")]
    relief_m: Option<f64>,
    /// How fast features become lower as they become smaller, 0 to 4: the larger, the smoother.
    #[arg(long, value_name = "EXPONENT")]
    roughness: Option<f64>,
    /// How many noises, each half as wide as the one before, are added up, 1 to 32.
    #[arg(long, value_name = "NUMBER")]
    octaves: Option<u32>,
    /// Make opposite edges equal, so that copies can be laid side by side.
    #[arg(long)]
    wrap: bool,
    /// Metres kept free below and above the ground, for digging and piling up.
    #[arg(long, value_name = "METRES", default_value_t = bake::DEFAULT_HEADROOM_M)]
    headroom_m: f64,
    #[command(flatten)]
    density: DensityArgs,
    /// Replace a terrain that exists.
    #[arg(long)]
    force: bool,
}

fn kinds() -> impl TypedValueParser<Value = GeneratorKind> {
    PossibleValuesParser::new(GeneratorKind::ALL.map(GeneratorKind::as_str))
        .try_map(|name| name.parse::<GeneratorKind>())
}

impl GenerateArgs {
    fn settings(&self) -> GenerateSettings {
        let plain = GenerateSettings::new(self.kind, self.size);
        let longer_m = f64::from(self.size[0].max(self.size[1])) * self.spacing_m;
        let wavelength_m = self
            .wavelength_m
            .unwrap_or((longer_m / 3.0).max(2.0 * self.spacing_m));
        let larger = match self.kind {
            GeneratorKind::DiamondSquare => self.spacing_m,
            _ => wavelength_m / plain.wavelength_m,
        };
        GenerateSettings {
            seed: self.seed,
            spacing_m: self.spacing_m,
            wavelength_m,
            relief_m: self.relief_m.unwrap_or(plain.relief_m * larger),
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
    let progress = Bar::default();
    let result = bake::bake(&mut source, &args.out, &settings, &progress);
    progress.clear();
    print_report(&mut std::io::stdout().lock(), &args.out, &result?)?;
    Ok(ExitCode::SUCCESS)
}
