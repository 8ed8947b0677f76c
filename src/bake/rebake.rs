//! Making a terrain's densities anew, from the heights that are stored.

use super::pyramid::{Rows, density_window, spread_rows};
use super::writer::{self, PartialTerrain};
use super::{BakeError, BakeProgress, BakeStage};
use crate::density::{
    DensityExtent, DensityKernel, DensityScratch, DensitySettings, coarser_row, tile_densities,
};
use crate::terrain::{ManifestFile, TerrainManifest};
use crate::tile::{
    DENSITY_BORDER, DENSITY_TEXELS, DensityTile, ErrorTile, HeightTile, TILE_SAMPLES, TileAddress,
    TileFormatError, TileIndex, of_terrain, tile_path,
};
use rayon::prelude::*;
use std::path::Path;
use std::time::{Duration, Instant};

const TEXELS: usize = DENSITY_TEXELS as usize;
type Block = [u8; TEXELS * TEXELS];

/// What a rebake made.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct DensityReport {
    /// Tiles whose densities were made.
    pub tiles: u64,
    /// Bytes of tiles written.
    pub bytes: u64,
    /// Samples that curvature was taken of.
    pub samples: u64,
    /// Mean density of the finest tiles, 0..=1.
    pub mean: f64,
    /// How long it took.
    pub elapsed: Duration,
}

/// Makes the densities of the terrain in the folder `dir` anew, as `settings` say. Its heights
/// and error bounds stay as they are, and the result is what a bake of the same heights with these settings would have
/// made, byte for byte.
///
/// The new terrain is put together beside the old one, which it replaces at the end: who is
/// stopped leaves the old one. Whatever else lies in the folder is linked, not copied, where the
/// file system can. Memory grows with the terrain's width, by some hundred bytes a column.
///
/// Texels of tiles that lack a finer tile come from their own heights, which is what the thesis's
/// normalisation is for (see [`density`](crate::density)).
///
/// # Errors
/// For settings outside their ranges, a folder that is no terrain, a tile that can't be read, where
/// another terrain was put in the folder meanwhile, and where the result can't be written. The
/// terrain is then as it was before.
pub fn rebake_densities(
    dir: &Path,
    settings: &DensitySettings,
    progress: &dyn BakeProgress,
) -> Result<DensityReport, BakeError> {
    let start = Instant::now();
    settings.validate()?;
    // The folder itself and not a link to it, which a rename would replace.
    let folder = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
    writer::put_right(&folder)?;
    let unusable = |reason| BakeError::Terrain {
        path: dir.to_owned(),
        reason: Box::new(reason),
    };
    let before = writer::Identity::of(&folder);
    let TerrainManifest { mut file, index } = TerrainManifest::read(&folder).map_err(unusable)?;
    let before = before?;
    file.density = settings.clone();
    let partial = PartialTerrain::create(&folder, &file)?;
    let stored = index.iter().count() as u64;
    progress.stage(BakeStage::Density, stored);
    let mut report = DensityReport {
        tiles: 0,
        bytes: 0,
        samples: 0,
        mean: 0.0,
        elapsed: Duration::ZERO,
    };
    for level in 0..file.levels {
        Rebake {
            source: &folder,
            partial: partial.dir(),
            file: &file,
            index: &index,
            stamp: file.stamp(),
            level,
            extent: DensityExtent::new(file.size, level),
            kernel: DensityKernel::new(settings, file.height_step_m, file.spacing_m, level),
            progress,
        }
        .run(&mut report)?;
    }
    progress.stage(BakeStage::Finish, 0);
    partial.write_index(&mut file, &index)?;
    partial.carry_over(&|_| false)?;
    if writer::Identity::of(&folder).ok().as_ref() != Some(&before) {
        return Err(BakeError::Replaced {
            path: dir.to_owned(),
        });
    }
    partial.publish(true)?;
    report.elapsed = start.elapsed();
    Ok(report)
}

/// One level of a rebake.
struct Rebake<'a> {
    source: &'a Path,
    partial: &'a Path,
    file: &'a ManifestFile,
    index: &'a TileIndex,
    stamp: u32,
    level: u8,
    extent: DensityExtent,
    kernel: DensityKernel,
    progress: &'a dyn BakeProgress,
}

