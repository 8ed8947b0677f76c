//! Readers of height-map files, one file a format.
//!
//! Every reader streams: it holds as many rows as the format decodes at once (one in PNG and raw
//! files, a strip or a row of tiles in TIFF, a block of lines in OpenEXR). Files whose layout makes
//! that impossible (interlaced PNG, tiled or bottom-up OpenEXR) are held as a whole, up to
//! [`MAX_WHOLE_SAMPLES`] samples, and refused beyond.
//!
//! # What a number means
//! Heights come out in metres:
//! - A packing, an SRTM tile, and floating-point, signed and georeferenced files are in metres
//!   already, unless a scale or an offset is given.
//! - Unsigned 8 and 16 bit files without georeference (grey PNG, TIFF, `.r16`) hold shares of
//!   a range that the file doesn't tell. With [`range_m`](ImportSettings::range_m), their 0 and
//!   their largest value (255, 65535) stand for its ends; without, a unit is a metre.
//! - With [`scale`](ImportSettings::scale) or [`offset`](ImportSettings::offset), any file's
//!   numbers are `value * scale + offset` metres.
//!
//! What was assumed is told by [`HeightSource::notes`].

mod exr;
mod geo;
mod guard;
mod hgt;
mod packed;
mod png;
mod raw;
mod tiff;

use super::HeightSource;
use crate::terrain::check_size;
use std::fmt::Display;
use std::fs::File;
use std::io::{BufReader, Read};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use thiserror::Error;

pub use packed::Packing;

/// The most samples of a file that has to be held as a whole: 64 million, 256 MiB of `f32`.
pub const MAX_WHOLE_SAMPLES: u64 = 1 << 26;

/// What a file doesn't say itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImportSettings {
    /// Width and height of a raw file in samples.
    pub size: Option<[u32; 2]>,
    /// How heights are packed into the colours of a PNG file.
    pub packing: Option<Packing>,
    /// Whether a raw file's numbers have their most significant byte first.
    pub big_endian: bool,
    /// Metres a unit of the file's numbers; not 0.
    pub scale: Option<f64>,
    /// Metres of the file's number 0.
    pub offset: Option<f64>,
    /// Heights in metres that the least and the largest number of a file stand for whose numbers
    /// have no meaning of their own. `scale` and `offset` go before it.
    pub range_m: Option<RangeInclusive<f64>>,
    /// A value, in the file's own numbers, that says that there is no data.
    pub no_data: Option<f64>,
}

/// Why a file can't be used as a height map. Each message is a sentence that names the file and
/// the cause and says what to do about it.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ImportError {
    /// The file can't be opened or read.
    #[error("{} can't be read: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: std::io::Error,
    },
    /// The path names a folder.
    #[error("{} is a folder; name a file of heights", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// The file has no bytes.
    #[error("{} is empty", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// Neither the first bytes nor the name tell a known format.
    #[error(
        "{} is in no known format: PNG, TIFF, OpenEXR, SRTM (.hgt) and raw heights (.r16, .r32) \
         can be read",
        path.display()
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// The file breaks its format's rules, or ends early.
    #[error("{} is damaged or no {format} file: {reason}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The format.
        format: &'static str,
        /// What the decoder says.
        reason: String,
    },
    /// The file is sound, but not what can be baked.
    #[error("{} {what}; {advice}", path.display())]
    Unsuitable {
        /// The file.
        path: PathBuf,
        /// What it is, as the rest of a sentence about the file.
        what: String,
        /// What to do about it.
        advice: String,
    },
    /// Too few or too many samples for a terrain.
    #[error(
        "{} has {} x {} samples, which is out of bounds: a terrain has 2 to 16777216 samples a \
         side and at most 1048576 tiles of 128 x 128",
        path.display(),
        size[0],
        size[1]
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Samples in x and z that its header promises.
        size: [u64; 2],
    },
    /// A raw file without a size.
    #[error(
        "{} is raw, so its size has to be said: --size WIDTHxHEIGHT{suggestion}",
        path.display()
    )]
    SizeWanted {
        /// The file.
        path: PathBuf,
        /// A size that would fit, as the rest of the sentence, or nothing.
        suggestion: String,
    },
    /// A raw file whose length doesn't match its size.
    #[error(
        "{} has {found} bytes where {} x {} samples of {sample} bytes take {wanted}; check --size",
        path.display(),
        size[0],
        size[1]
    )]
    Length {
        /// The file.
        path: PathBuf,
        /// Its length in bytes.
        found: u64,
        /// The length that fits.
        wanted: u64,
        /// The size that was given.
        size: [u32; 2],
        /// Bytes a sample.
        sample: u64,
    },
    /// Settings that contradict each other or the file.
    #[error("{} {what}", path.display())]
    Settings {
        /// The file.
        path: PathBuf,
        /// What is wrong, as the rest of a sentence about the file.
        what: String,
    },
}

