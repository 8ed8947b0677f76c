//! Pictures of a terrain on disk: relief, density, and one over the other.
//!
//! One pass over the tiles of one level, from north to south. Pixels take samples from one tile
//! each, borders included, so that a damaged tile spoils its own pixels and no others.

mod drawing;

use crate::output::{OutputError, PartialFile, check_place};
use crate::terrain::{ManifestError, TerrainManifest};
use drawing::Drawing;
use std::ffi::OsStr;
use std::fmt;
use std::fs::File;
use std::io::{self, BufWriter, Read};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use thiserror::Error;

/// What a preview says of itself, as the PNG file's keyword and text, by which it is known again.
const MARK: [&str; 2] = ["Software", "tessera preview"];
/// Bytes at the start of a PNG file that are looked through for the mark, which comes before the
/// pixels.
const HEAD: u64 = 4096;
/// What a preview shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum PreviewKind {
    /// Shaded relief in grey, the high ground a little lighter.
    Relief,
    /// Densities: green is 0, yellow one half, red 1.
    Density,
    /// Density's colours, multiplied with the relief and brightened by a fifth.
    Blended,
    /// Relief, density and both blended, from left to right.
    #[default]
    All,
}

impl PreviewKind {
    /// All kinds, in the order in which the tool lists them.
    pub const ALL: [Self; 4] = [Self::Relief, Self::Density, Self::Blended, Self::All];

    /// The kind's name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Relief => "relief",
            Self::Density => "density",
            Self::Blended => "blended",
            Self::All => "all",
        }
    }

    /// The pictures that it consists of, from left to right.
    fn panels(self) -> &'static [Self] {
        match self {
            Self::Relief => &[Self::Relief],
            Self::Density => &[Self::Density],
            Self::Blended => &[Self::Blended],
            Self::All => &[Self::Relief, Self::Density, Self::Blended],
        }
    }
}

impl fmt::Display for PreviewKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(self.name())
    }
}

impl FromStr for PreviewKind {
    type Err = PreviewError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::ALL
            .into_iter()
            .find(|kind| kind.name() == text)
            .ok_or_else(|| PreviewError::Kind {
                found: text.chars().take(40).collect(),
            })
    }
}

/// What a preview may be told.
#[derive(Clone, Debug, PartialEq)]
pub struct PreviewSettings {
    /// What is shown: relief, density or both.
    pub kind: PreviewKind,
    /// The longest side in pixels that one picture may have; [`PreviewKind::All`] puts three of
    /// them side by side. In [`MAX_SIZE_RANGE`](Self::MAX_SIZE_RANGE).
    pub max_size_px: u32,
    /// The level that is drawn, one pixel a sample; the finest that fits `max_size_px` unless
    /// set. A level that doesn't fit is reduced by a whole number: the mean of its ground, the
    /// largest of its densities.
    pub level: Option<u8>,
    /// Where the sun stands, in degrees from north (up in the picture, -z) by east (right, +x). In
    /// [`SUN_AZIMUTH_RANGE`](Self::SUN_AZIMUTH_RANGE).
    pub sun_azimuth_deg: f64,
    /// How high the sun stands, in degrees above the horizon. In
    /// [`SUN_ALTITUDE_RANGE`](Self::SUN_ALTITUDE_RANGE).
    pub sun_altitude_deg: f64,
    /// By how much slopes are exaggerated for shading; 1 shows them as they are. Unless set, by
    /// as much as brings the terrain's tiles to a middling steepness, so that plains show their
    /// hollows and a height map without a scale isn't black; level ground stays level. In
    /// [`EXAGGERATION_RANGE`](Self::EXAGGERATION_RANGE).
    pub exaggeration: Option<f64>,
}

impl Default for PreviewSettings {
    fn default() -> Self {
        Self {
            kind: PreviewKind::All,
            max_size_px: 1025,
            level: None,
            sun_azimuth_deg: 315.0,
            sun_altitude_deg: 45.0,
            exaggeration: None,
        }
    }
}