impl Rebake<'_> {
    fn run(&self, report: &mut DensityReport) -> Result<(), BakeError> {
        let settings = &self.file.density;
        let tiles = self.file.tiles(self.level);
        let texels = self.extent.texels;
        // Densities from heights before and after they spread, from finer densities, and both
        // together.
        let (mut own, mut spread) = (Rows::new(), Rows::new());
        let (mut finer, mut done) = (Rows::new(), Rows::new());
        let (mut sum, mut count) = (0, 0);
        let mut written = 0;
        for z in 0..tiles[1] {
            let blocks: Vec<(Block, Block, u64)> = (0..tiles[0])
                .into_par_iter()
                .map_init(DensityScratch::default, |scratch, x| {
                    self.blocks(TileAddress::new(self.level, x, z), scratch)
                })
                .collect::<Result<_, _>>()?;
            report.samples += blocks.iter().map(|block| block.2).sum::<u64>();
            let rows = DENSITY_TEXELS.min(texels[1] - DENSITY_TEXELS * z) as usize;
            let strip = |block: fn(&(Block, Block, u64)) -> &Block| {
                let blocks = &blocks;
                (0..rows).map(move |row| {
                    let mut out: Vec<u8> = blocks
                        .iter()
                        .flat_map(|both| block(both)[TEXELS * row..][..TEXELS].iter().copied())
                        .collect();
                    out.truncate(texels[0] as usize);
                    out
                })
            };
            own.extend(strip(|both| &both.0));
            finer.extend(strip(|both| &both.1));

            spread_rows(settings, texels[1], &mut own, &mut spread);
            let rows: Vec<Vec<u8>> = (done.end()..spread.end())
                .into_par_iter()
                .map(|z| {
                    let both = spread.row(z).iter().zip(finer.row(z));
                    both.map(|(&a, &b)| a.max(b)).collect()
                })
                .collect();
            done.extend(rows);
            spread.drop_before(done.end());
            finer.drop_before(done.end());

            let needed = |z: u32| (DENSITY_TEXELS * (z + 1) + DENSITY_BORDER).min(texels[1] - 1);
            while written < tiles[1] && done.end() > needed(written) {
                let row = self.write_row(written, texels, &done)?;
                report.tiles += row.tiles;
                report.bytes += row.bytes;
                sum += row.sum;
                count += row.texels;
                written += 1;
            }
            let keep = (DENSITY_TEXELS * written).saturating_sub(DENSITY_BORDER);
            done.drop_before(keep.min(texels[1] - 1));
        }
        if self.level == 0 {
            report.mean = sum as f64 / (255.0 * (count as f64).max(1.0));
        }
        Ok(())
    }

    /// A tile's own texels from its heights, those from its children, and the number of samples
    /// that were looked at. What the one has is 0 in the other.
    fn blocks(
        &self,
        address: TileAddress,
        scratch: &mut DensityScratch,
    ) -> Result<(Block, Block, u64), BakeError> {
        let (mut own, mut finer) = ([0; TEXELS * TEXELS], [0; TEXELS * TEXELS]);
        if self.index.get(address).is_none() {
            return Ok((own, finer, 0));
        }
        let children = address.children().into_iter().flatten().filter(|child| {
            let tiles = self.file.tiles(child.level);
            child.x < tiles[0] && child.z < tiles[1]
        });
        let (mut missing, mut any) = (self.level == 0, false);
        // Two by two children, side by side.
        let mut below = vec![0; 4 * TEXELS * TEXELS];
        let mut covered = [false; 4];
        for child in children {
            if self.index.get(child).is_none() {
                missing = true;
                continue;
            }
            any = true;
            let quadrant = ((child.x & 1) + 2 * (child.z & 1)) as usize;
            covered[quadrant] = true;
            let densities: DensityTile = read(self.partial, &tile_path(child), |bytes| {
                of_terrain(DensityTile::decode_stamped(bytes, child)?, self.stamp)
            })?;
            let (x, z) = (
                (child.x & 1) as usize * TEXELS,
                (child.z & 1) as usize * TEXELS,
            );
            for row in 0..TEXELS {
                for column in 0..TEXELS {
                    below[2 * TEXELS * (z + row) + x + column] =
                        densities.get(column as i32, row as i32);
                }
            }
        }
        if any {
            for (row, pair) in below.chunks_exact(4 * TEXELS).enumerate() {
                let (above, below) = pair.split_at(2 * TEXELS);
                let z = DENSITY_TEXELS * address.z + row as u32;
                let made = coarser_row(&self.file.density, z, above, below);
                finer[TEXELS * row..][..TEXELS].copy_from_slice(&made);
            }
        }
        if !missing {
            return Ok((own, finer, 0));
        }
        let heights = self.heights(address)?;
        let first = address.first_sample();
        let first = [first.0, first.1];
        tile_densities(
            &self.kernel,
            &self.extent,
            first,
            heights.samples(),
            scratch,
            &mut own,
        );
        for (at, density) in own.iter_mut().enumerate() {
            let (x, z) = (at % TEXELS, at / TEXELS);
            if covered[2 * x / TEXELS + 2 * (2 * z / TEXELS)] {
                *density = 0;
            }
        }
        let here = |axis: usize| {
            let left = self.extent.samples[axis].saturating_sub(first[axis]);
            u64::from(left.min(TILE_SAMPLES))
        };
        Ok((own, finer, here(0) * here(1)))
    }

    fn heights(&self, address: TileAddress) -> Result<HeightTile, BakeError> {
        let decode =
            |bytes: &[u8]| of_terrain(HeightTile::decode_stamped(bytes, address)?, self.stamp);
        read(self.source, &tile_path(address), decode)
    }

    /// Writes the stored tiles of a row.
    fn write_row(&self, z: u32, texels: [u32; 2], done: &Rows<u8>) -> Result<Written, BakeError> {
        let addresses = (0..self.file.tiles(self.level)[0])
            .map(|x| TileAddress::new(self.level, x, z))
            .filter(|&address| self.index.get(address).is_some());
        let written = addresses
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|address| {
                let densities = density_window(done, texels, address);
                let both = |bytes: &[u8]| {
                    let heights = HeightTile::decode_stamped(bytes, address)?;
                    let errors = ErrorTile::decode_stamped(bytes, address)?;
                    Ok((
                        of_terrain(heights, self.stamp)?,
                        of_terrain(errors, self.stamp)?,
                    ))
                };
                let (heights, errors) = read(self.source, &tile_path(address), both)?;
                let tile = writer::Tile {
                    heights: &heights,
                    densities: Some(&densities),
                    errors: Some(&errors),
                    stamp: self.stamp,
                };
                let bytes = tile.write(self.partial, address)?;
                let own = |at: u32, axis: usize| {
                    (texels[axis] - DENSITY_TEXELS * at).min(DENSITY_TEXELS) as i32
                };
                let (columns, rows) = (own(address.x, 0), own(z, 1));
                let texel = |at: i32| u64::from(densities.get(at % columns, at / columns));
                Ok(Written {
                    tiles: 1,
                    bytes,
                    texels: (columns * rows) as u64,
                    sum: (0..columns * rows).map(texel).sum(),
                })
            })
            .collect::<Result<Vec<_>, BakeError>>()?;
        self.progress.advance(written.len() as u64);
        Ok(written
            .into_iter()
            .fold(Written::default(), |a, b| Written {
                tiles: a.tiles + b.tiles,
                bytes: a.bytes + b.bytes,
                texels: a.texels + b.texels,
                sum: a.sum + b.sum,
            }))
    }
}

/// What was written of a row of tiles.
#[derive(Default)]
struct Written {
    tiles: u64,
    bytes: u64,
    /// Own texels on the terrain, and the sum of their densities.
    texels: u64,
    sum: u64,
}

pub(super) fn read<T>(
    dir: &Path,
    path: &str,
    decode: impl FnOnce(&[u8]) -> Result<T, TileFormatError>,
) -> Result<T, BakeError> {
    let path = dir.join(path);
    let failed = |reason: String| BakeError::Tile {
        path: path.clone(),
        reason,
    };
    let bytes = std::fs::read(&path).map_err(|error| failed(error.to_string()))?;
    decode(&bytes).map_err(|error| failed(error.to_string()))
}