/// Opens a height map. The format is told by the file's first bytes and, for formats that have no
/// magic, by its name.
///
/// Reads the header only.
///
/// # Errors
/// Where the file can't be read, isn't in a known format, is damaged, or holds what is no height
/// map; see [`ImportError`].
pub fn open(path: &Path, settings: &ImportSettings) -> Result<Box<dyn HeightSource>, ImportError> {
    let read_failed = |reason| ImportError::Read {
        path: path.to_owned(),
        reason,
    };
    let metadata = std::fs::metadata(path).map_err(read_failed)?;
    if metadata.is_dir() {
        return Err(ImportError::Folder {
            path: path.to_owned(),
        });
    }
    let mut magic = Vec::new();
    File::open(path)
        .and_then(|file| file.take(8).read_to_end(&mut magic))
        .map_err(read_failed)?;
    if magic.is_empty() {
        return Err(ImportError::Empty {
            path: path.to_owned(),
        });
    }
    for (name, number) in [
        ("--height-scale", settings.scale),
        ("--height-offset", settings.offset),
    ] {
        if number.is_some_and(|number| !number.is_finite())
            || (name == "--height-scale" && number == Some(0.0))
        {
            return Err(ImportError::Settings {
                path: path.to_owned(),
                what: format!("can't be read with {name} {}", number.unwrap_or_default()),
            });
        }
    }
    let format = Format::of(path, &magic).ok_or_else(|| ImportError::UnknownFormat {
        path: path.to_owned(),
    })?;
    let refuse = |given: bool, option: &str| {
        if given {
            Err(ImportError::Settings {
                path: path.to_owned(),
                what: format!(
                    "is a {} file, to which {option} doesn't apply",
                    format.name()
                ),
            })
        } else {
            Ok(())
        }
    };
    refuse(
        settings.packing.is_some() && format != Format::Png,
        "--packing",
    )?;
    let raw = matches!(format, Format::Raw16 | Format::Raw32);
    refuse(settings.size.is_some() && !raw, "--size")?;
    refuse(settings.big_endian && !raw, "--big-endian")?;
    guard::open(path, format.name(), || match format {
        Format::Png => png::open(path, settings),
        Format::Tiff => tiff::open(path, settings),
        Format::Exr => exr::open(path, settings),
        Format::Hgt => hgt::open(path, settings, metadata.len()),
        Format::Raw16 => raw::open(path, settings, metadata.len(), raw::Kind::U16),
        Format::Raw32 => raw::open(path, settings, metadata.len(), raw::Kind::F32),
    })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Png,
    Tiff,
    Exr,
    Hgt,
    Raw16,
    Raw32,
}

impl Format {
    fn of(path: &Path, magic: &[u8]) -> Option<Self> {
        let extension = path
            .extension()
            .map(|extension| extension.to_string_lossy().to_ascii_lowercase())
            .unwrap_or_default();
        // Raw samples can look like any magic, so the names of formats without one go first.
        match extension.as_str() {
            "hgt" => return Some(Self::Hgt),
            "r16" | "raw" => return Some(Self::Raw16),
            "r32" => return Some(Self::Raw32),
            _ => {}
        }
        match magic {
            [0x89, b'P', b'N', b'G', ..] => Some(Self::Png),
            [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Some(Self::Tiff),
            [0x76, 0x2f, 0x31, 0x01, ..] => Some(Self::Exr),
            // Damaged beyond its magic: the format's own reader says so best.
            _ => match extension.as_str() {
                "png" => Some(Self::Png),
                "tif" | "tiff" => Some(Self::Tiff),
                "exr" => Some(Self::Exr),
                _ => None,
            },
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Png => "PNG",
            Self::Tiff => "TIFF",
            Self::Exr => "OpenEXR",
            Self::Hgt => "SRTM",
            Self::Raw16 | Self::Raw32 => "raw",
        }
    }
}

/// Opens `path` for buffered reading.
fn reader(path: &Path) -> Result<BufReader<File>, ImportError> {
    let file = File::open(path).map_err(|reason| ImportError::Read {
        path: path.to_owned(),
        reason,
    })?;
    Ok(BufReader::with_capacity(1 << 18, file))
}

fn damaged(path: &Path, format: &'static str, reason: impl Display) -> ImportError {
    ImportError::Damaged {
        path: path.to_owned(),
        format,
        reason: reason.to_string(),
    }
}

fn unsuitable(path: &Path, what: impl Into<String>, advice: impl Into<String>) -> ImportError {
    ImportError::Unsuitable {
        path: path.to_owned(),
        what: what.into(),
        advice: advice.into(),
    }
}

/// Checks a size that a header promises, before anything is allocated for it.
fn sized(path: &Path, width: u64, height: u64) -> Result<[u32; 2], ImportError> {
    let refused = || ImportError::Size {
        path: path.to_owned(),
        size: [width, height],
    };
    let side = |side: u64| u32::try_from(side).map_err(|_| refused());
    let size = [side(width)?, side(height)?];
    check_size(size).map_err(|_| refused())?;
    Ok(size)
}

/// How a file's numbers become metres.
#[derive(Clone, Copy, Debug)]
struct Scale {
    scale: f64,
    offset: f64,
}

impl Scale {
    /// For numbers that are metres unless `settings` say otherwise.
    fn metres(settings: &ImportSettings) -> Self {
        Self {
            scale: settings.scale.unwrap_or(1.0),
            offset: settings.offset.unwrap_or(0.0),
        }
    }

    /// For numbers 0 to `largest` that have no meaning of their own.
    fn share(settings: &ImportSettings, largest: f64) -> Self {
        match &settings.range_m {
            Some(range) if settings.scale.is_none() && settings.offset.is_none() => Self {
                scale: (range.end() - range.start()) / largest,
                offset: *range.start(),
            },
            _ => Self::metres(settings),
        }
    }

    /// A note for numbers without a meaning of their own that nobody gave one.
    fn note(settings: &ImportSettings, numbers: &str) -> Option<String> {
        let told = settings.range_m.is_some() || settings.scale.is_some();
        (!told).then(|| {
            format!(
                "{numbers} are taken as metres; --height-range-m LO..HI or --height-scale says \
                 otherwise"
            )
        })
    }

    fn apply(self, value: f64) -> f32 {
        (value * self.scale + self.offset) as f32
    }
}

/// A no-data value as a 16-bit number, where it is one.
fn whole(value: f64) -> Option<u16> {
    let whole = value as u16;
    (f64::from(whole) == value).then_some(whole)
}

/// Rows that a reader holds, decoded but not yet handed out.
enum Held {
    Codes(Vec<u16>),
    Metres(Vec<f32>),
}
