//! Turning a height map into a terrain: densities, a pyramid of levels, tiles, bounds.
//!
//! Everything is streamed through in bands of rows, so that the memory a bake takes grows with the
//! source's width and not with its area; all cores work on every band. The result is written to a
//! folder beside the wanted one and renamed at the end, so that a bake that is stopped leaves the
//! old terrain or none.
//!
//! # The pyramid
//! Sample `k` of level `l + 1` lies on sample `2 k` of level `l` and is the mean of that sample's
//! neighbourhood with the weights 1 2 1, 2 4 2, 1 2 1, rounded to the nearest (halves up). Beyond
//! a level's rim the ground goes on straight, so that planes stay planes: the mean on the rim is the
//! rim's own. Every tile is a window of this one function, and
//! so neighbours agree in their borders bit for bit.
//!
//! # Densities
//! Texels of level 0 follow from the stored heights, see [`density`](crate::density); texels of the
//! levels above are the largest of the four that they cover. [`rebake_densities`] makes them anew.
//!
//! # Error bounds
//! Each tile's follow from the stored heights of its level on it and around it, see
//! [`error_bound`](crate::error_bound), and from its children's, which they don't fall below.
//!
//! # Parts
//! What one machine can't bake, several can: see [`shard`].

mod apply;
mod fill;
#[cfg(feature = "generate")]
pub mod generate;
#[cfg(feature = "import")]
pub mod import;
#[cfg(feature = "import")]
mod preview;
mod pyramid;
mod quantise;
mod rebake;
mod report;
pub mod shard;
mod source;
mod span;
mod verify;
mod writer;

pub use apply::{ApplyReport, apply_edits};
#[cfg(feature = "import")]
pub use preview::{PreviewError, PreviewKind, PreviewReport, PreviewSettings, preview};
pub use rebake::{DensityReport, rebake_densities};
pub use report::{BakeError, BakeProgress, BakeReport, BakeStage};
pub use source::{CodeMapping, HeightSource, MemorySource, SourceError};
#[cfg(feature = "archive")]
pub use verify::verify_archive;
pub use verify::{Fault, VerifyReport, verify};

use crate::density::DensitySettings;
use crate::terrain::{MANIFEST_MAGIC, MANIFEST_VERSION, ManifestFile, check_size};
use pyramid::{Pyramid, Sections};
use quantise::{BandReader, Bands, Quantiser};
use span::Span;
use std::ops::RangeInclusive;
use std::path::Path;
use std::time::{Duration, Instant};
use writer::PartialTerrain;
pub use writer::put_right;
#[cfg(feature = "archive")]
pub(crate) use writer::{FolderWriter, partial_path};

pub use pyramid::tent_row;

/// Metres of headroom below the lowest and above the highest sample, unless told otherwise.
pub const DEFAULT_HEADROOM_M: f64 = 64.0;
/// The largest height, up or down, that a bake takes for a height in metres: a thousand
/// kilometres. What lies beyond is a no-data value that nobody declared.
pub const MAX_HEIGHT_M: f64 = 1.0e6;
/// Distances between samples that a bake accepts, in metres.
pub const SPACING_RANGE_M: RangeInclusive<f64> = 1.0e-4..=1.0e6;

/// Samples that one band aims at: enough to keep all cores busy, few enough to stay in little
/// memory. Bands are whole rows, at least [`MIN_BAND_ROWS`] of them.
const BAND_SAMPLES: usize = 1 << 21;
const MIN_BAND_ROWS: u32 = 32;

/// What a bake may be told.
#[derive(Clone, Debug, PartialEq)]
pub struct BakeSettings {
    /// Metres between neighbouring samples; what the source says (1 m where it says nothing)
    /// unless set.
    pub spacing_m: Option<f64>,
    /// Heights that the stored 0 and 65535 stand for, in metres; the source's own lowest and
    /// highest height with `headroom_m` unless set. Samples outside are clamped and counted.
    pub height_range_m: Option<RangeInclusive<f64>>,
    /// Metres kept free below and above the source's heights, so that ground can be dug away and
    /// piled up. Ignored where `height_range_m` is set.
    pub headroom_m: f64,
    /// How densities follow from heights.
    pub density: DensitySettings,
    /// Rows that are read at once; as many as suit the source's width unless set. Changes how
    /// long a bake takes and how much memory, never what comes out.
    pub band_rows: Option<u32>,
    /// Whether a terrain that exists already is replaced.
    pub force: bool,
    /// For benchmarks only: leaves densities out of the files, so that it shows what they cost.
    /// The result is no terrain.
    #[doc(hidden)]
    pub leave_out_densities: bool,
    /// The same for error bounds.
    #[doc(hidden)]
    pub leave_out_errors: bool,
}

