//! Pictures of a terrain on disk: relief, density, and one over the other.
//!
//! One pass over the tiles of one level, from north to south. Pixels take samples from one tile
//! each, borders included, so that a damaged tile spoils its own pixels and no others.

use crate::terrain::{INDEX_FILE, MANIFEST_FILE, ManifestError, ManifestFile, TerrainManifest};
use crate::tile::{DENSITY_CELL, DENSITY_TEXELS, TILE_SAMPLES};
use crate::tile::{DensityTile, HeightTile, TileAddress, TileFormatError};
use png::{BitDepth, ColorType, Compression, Encoder, SrgbRenderingIntent};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Read, Write};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::atomic::{AtomicU32, Ordering};
use thiserror::Error;

/// What can't be read.
const MAGENTA: [u8; 3] = [255, 0, 255];
/// Density's colours: 0, one half, 1.
const GREEN: [f64; 3] = [30.0, 160.0, 60.0];
const YELLOW: [f64; 3] = [250.0, 215.0, 50.0];
const RED: [f64; 3] = [220.0, 20.0, 30.0];
/// Light that reaches ground in its own shade, as a share of the sun's.
const AMBIENT: f64 = 0.12;
/// Light that the lowest ground loses against the highest.
const HAZE: f64 = 0.22;
/// What makes up for the light that blended colours lose on level ground.
const BRIGHTENED: f64 = 1.2;
/// The steepness, height over width of a tile, that slopes are brought to. Ground between a
/// tile's corners is some times as steep as the tile.
const TYPICAL_TILE: f64 = 0.3;
/// Tiles of a row that are held at once.
const CHUNK: u32 = 64;
/// What a preview says of itself, as the PNG file's keyword and text, by which it is known again.
const MARK: [&str; 2] = ["Software", "tessera preview"];
/// Bytes at the start of a PNG file that are looked through for the mark, which comes before the
/// pixels.
const HEAD: u64 = 4096;
/// More bytes than a tile's file has: what is longer is something else.
const LONGEST_FILE: u64 = 1 << 17;

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
    /// All kinds.
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
    /// What is shown.
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
    /// The picture's path names a folder, or nothing (`/`, `..`).
    #[error("{} is no name for a picture: it is a folder; give --out a file's name", path.display())]
    OutputFolder {
        /// The path.
        path: PathBuf,
    },
    /// The picture would go to a folder that isn't there.
    #[error(
        "{} can't be written: there is no folder {}; make it, or choose another --out",
        path.display(),
        folder.display()
    )]
    OutputParent {
        /// The path.
        path: PathBuf,
        /// The folder that is missing.
        folder: PathBuf,
    },
    /// The picture would replace a part of a terrain, or what isn't a file (a device, a pipe).
    #[error("{} is {what}, and is not replaced by a picture; choose another --out", path.display())]
    OutputOther {
        /// The path.
        path: PathBuf,
        /// What it is.
        what: &'static str,
    },
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
    let (mut partial, file) = PartialFile::create(&folder).map_err(failed)?;
    let mut file = BufWriter::new(file);
    drawing.write(&mut file).map_err(failed)?;
    let file = file.into_inner().map_err(|error| failed(error.into()))?;
    file.sync_all().map_err(failed)?;
    // Not every system renames what is open.
    drop(file);
    fs::rename(&partial.path, out).map_err(failed)?;
    partial.published = true;
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
    if out.file_name().is_none() {
        return Err(PreviewError::OutputFolder { path: path() });
    }
    let folder = match out.parent() {
        Some(parent) if parent != Path::new("") => parent.to_owned(),
        _ => PathBuf::from("."),
    };
    if !folder.is_dir() {
        return Err(PreviewError::OutputParent {
            path: path(),
            folder,
        });
    }
    let metadata = fs::metadata(out).ok();
    if let Some(metadata) = &metadata {
        if metadata.is_dir() {
            return Err(PreviewError::OutputFolder { path: path() });
        }
        if !metadata.is_file() {
            let what = "no regular file";
            return Err(PreviewError::OutputOther { path: path(), what });
        }
        let of_terrain = [MANIFEST_FILE, INDEX_FILE]
            .into_iter()
            .any(|name| out.ends_with(name))
            || ["tile"]
                .into_iter()
                .any(|extension| out.extension().is_some_and(|found| found == extension));
        if of_terrain {
            let what = "a part of a terrain";
            return Err(PreviewError::OutputOther { path: path(), what });
        }
    }
    let is_png = |extension: &OsStr| extension.eq_ignore_ascii_case("png");
    if !out.extension().is_some_and(is_png) {
        return Err(PreviewError::OutputExtension { path: path() });
    }
    if metadata.is_some_and(|metadata| metadata.len() > 0) && !is_preview(out) {
        return Err(PreviewError::OutputExists { path: path() });
    }
    Ok(folder)
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