impl PreviewSettings {
    /// Longest sides that are accepted, in pixels.
    pub const MAX_SIZE_RANGE: RangeInclusive<u32> = 16..=8192;
    /// Azimuths that are accepted, in degrees.
    pub const SUN_AZIMUTH_RANGE: RangeInclusive<f64> = 0.0..=360.0;
    /// Altitudes that are accepted, in degrees.
    pub const SUN_ALTITUDE_RANGE: RangeInclusive<f64> = 1.0..=90.0;
    /// Exaggerations that are accepted.
    pub const EXAGGERATION_RANGE: RangeInclusive<f64> = 0.001..=1000.0;
    /// Exaggerations that are chosen where none is set: more would show little but the steps
    /// between stored heights.
    const CHOSEN_EXAGGERATION: RangeInclusive<f64> = 0.001..=20.0;

    /// Checks that every number lies in its range.
    ///
    /// # Errors
    /// For the first number that doesn't.
    pub fn validate(&self) -> Result<(), PreviewError> {
        // NaN lies in no range.
        let check = |name, found: f64, range: RangeInclusive<f64>| {
            let error = PreviewError::Range {
                name,
                found,
                low: *range.start(),
                high: *range.end(),
            };
            range.contains(&found).then_some(()).ok_or(error)
        };
        let (low, high) = Self::MAX_SIZE_RANGE.into_inner();
        let size = f64::from(low)..=f64::from(high);
        check("size in pixels", self.max_size_px.into(), size)?;
        check(
            "sun azimuth in degrees",
            self.sun_azimuth_deg,
            Self::SUN_AZIMUTH_RANGE,
        )?;
        check(
            "sun altitude in degrees",
            self.sun_altitude_deg,
            Self::SUN_ALTITUDE_RANGE,
        )?;
        match self.exaggeration {
            Some(found) => check("exaggeration", found, Self::EXAGGERATION_RANGE),
            None => Ok(()),
        }
    }
}

/// What a preview shows, and what it couldn't.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PreviewReport {
    /// Width and height of the picture in pixels, that of all three where there are three.
    pub size_px: [u32; 2],
    /// The level that was drawn.
    pub level: u8,
    /// Metres between neighbouring pixels.
    pub pixel_m: f64,
    /// By how much slopes were exaggerated.
    pub exaggeration: f64,
    /// Tiles that aren't stored at the level and were drawn from a coarser one.
    pub coarser_tiles: u64,
    /// What is drawn in magenta, one sentence a file, and why.
    pub warnings: Vec<String>,
}

/// Why there is no picture. Each message is a sentence that names the file and the cause; a file
/// that stood in the picture's place still stands there.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PreviewError {
    /// No kind has that name.
    #[error("there is no preview {found:?}: it is one of relief, density, blended and all")]
    Kind {
        /// The name found, at most 40 characters of it.
        found: String,
    },
    /// A setting lies outside its range.
    #[error("the preview's {name} is {found}, and has to lie in {low}..={high}")]
    Range {
        /// What was set.
        name: &'static str,
        /// Its value.
        found: f64,
        /// The least that is accepted.
        low: f64,
        /// The most that is accepted.
        high: f64,
    },
    /// The terrain has no such level.
    #[error("{} has no level {found}: its levels are 0..={last}", path.display())]
    Level {
        /// The terrain's folder.
        path: PathBuf,
        /// The level that was asked for.
        found: u8,
        /// The terrain's coarsest level.
        last: u8,
    },
    /// The folder holds no terrain.
    #[error("{} is no terrain that can be used: {reason}", path.display())]
    Terrain {
        /// The folder.
        path: PathBuf,
        /// What is wrong with it.
        reason: Box<ManifestError>,
    },
    /// Nothing may be written at that path.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The picture's name doesn't end in `.png`.
    #[error(
        "{} is no name for a preview, which is a PNG file; give --out a name that ends in .png",
        path.display()
    )]
    OutputExtension {
        /// The path.
        path: PathBuf,
    },
    /// The picture would replace a file that is no preview, such as a height map.
    #[error(
        "{} exists and is no preview, so it isn't replaced; choose another --out or remove it",
        path.display()
    )]
    OutputExists {
        /// The path.
        path: PathBuf,
    },
    /// The picture can't be written.
    #[error("{} can't be written: {reason}; choose another --out", path.display())]
    Write {
        /// The picture's file.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
}

