//! Heights packed into the three bytes of a colour.

use super::{ImportError, ImportSettings, Scale};
use std::path::Path;

/// How red, green and blue make a height.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum Packing {
    /// `(65536 R + 256 G + B) / 10 - 10000` metres.
    TerrainRgb,
    /// `256 R + G + B / 256 - 32768` metres.
    Terrarium,
    /// A share `R / 256 + G / 256² + B / 256³` of the height range.
    Rgb24,
}

/// A packing as a linear function of the 24-bit number that red, green and blue are the digits of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unpack {
    scale: Scale,
    /// The number that says that there is no data.
    no_data: Option<f64>,
}

impl Unpack {
    pub(super) fn new(
        path: &Path,
        packing: Packing,
        settings: &ImportSettings,
    ) -> Result<Self, ImportError> {
        // The packings' own metres, to which a scale and an offset may be applied on top.
        let (unit, zero) = match packing {
            Packing::TerrainRgb => (0.1, -10_000.0),
            Packing::Terrarium => (1.0 / 256.0, -32_768.0),
            Packing::Rgb24 => match (&settings.range_m, settings.scale) {
                (Some(range), None) => {
                    let unit = (range.end() - range.start()) / f64::from(1_u32 << 24);
                    (unit, *range.start())
                }
                // The scale then says how many metres the whole range has.
                (_, Some(_)) => (1.0 / f64::from(1_u32 << 24), 0.0),
                (None, None) => {
                    return Err(ImportError::Settings {
                        path: path.to_owned(),
                        what: "has heights between 0 and 1 with the packing rgb24; say which \
                               metres these are with --height-range-m LO..HI"
                            .to_owned(),
                    });
                }
            },
        };
        let outer = Scale::metres(settings);
        Ok(Self {
            scale: Scale {
                scale: unit * outer.scale,
                offset: zero * outer.scale + outer.offset,
            },
            no_data: settings.no_data,
        })
    }

    /// Whether a sample may lack data.
    pub(super) fn may_lack_data(&self) -> bool {
        self.no_data.is_some()
    }

    pub(super) fn height_m(&self, red: u8, green: u8, blue: u8) -> f32 {
        let number = f64::from(u32::from_be_bytes([0, red, green, blue]));
        if self.no_data == Some(number) {
            f32::NAN
        } else {
            self.scale.apply(number)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_unpack_to_the_heights_that_their_formulas_give() {
        let settings = ImportSettings {
            range_m: Some(100.0..=300.0),
            ..Default::default()
        };
        let unpack = |packing| Unpack::new(Path::new("a.png"), packing, &settings).expect("valid");
        assert_eq!(unpack(Packing::TerrainRgb).height_m(1, 134, 160), 0.0);
        assert_eq!(unpack(Packing::TerrainRgb).height_m(1, 134, 161), 0.1);
        assert_eq!(unpack(Packing::Terrarium).height_m(128, 0, 0), 0.0);
        assert_eq!(unpack(Packing::Terrarium).height_m(131, 232, 128), 1000.5);
        assert_eq!(unpack(Packing::Rgb24).height_m(0, 0, 0), 100.0);
        assert_eq!(unpack(Packing::Rgb24).height_m(128, 0, 0), 200.0);
        assert!(unpack(Packing::Rgb24).height_m(255, 255, 0) < 300.0);
        let nothing = ImportSettings::default();
        assert!(Unpack::new(Path::new("a.png"), Packing::Rgb24, &nothing).is_err());
    }
}