/// A picture being written. Dropped, it is removed.
struct PartialFile {
    path: PathBuf,
    published: bool,
}

impl PartialFile {
    fn create(folder: &Path) -> io::Result<(Self, File)> {
        static PREVIEWS: AtomicU32 = AtomicU32::new(0);
        let preview = PREVIEWS.fetch_add(1, Ordering::Relaxed);
        let process = std::process::id();
        let path = folder.join(format!(".tessera-preview-{process}-{preview}.partial"));
        // Only a process that was killed can have left it, since this one has the number now.
        let _ = fs::remove_file(&path);
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&path)?;
        let published = false;
        Ok((Self { path, published }, file))
    }
}

impl Drop for PartialFile {
    fn drop(&mut self) {
        if !self.published {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// A stored tile, as far as it was needed and could be read.
#[derive(Default)]
struct Contents {
    heights: Option<HeightTile>,
    densities: Option<DensityTile>,
}

/// A tile's part of the picture: its samples and one ring around them.
struct Patch {
    /// The tile's own samples in x and z, the one that closes the terrain included.
    own: [usize; 2],
    /// Whether the terrain begins and ends here, in x and z.
    rim: [[bool; 2]; 2],
    heights: Option<Vec<f32>>,
    densities: Option<Vec<u8>>,
}

const RING: usize = TILE_SAMPLES as usize + 3;

/// What one pixel has seen so far.
#[derive(Clone, Copy, Default)]
struct Pixel {
    /// Sums over its samples: stored heights, and stored steps a sample in x and z.
    height: f64,
    slope: [f64; 2],
    samples: u32,
    density: u8,
    no_height: bool,
    no_density: bool,
}

struct Drawing<'a> {
    dir: &'a Path,
    terrain: &'a TerrainManifest,
    kind: PreviewKind,
    level: u8,
    /// Samples of a pixel, a side.
    factor: u32,
    /// Of one picture.
    size: [u32; 2],
    exaggeration: f64,
    /// Towards the sun: x, y, z.
    sun: [f64; 3],
    /// Lowest and highest stored height.
    range: [f64; 2],
    coarser_tiles: u64,
    warnings: Vec<String>,
    /// Tiles that a warning was given for already.
    warned: BTreeSet<TileAddress>,
}

impl<'a> Drawing<'a> {
    fn new(
        dir: &'a Path,
        terrain: &'a TerrainManifest,
        settings: &PreviewSettings,
    ) -> Result<Self, PreviewError> {
        let file = &terrain.file;
        let last = file.levels - 1;
        let longest = |level| file.samples(level).into_iter().fold(0, u32::max);
        let level = match settings.level {
            Some(level) if level > last => {
                return Err(PreviewError::Level {
                    path: dir.to_owned(),
                    found: level,
                    last,
                });
            }
            Some(level) => level,
            None => (0..last)
                .find(|&level| longest(level) <= settings.max_size_px)
                .unwrap_or(last),
        };
        let factor = longest(level).div_ceil(settings.max_size_px).max(1);
        let (azimuth, altitude) = (
            settings.sun_azimuth_deg.to_radians(),
            settings.sun_altitude_deg.to_radians(),
        );
        let whole = terrain
            .index
            .iter()
            .map(|(_, range)| range)
            .reduce(|a, b| a.union(b));
        Ok(Self {
            dir,
            terrain,
            kind: settings.kind,
            level,
            factor,
            size: file.samples(level).map(|samples| samples.div_ceil(factor)),
            exaggeration: settings
                .exaggeration
                .unwrap_or_else(|| typical_exaggeration(terrain, level)),
            sun: [
                azimuth.sin() * altitude.cos(),
                altitude.sin(),
                -azimuth.cos() * altitude.cos(),
            ],
            range: whole.map_or([0.0; 2], |range| [range.min.into(), range.max.into()]),
            coarser_tiles: 0,
            warnings: Vec::new(),
            warned: BTreeSet::new(),
        })
    }

    fn size_px(&self) -> [u32; 2] {
        [self.size[0] * self.kind.panels().len() as u32, self.size[1]]
    }

    /// Metres between samples of the level.
    fn spacing_m(&self) -> f64 {
        self.terrain.file.spacing_m * f64::from(self.level).exp2()
    }

    fn write(&mut self, out: &mut impl Write) -> io::Result<()> {
        let [width, height] = self.size_px();
        let mut encoder = Encoder::new(out, width, height);
        encoder.set_color(ColorType::Rgb);
        encoder.set_depth(BitDepth::Eight);
        encoder.set_source_srgb(SrgbRenderingIntent::Perceptual);
        encoder.set_compression(Compression::Balanced);
        encoder.add_text_chunk(MARK[0].to_owned(), MARK[1].to_owned())?;
        let mut writer = encoder.write_header()?;
        let mut rows = writer.stream_writer()?;
        self.draw(&mut |bytes| rows.write_all(bytes))?;
        rows.finish()?;
        Ok(writer.finish()?)
    }

    /// Hands out the picture's bytes from its first to its last row.
    fn draw(&mut self, emit: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<()> {
        let tiles = self.terrain.file.tiles(self.level);
        let samples = self.terrain.file.samples(self.level);
        let width = self.size[0] as usize;
        // Rows of pixels that are begun and not done; the first is row `first` of the picture.
        let mut begun: Vec<Pixel> = Vec::new();
        let mut first = 0;
        for z in 0..tiles[1] {
            // The last row of tiles has one more row of samples of its own, which closes it.
            let end = if z + 1 == tiles[1] {
                samples[1]
            } else {
                TILE_SAMPLES * (z + 1)
            };
            begun.resize(
                (end.div_ceil(self.factor) - first) as usize * width,
                Pixel::default(),
            );
            for x in (0..tiles[0]).step_by(CHUNK as usize) {
                let columns = x..tiles[0].min(x + CHUNK);
                let patches = self.patches(columns.clone(), z);
                let (factor, begins) = (self.factor, [TILE_SAMPLES * x, TILE_SAMPLES * z]);
                begun
                    .par_chunks_mut(width)
                    .enumerate()
                    .for_each(|(row, pixels)| {
                        let at = first + row as u32;
                        let from = (at * factor).max(begins[1]);
                        for sample in from..(at + 1).saturating_mul(factor).min(end) {
                            add_row(
                                pixels,
                                factor,
                                begins[0],
                                &patches,
                                (sample - begins[1]) as usize,
                            );
                        }
                    });
            }
            let done = if z + 1 == tiles[1] {
                self.size[1]
            } else {
                end / self.factor
            };
            let mut pixels = begun;
            begun = pixels.split_off((done - first) as usize * width);
            first = done;
            let colours: Vec<Vec<u8>> = pixels
                .par_chunks(width)
                .map(|row| self.colours(row))
                .collect();
            colours.iter().try_for_each(|row| emit(row))?;
        }
        Ok(())
    }

    /// Reads what the given tiles of the row `z` are drawn from.
    fn patches(&mut self, columns: std::ops::Range<u32>, z: u32) -> Vec<Patch> {
        let index = &self.terrain.index;
        let tiles: Vec<(TileAddress, Option<TileAddress>)> = columns
            .map(|x| {
                let tile = TileAddress::new(self.level, x, z);
                let source = (self.level..self.terrain.file.levels)
                    .filter_map(|level| tile.ancestor(level))
                    .find(|&ancestor| index.get(ancestor).is_some());
                (tile, source)
            })
            .collect();
        let sources: BTreeSet<TileAddress> = tiles.iter().filter_map(|tile| tile.1).collect();
        let sources: Vec<(TileAddress, Contents, Vec<String>)> = sources
            .into_par_iter()
            .map(|source| {
                let (contents, faults) = read_tile(self.dir, self.kind, source);
                (source, contents, faults)
            })
            .collect();
        let mut contents = BTreeMap::new();
        for (source, found, faults) in sources {
            if !faults.is_empty() && self.warned.insert(source) {
                self.warnings.extend(faults);
            }
            contents.insert(source, found);
        }
        for &(tile, source) in &tiles {
            match source {
                Some(source) if source == tile => {}
                Some(_) => self.coarser_tiles += 1,
                None => self.warnings.push(format!(
                    "the tile {tile} is not stored, and nor is any that covers it; it is magenta"
                )),
            }
        }
        let file = &self.terrain.file;
        tiles
            .par_iter()
            .map(|&(tile, source)| {
                let found = source.and_then(|source| Some((source, contents.get(&source)?)));
                Patch::new(file, tile, found)
            })
            .collect()
    }

    /// A row of the picture's bytes.
    fn colours(&self, row: &[Pixel]) -> Vec<u8> {
        let panels = self.kind.panels();
        let mut bytes = Vec::with_capacity(row.len() * 3 * panels.len());
        for panel in panels {
            for pixel in row {
                bytes.extend_from_slice(&self.colour(*panel, pixel));
            }
        }
        bytes
    }

    fn colour(&self, panel: PreviewKind, pixel: &Pixel) -> [u8; 3] {
        let (relief, density) = (panel != PreviewKind::Density, panel != PreviewKind::Relief);
        if (relief && pixel.no_height) || (density && pixel.no_density) {
            return MAGENTA;
        }
        let byte = |value: f64| value.round().clamp(0.0, 255.0) as u8;
        match panel {
            PreviewKind::Density => density_colour(pixel.density).map(byte),
            PreviewKind::Blended => {
                let light = BRIGHTENED * self.shade(pixel);
                density_colour(pixel.density).map(|channel| byte(channel * light))
            }
            PreviewKind::Relief | PreviewKind::All => [byte(255.0 * self.shade(pixel)); 3],
        }
    }

    /// Brightness of a pixel's ground.
    fn shade(&self, pixel: &Pixel) -> f64 {
        let samples = f64::from(pixel.samples.max(1));
        let scale = self.terrain.file.height_step_m / self.spacing_m() * self.exaggeration;
        let [low, high] = self.range;
        let height = if low < high {
            ((pixel.height / samples - low) / (high - low)).clamp(0.0, 1.0)
        } else {
            0.5
        };
        self.light(pixel.slope.map(|slope| slope / samples * scale)) * haze(height)
    }

    /// Lambert's law, for ground that rises by so much a metre in x and z.
    fn light(&self, [x, z]: [f64; 2]) -> f64 {
        let [sun_x, sun_y, sun_z] = self.sun;
        let length = (x * x + z * z + 1.0).sqrt();
        let cosine = (sun_y - x * sun_x - z * sun_z) / length;
        AMBIENT + (1.0 - AMBIENT) * cosine.max(0.0)
    }
}

/// Brightness of ground at a height between the terrain's lowest, 0, and its highest, 1.
fn haze(height: f64) -> f64 {
    1.0 - HAZE + HAZE * height
}

/// By how much slopes have to be exaggerated for the level's tiles to be as steep as
/// [`TYPICAL_TILE`]. Goes by the index, which is there as a whole or not at all: whichever tiles
/// are damaged, the others look the same.
fn typical_exaggeration(terrain: &TerrainManifest, level: u8) -> f64 {
    let TerrainManifest { file, index } = terrain;
    let samples = file.samples(level);
    let spacing_m = file.spacing_m * f64::from(level).exp2();
    let (mut squares, mut weights) = (0.0, 0.0);
    for (tile, range) in index.iter().filter(|(tile, _)| tile.level == level) {
        let (x, z) = tile.first_sample();
        let own = |axis: usize, at: u32| f64::from((samples[axis] - 1 - at).min(TILE_SAMPLES));
        let (width, height) = (own(0, x), own(1, z));
        let rise_m = f64::from(range.max - range.min) * file.height_step_m;
        let slope = rise_m / (width.max(height) * spacing_m);
        squares += slope * slope * width * height;
        weights += width * height;
    }
    let steepness = (squares / weights).sqrt();
    let (low, high) = PreviewSettings::CHOSEN_EXAGGERATION.into_inner();
    // Level ground, or no tiles at all.
    if steepness.is_finite() && steepness > 0.0 {
        (TYPICAL_TILE / steepness).clamp(low, high)
    } else {
        1.0
    }
}

fn density_colour(density: u8) -> [f64; 3] {
    let half = 127.5;
    let density = f64::from(density);
    let (from, to, share) = if density < half {
        (GREEN, YELLOW, density / half)
    } else {
        (YELLOW, RED, (density - half) / half)
    };
    [0, 1, 2].map(|channel| from[channel] + (to[channel] - from[channel]) * share)
}

/// Reads the files of a tile that the kind of preview needs; what is wrong with them in sentences.
fn read_tile(dir: &Path, kind: PreviewKind, tile: TileAddress) -> (Contents, Vec<String>) {
    fn read<T>(
        dir: &Path,
        path: &str,
        decode: impl FnOnce(&[u8]) -> Result<T, TileFormatError>,
        faults: &mut Vec<String>,
    ) -> Option<T> {
        let mut bytes = Vec::new();
        let read = File::open(dir.join(path))
            .and_then(|file| file.take(LONGEST_FILE).read_to_end(&mut bytes));
        let reason = match (read, decode(&bytes)) {
            (Err(reason), _) => format!("read: {reason}"),
            (Ok(_), Err(reason)) => format!("used: {reason}"),
            (Ok(_), Ok(tile)) => return Some(tile),
        };
        faults.push(format!("{path} can't be {reason}; it is magenta"));
        None
    }
    let mut faults = Vec::new();
    let mut contents = Contents::default();
    if kind != PreviewKind::Density {
        let decode = |bytes: &[u8]| HeightTile::decode(bytes, tile);
        contents.heights = read(dir, &HeightTile::path(tile), decode, &mut faults);
    }
    if kind != PreviewKind::Relief {
        let decode = |bytes: &[u8]| DensityTile::decode(bytes, tile);
        contents.densities = read(dir, &DensityTile::path(tile), decode, &mut faults);
    }
    // Where the file is missing, both sections say so.
    faults.dedup();
    (contents, faults)
}

impl Patch {
    /// Takes the tile from `source`, which is itself or an ancestor.
    fn new(
        file: &ManifestFile,
        tile: TileAddress,
        source: Option<(TileAddress, &Contents)>,
    ) -> Self {
        let samples = file.samples(tile.level);
        let (x, z) = tile.first_sample();
        let first = [x, z];
        let own = [0, 1].map(|axis| {
            let left = samples[axis] - first[axis];
            // One more where it is the terrain's last.
            let last = left <= TILE_SAMPLES + 1;
            if last { left } else { TILE_SAMPLES }
        });
        let rim = [0, 1].map(|axis| [first[axis] == 0, first[axis] + own[axis] == samples[axis]]);
        let own = own.map(|samples| samples as usize);
        let mut patch = Self {
            own,
            rim,
            heights: None,
            densities: None,
        };
        let Some((source, contents)) = source else {
            return patch;
        };
        let up = source.level - tile.level;
        let coarse = file.samples(source.level);
        let (x, z) = source.first_sample();
        let origin = [x, z];
        // The level's sample `at` of the ring, counted from the terrain's corner; those beyond the
        // terrain are the last within.
        let place = |axis: usize, at: usize| {
            (first[axis] + at as u32)
                .saturating_sub(1)
                .min(samples[axis] - 1)
        };

        patch.heights = contents.heights.as_ref().map(|heights| {
            // The sample before, counted from the source's first, and how far beyond it lies.
            let [columns, rows] = [0, 1].map(|axis| {
                (0..own[axis] + 2)
                    .map(|at| {
                        // Aligned to the source's first sample, so that a place before it is
                        // between two of its border.
                        let place = i64::from(place(axis, at)) - (i64::from(origin[axis]) << up);
                        let before = place >> up;
                        let share = (place - (before << up)) as f32 / (1_u64 << up) as f32;
                        (before as i32, share)
                    })
                    .collect::<Vec<_>>()
            });
            let mut ring = vec![0.0; RING * RING];
            for (line, &(row, down)) in ring.chunks_exact_mut(RING).zip(&rows) {
                for (height, &(column, right)) in line.iter_mut().zip(&columns) {
                    let at = |x, z| f32::from(heights.get(x, z));
                    *height = at(column, row);
                    if up > 0 {
                        let along = |z| {
                            let left = at(column, z);
                            left + (at(column + 1, z) - left) * right
                        };
                        *height = along(row) + (along(row + 1) - along(row)) * down;
                    }
                }
            }
            ring
        });
        patch.densities = contents.densities.as_ref().map(|densities| {
            let [columns, rows] = [0, 1].map(|axis| {
                (0..own[axis])
                    .map(|at| {
                        // The terrain's last sample belongs to the texel before it.
                        let sample = (place(axis, at + 1) >> up).min(coarse[axis] - 2);
                        ((sample - origin[axis]) / DENSITY_CELL).min(DENSITY_TEXELS - 1) as i32
                    })
                    .collect::<Vec<_>>()
            });
            rows.iter()
                .flat_map(|&row| columns.iter().map(move |&column| (column, row)))
                .map(|(column, row)| densities.get(column, row))
                .collect()
        });
        patch
    }

    /// Height and slope in x and z of an own sample, by Horn's 3 × 3 in stored steps a sample.
    fn ground(&self, x: usize, z: usize) -> Option<(f64, [f64; 2])> {
        let ring = self.heights.as_ref()?;
        let at = |dx: usize, dz: usize| f64::from(ring[(z + dz) * RING + x + dx]);
        let west = at(0, 0) + 2.0 * at(0, 1) + at(0, 2);
        let east = at(2, 0) + 2.0 * at(2, 1) + at(2, 2);
        let north = at(0, 0) + 2.0 * at(1, 0) + at(2, 0);
        let south = at(0, 2) + 2.0 * at(1, 2) + at(2, 2);
        // At the rim, one of the two neighbours is the sample itself.
        let apart = |axis: usize, place: usize| {
            let [begins, ends] = self.rim[axis];
            let missing = [begins && place == 0, ends && place + 1 == self.own[axis]];
            2.0 - missing.into_iter().map(f64::from).sum::<f64>()
        };
        let slope = [
            (east - west) / (4.0 * apart(0, x)),
            (south - north) / (4.0 * apart(1, z)),
        ];
        Some((at(1, 1), slope))
    }
}

/// Adds a row of samples of neighbouring tiles to a row of pixels. `begin` is the first tile's
/// first column, `z` counts from the tiles' first row.
fn add_row(row: &mut [Pixel], factor: u32, begin: u32, patches: &[Patch], z: usize) {
    let mut column = begin;
    for patch in patches {
        for x in 0..patch.own[0] {
            let pixel = &mut row[(column / factor) as usize];
            column += 1;
            pixel.samples += 1;
            match patch.ground(x, z) {
                Some((height, slope)) => {
                    pixel.height += height;
                    pixel.slope[0] += slope[0];
                    pixel.slope[1] += slope[1];
                }
                None => pixel.no_height = true,
            }
            match &patch.densities {
                Some(densities) => {
                    pixel.density = pixel.density.max(densities[z * patch.own[0] + x]);
                }
                None => pixel.no_density = true,
            }
        }
    }
}