impl Default for BakeSettings {
    fn default() -> Self {
        Self {
            spacing_m: None,
            height_range_m: None,
            headroom_m: DEFAULT_HEADROOM_M,
            density: DensitySettings::default(),
            band_rows: None,
            force: false,
            leave_out_densities: false,
            leave_out_errors: false,
        }
    }
}

impl BakeSettings {
    /// Rows of a band of a source of `size` samples.
    fn rows_at_once(&self, size: [u32; 2]) -> u32 {
        self.band_rows
            .unwrap_or_else(|| (BAND_SAMPLES as u32 / size[0]).max(MIN_BAND_ROWS))
            .clamp(1, size[1])
    }

    /// Checks what doesn't need the source.
    fn validate(&self) -> Result<(), BakeError> {
        let within = |value: f64| value.is_finite() && value.abs() <= MAX_HEIGHT_M;
        if let Some(range) = &self.height_range_m
            && !(within(*range.start()) && within(*range.end()) && range.start() < range.end())
        {
            return Err(BakeError::HeightRange {
                low: *range.start(),
                high: *range.end(),
            });
        }
        if !(within(self.headroom_m) && self.headroom_m >= 0.0) {
            return Err(BakeError::Headroom {
                found: self.headroom_m,
            });
        }
        Ok(self.density.validate()?)
    }
}

/// Bakes `source` into the folder `out`.
///
/// Reads the source once, twice where its range isn't given or it may have samples without data,
/// and three times where it has some. Takes some 50 MiB of memory and 1.5 KiB for every column;
/// where samples have no data, up to 180 MiB more.
///
/// # Errors
/// Where settings or source can't be used, or the output exists (without
/// [`force`](BakeSettings::force)) or can't be written; see [`BakeError`]. `out` is then as it was
/// before.
pub fn bake(
    source: &mut dyn HeightSource,
    out: &Path,
    settings: &BakeSettings,
    progress: &dyn BakeProgress,
) -> Result<BakeReport, BakeError> {
    let start = Instant::now();
    let spacing_m = check(source, settings)?;
    // Before any work, so that a forgotten --force doesn't cost an hour.
    writer::prepare(out, settings.force)?;
    let mut plan = Plan::make(source, settings, spacing_m, progress)?;

    let partial = PartialTerrain::create(out, &plan.manifest)?;
    let sections = Sections {
        densities: !settings.leave_out_densities,
        errors: !settings.leave_out_errors,
    };
    let span = Span::whole(&plan.manifest);
    let mut pyramid = Pyramid::new(&plan.manifest, &span, partial.dir(), sections);
    let bands = Bands {
        rows: span.rows,
        at_once: settings.rows_at_once(plan.manifest.size),
        unit: u32::MAX,
    };
    let mut clamped = 0;
    stream(
        source,
        &plan,
        bands,
        &mut pyramid,
        progress,
        &mut |_, band| {
            clamped += band.clamped;
            Ok::<_, BakeError>(())
        },
    )?;
    let (mut index, bytes) = pyramid.finish();
    index.cover_children();
    let tiles = index.iter().count() as u64;
    let bytes = bytes + partial.write_index(&mut plan.manifest, &index)?;
    progress.stage(BakeStage::Finish, 0);
    partial.carry_over(&writer::is_ours)?;
    partial.publish(settings.force)?;

    Ok(BakeReport {
        tiles,
        bytes,
        clamped,
        elapsed: start.elapsed(),
        ..plan.report()
    })
}

/// Checks what can be checked before the source is read; returns the distance between samples.
fn check(source: &dyn HeightSource, settings: &BakeSettings) -> Result<f64, BakeError> {
    settings.validate()?;
    let size = source.size();
    check_size(size).map_err(|_| BakeError::Size {
        name: source.name(),
        size,
    })?;
    let spacing_m = settings.spacing_m.or(source.spacing_m()).unwrap_or(1.0);
    if !SPACING_RANGE_M.contains(&spacing_m) {
        return Err(BakeError::Spacing { found: spacing_m });
    }
    Ok(spacing_m)
}

