//! From tiles to pixels.

use super::{MARK, PreviewError, PreviewKind, PreviewSettings};
use crate::terrain::{ManifestFile, TerrainManifest};
use crate::tile::{
    DENSITY_CELL, DENSITY_TEXELS, DensityTile, HeightTile, TILE_SAMPLES, TileAddress,
    TileFormatError, of_terrain, tile_path,
};
use png::{BitDepth, ColorType, Compression, Encoder, SrgbRenderingIntent};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

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
/// More bytes than a tile's file has: what is longer is something else.
const LONGEST_FILE: u64 = 1 << 17;

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

pub(super) struct Drawing<'a> {
    dir: &'a Path,
    terrain: &'a TerrainManifest,
    kind: PreviewKind,
    pub(super) level: u8,
    /// Samples of a pixel, a side.
    pub(super) factor: u32,
    /// Of one picture.
    size: [u32; 2],
    pub(super) exaggeration: f64,
    /// Towards the sun: x, y, z.
    sun: [f64; 3],
    /// Lowest and highest stored height.
    range: [f64; 2],
    pub(super) coarser_tiles: u64,
    pub(super) warnings: Vec<String>,
    /// Tiles that a warning was given for already.
    warned: BTreeSet<TileAddress>,
}

impl<'a> Drawing<'a> {
    pub(super) fn new(
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

    pub(super) fn size_px(&self) -> [u32; 2] {
        [self.size[0] * self.kind.panels().len() as u32, self.size[1]]
    }

    /// Metres between samples of the level.
    pub(super) fn spacing_m(&self) -> f64 {
        self.terrain.file.spacing_m * f64::from(self.level).exp2()
    }

    pub(super) fn write(&mut self, out: &mut impl Write) -> io::Result<()> {
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
        let stamp = self.terrain.file.stamp();
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
                let (contents, faults) = read_tile(self.dir, self.kind, stamp, source);
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

/// Reads what the kind of preview needs of a tile; what is wrong with it in sentences.
fn read_tile(
    dir: &Path,
    kind: PreviewKind,
    stamp: u32,
    tile: TileAddress,
) -> (Contents, Vec<String>) {
    let path = tile_path(tile);
    let mut faults = Vec::new();
    let mut faulty =
        |reason: String| faults.push(format!("{path} can't be {reason}; it is magenta"));
    let mut contents = Contents::default();
    let mut bytes = Vec::new();
    let read = File::open(dir.join(&path))
        .and_then(|file| file.take(LONGEST_FILE).read_to_end(&mut bytes));
    if let Err(reason) = read {
        faulty(format!("read: {reason}"));
        return (contents, faults);
    }
    let mut damaged = |reason: TileFormatError| faulty(format!("used: {reason}"));
    if kind != PreviewKind::Density {
        let heights =
            HeightTile::decode_stamped(&bytes, tile).and_then(|heights| of_terrain(heights, stamp));
        contents.heights = heights.map_err(&mut damaged).ok();
    }
    if kind != PreviewKind::Relief {
        let densities = DensityTile::decode_stamped(&bytes, tile)
            .and_then(|densities| of_terrain(densities, stamp));
        contents.densities = densities.map_err(&mut damaged).ok();
    }
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