/// Draws the terrain in the folder `dir` into the 8 bit RGB PNG file `out`: x to the right, z
/// downwards, one pixel a sample of one level.
///
/// Reads the level's tiles once, those of heights, of densities or both. The finest level that
/// fits has at most [`max_size_px`](PreviewSettings::max_size_px)² samples and takes a second or
/// less at the default of 1025; a [`level`](PreviewSettings::level) that is asked for is read
/// whatever it costs. Takes some 4 KiB of memory for every pixel of the picture's width, and 10
/// MiB.
///
/// A tile that isn't stored is drawn from its finest stored ancestor. One that can't be read, and
/// every pixel that would take something from it, is magenta and is told of in the report.
///
/// The picture is written beside `out`, under another name, and then renamed. It carries a `tEXt`
/// chunk (`Software`: `tessera preview`). An `out` that exists is replaced where it carries the same
/// or is empty, and nothing else is.
///
/// # Errors
/// Where settings are out of range, `dir` is no terrain, or `out` can't be written, isn't called
/// `.png` or exists and is no preview; see [`PreviewError`]. What stood at `out` then stands there
/// still.
pub fn preview(
    dir: &Path,
    out: &Path,
    settings: &PreviewSettings,
) -> Result<PreviewReport, PreviewError> {
    settings.validate()?;
    let folder = check_output(out)?;
    let terrain = TerrainManifest::read(dir).map_err(|reason| PreviewError::Terrain {
        path: dir.to_owned(),
        reason: Box::new(reason),
    })?;
    let mut drawing = Drawing::new(dir, &terrain, settings)?;
    let failed = |reason| PreviewError::Write {
        path: out.to_owned(),
        reason,
    };
    let (partial, file) = PartialFile::create(&folder, "preview").map_err(failed)?;
    let mut file = BufWriter::new(file);
    drawing.write(&mut file).map_err(failed)?;
    let file = file.into_inner().map_err(|error| failed(error.into()))?;
    partial.publish(file, out).map_err(failed)?;
    let spacing_m = drawing.spacing_m();
    Ok(PreviewReport {
        size_px: drawing.size_px(),
        level: drawing.level,
        pixel_m: spacing_m * f64::from(drawing.factor),
        exaggeration: drawing.exaggeration,
        coarser_tiles: drawing.coarser_tiles,
        warnings: drawing.warnings,
    })
}

/// Whether `out` may be written; the folder in which it lies.
fn check_output(out: &Path) -> Result<PathBuf, PreviewError> {
    let path = || out.to_owned();
    let place = check_place(out, "picture")?;
    let is_png = |extension: &OsStr| extension.eq_ignore_ascii_case("png");
    if !out.extension().is_some_and(is_png) {
        return Err(PreviewError::OutputExtension { path: path() });
    }
    if place.metadata.is_some_and(|metadata| metadata.len() > 0) && !is_preview(out) {
        return Err(PreviewError::OutputExists { path: path() });
    }
    Ok(place.folder)
}

/// Whether the file is a PNG file that carries the mark. One that can't be read is not known to
/// be.
fn is_preview(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
    let mark = format!("tEXt{}\0{}", MARK[0], MARK[1]);
    read.is_ok()
        && head.starts_with(b"\x89PNG\r\n\x1a\n")
        && head
            .windows(mark.len())
            .any(|found| found == mark.as_bytes())
}