/// What a bake knows before it makes its first tile: all that depends on the whole source.
struct Plan {
    survey: fill::Survey,
    fill: fill::Fill,
    range: RangeInclusive<f64>,
    quantiser: Quantiser,
    /// The terrain's, but for the index's checksum.
    manifest: ManifestFile,
}

impl Plan {
    /// Reads the source as often as it takes.
    fn make(
        source: &mut dyn HeightSource,
        settings: &BakeSettings,
        spacing_m: f64,
        progress: &dyn BakeProgress,
    ) -> Result<Self, BakeError> {
        let size = source.size();
        let survey = fill::survey(source, settings.height_range_m.is_none(), progress)?;
        if survey.no_data == u64::from(size[0]) * u64::from(size[1]) {
            return Err(BakeError::AllNoData {
                name: source.name(),
            });
        }
        let range = match (&settings.height_range_m, survey.heights_m) {
            (Some(range), _) => range.clone(),
            (None, Some((low, high))) => {
                let (low, high) = (low - settings.headroom_m, high + settings.headroom_m);
                // Flat ground without headroom would have no height at all between its bounds.
                low..=high.max(low + 1.0)
            }
            (None, None) => {
                return Err(BakeError::AllNoData {
                    name: source.name(),
                });
            }
        };
        let fill = fill::Fill::build(source, &survey, progress)?;
        let quantiser = Quantiser::new(&range, source.codes());
        let manifest = ManifestFile {
            format: MANIFEST_MAGIC.to_owned(),
            version: MANIFEST_VERSION,
            size,
            spacing_m,
            height_min_m: quantiser.low_m(),
            height_step_m: quantiser.step_m(),
            levels: ManifestFile::levels_for(size),
            density: settings.density.clone(),
            index_crc32: 0,
        };
        manifest
            .validate()
            .map_err(|reason| BakeError::Manifest { reason })?;
        Ok(Self {
            survey,
            fill,
            range,
            quantiser,
            manifest,
        })
    }

    /// A report of what is known before the first tile.
    fn report(&self) -> BakeReport {
        BakeReport {
            size: self.manifest.size,
            levels: self.manifest.levels,
            tiles: 0,
            bytes: 0,
            spacing_m: self.manifest.spacing_m,
            height_range_m: self.range.clone(),
            height_step_m: self.manifest.height_step_m,
            source_range_m: self.survey.heights_m,
            clamped: 0,
            filled: self.survey.no_data,
            fill_block: self.fill.block(),
            elapsed: Duration::ZERO,
        }
    }
}

/// What is said of a band that has gone through the pyramid.
struct BandDone {
    first_row: u32,
    /// Samples that were clamped.
    clamped: u64,
}

/// Pushes rows of the source through the pyramid, reading the next band while one is worked on.
/// After each band, `done` hears of it.
fn stream<E: From<BakeError> + Send>(
    source: &mut dyn HeightSource,
    plan: &Plan,
    bands: Bands,
    pyramid: &mut Pyramid,
    progress: &dyn BakeProgress,
    done: &mut (dyn FnMut(&Pyramid, BandDone) -> Result<(), E> + Send),
) -> Result<(), E> {
    let width = u64::from(source.size()[0]);
    let rows = u64::from(bands.rows.end - bands.rows.start);
    let mut reader = BandReader::new(source, &plan.fill, &plan.quantiser, bands)?;
    progress.stage(BakeStage::Bake, width * rows);
    let mut next = reader.read()?;
    while let Some(band) = next {
        let samples = band.samples();
        let (read, worked) = rayon::join(
            || reader.read(),
            || -> Result<BandDone, BakeError> {
                let converted = plan.quantiser.convert(&band);
                let done = BandDone {
                    first_row: band.first_row,
                    clamped: converted.clamped,
                };
                pyramid.push(converted)?;
                Ok(done)
            },
        );
        done(pyramid, worked?)?;
        next = read?;
        progress.advance(samples);
    }
    Ok(())
}
