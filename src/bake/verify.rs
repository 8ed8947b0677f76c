//! Checking a terrain on disk, tile by tile.

use crate::terrain::{ManifestError, TerrainManifest};
use crate::tile::{
    DENSITY_TEXELS, DensityTile, ERROR_SPACINGS, ErrorTile, HeightTile, TILE_SAMPLES, TerrainTile,
    TileAddress, TileFormatError, TileIndex, TileRange, is_packed, of_terrain, tile_path,
};
use rayon::prelude::*;
use std::collections::HashMap;
use std::fmt;
use std::path::Path;

/// What [`verify`] found.
#[derive(Clone, Debug, Default)]
pub struct VerifyReport {
    /// Tiles that were checked, each with both its files.
    pub tiles: u64,
    /// What is wrong, sorted by tile.
    pub faults: Vec<(TileAddress, Fault)>,
}

/// What is wrong with a tile.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// A file is missing or can't be read.
    Unreadable {
        /// The file, below the terrain's folder.
        path: String,
        /// What the system says.
        reason: String,
    },
    /// A file isn't the tile that belongs there.
    Format {
        /// The file, below the terrain's folder.
        path: String,
        /// What is wrong with it.
        reason: TileFormatError,
    },
    /// The tile's heights differ from a neighbour's where both have the same sample.
    HeightBorder {
        /// The neighbour.
        neighbour: TileAddress,
    },
    /// The tile's densities differ from a neighbour's where both have the same texel.
    DensityBorder {
        /// The neighbour.
        neighbour: TileAddress,
    },
    /// An error bound of the tile falls where the spacing grows.
    ErrorOrder {
        /// The texel's column and row.
        texel: [u32; 2],
    },
    /// An error bound of the tile is less than a child's for the same distance.
    ErrorBelowChild {
        /// The child.
        child: TileAddress,
    },
    /// The index has another range than the tile and its children have.
    Range {
        /// What the index says.
        found: TileRange,
        /// What the tile's own heights and its children's ranges come to.
        wanted: TileRange,
    },
    /// The tile is stored and its parent isn't.
    Orphan,
    /// The root is not stored.
    NoRoot,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable { path, reason } => write!(f, "{path} can't be read: {reason}"),
            Self::Format { path, reason } => write!(f, "{path} can't be used: {reason}"),
            Self::HeightBorder { neighbour } => {
                write!(
                    f,
                    "its heights differ from those of its neighbour {neighbour}"
                )
            }
            Self::DensityBorder { neighbour } => write!(
                f,
                "its densities differ from those of its neighbour {neighbour}"
            ),
            Self::ErrorOrder { texel: [x, z] } => write!(
                f,
                "its error bounds in texel ({x}, {z}) fall where the spacing grows"
            ),
            Self::ErrorBelowChild { child } => write!(
                f,
                "its error bounds are less than those of its child {child}"
            ),
            Self::Range { found, wanted } => write!(
                f,
                "the index gives its heights as {}..={} where they reach from {} to {}",
                found.min, found.max, wanted.min, wanted.max
            ),
            Self::Orphan => write!(f, "its parent is not stored"),
            Self::NoRoot => write!(f, "the root is not stored"),
        }
    }
}

/// One tile's contents, as far as they could be read.
#[derive(Default)]
pub(super) struct Contents {
    pub(super) heights: Option<HeightTile>,
    pub(super) densities: Option<DensityTile>,
    pub(super) errors: Option<ErrorTile>,
}

/// Where a terrain's tiles are read from.
trait Tiles: Sync {
    /// The bytes of a tile.
    fn read(&self, address: TileAddress) -> Result<Vec<u8>, String>;
}

/// Tiles in a folder.
impl Tiles for Path {
    fn read(&self, address: TileAddress) -> Result<Vec<u8>, String> {
        std::fs::read(self.join(tile_path(address))).map_err(|error| error.to_string())
    }
}

#[cfg(feature = "archive")]
impl Tiles for crate::archive::TerrainArchive {
    fn read(&self, address: TileAddress) -> Result<Vec<u8>, String> {
        match self.tile(address) {
            Ok(Some(bytes)) => Ok(bytes),
            Ok(None) => Err("it is not there".to_owned()),
            Err(error) => Err(error.to_string()),
        }
    }
}

/// [`verify`] for a terrain in an archive, whose manifest and index are known to be good.
#[cfg(feature = "archive")]
#[must_use]
pub fn verify_archive(
    archive: &crate::archive::TerrainArchive,
    advance: &(dyn Fn(u64) + Sync),
) -> VerifyReport {
    verify_tiles(archive, archive.terrain(), advance)
}

/// Checks every tile of the terrain in the folder `dir`: that its files are there, have the right
/// magic, version, address and checksum, that samples which neighbouring tiles both hold are equal
/// in both bit for bit, that its parent is stored, that its error bounds don't fall with the spacing
/// and are no less than its children's, and that the index gives the range of its heights, its
/// children's included. `advance` hears of every checked tile.
///
/// Holds three rows of tiles in memory, and reads every tile twice, the second time for its parent.
///
/// # Errors
/// Where the manifest or the index can't be used, without which there are no tiles to speak of.
pub fn verify(dir: &Path, advance: &(dyn Fn(u64) + Sync)) -> Result<VerifyReport, ManifestError> {
    let terrain = TerrainManifest::read(dir)?;
    Ok(verify_tiles(dir, &terrain, advance))
}

fn verify_tiles<T: Tiles + ?Sized>(
    tiles: &T,
    terrain: &TerrainManifest,
    advance: &(dyn Fn(u64) + Sync),
) -> VerifyReport {
    let mut report = VerifyReport::default();
    let root = TileAddress::new(terrain.file.levels - 1, 0, 0);
    if terrain.index.get(root).is_none() {
        report.faults.push((root, Fault::NoRoot));
    }
    for level in 0..terrain.file.levels {
        verify_level(tiles, terrain, level, &mut report, advance);
    }
    report.faults.sort_by_key(|(address, _)| *address);
    report
}

fn verify_level<T: Tiles + ?Sized>(
    tiles: &T,
    terrain: &TerrainManifest,
    level: u8,
    report: &mut VerifyReport,
    advance: &(dyn Fn(u64) + Sync),
) {
    let [columns, rows] = terrain.file.tiles(level);
    let mut before: HashMap<TileAddress, Contents> = HashMap::new();
    for z in 0..rows {
        let read: Vec<_> = (0..columns)
            .into_par_iter()
            .map(|x| TileAddress::new(level, x, z))
            .filter(|&address| terrain.index.get(address).is_some())
            .map(|address| {
                let (contents, mut faults) = read_tile(tiles, terrain.file.stamp(), address);
                faults.extend(check_errors(tiles, terrain, address, &contents));
                advance(1);
                (address, contents, faults)
            })
            .collect();
        let mut row = HashMap::new();
        for (address, contents, faults) in read {
            report.tiles += 1;
            let named = |fault| (address, fault);
            report.faults.extend(faults.into_iter().map(named));
            report.faults.extend(
                check_index(terrain, address, &contents)
                    .into_iter()
                    .map(named),
            );
            row.insert(address, contents);
        }
        let seams: Vec<_> = row
            .par_iter()
            .flat_map_iter(|(&address, contents)| {
                // Every pair once: those to the west and to the north.
                [(-1, 0), (-1, -1), (0, -1), (1, -1)]
                    .into_iter()
                    .filter_map(|(x, z): (i32, i32)| {
                        let neighbour = TileAddress::new(
                            level,
                            address.x.checked_add_signed(x)?,
                            address.z.checked_add_signed(z)?,
                        );
                        let other = if z == 0 { &row } else { &before }.get(&neighbour)?;
                        Some(check_seam(address, contents, neighbour, other, [x, z]))
                    })
                    .flatten()
                    .collect::<Vec<_>>()
            })
            .collect();
        report.faults.extend(seams);
        before = row;
    }
}

fn read_tile<T: Tiles + ?Sized>(
    tiles: &T,
    stamp: u32,
    address: TileAddress,
) -> (Contents, Vec<Fault>) {
    let path = tile_path(address);
    let bytes = match tiles.read(address) {
        Ok(bytes) => bytes,
        Err(reason) => {
            return (
                Contents::default(),
                vec![Fault::Unreadable { path, reason }],
            );
        }
    };
    if is_packed(&bytes) {
        let tile = TerrainTile::decode(&bytes, address)
            .and_then(|tile| of_terrain(((), tile.stamp), stamp).map(|()| tile));
        return match tile {
            Ok(tile) => {
                let contents = Contents {
                    heights: Some(tile.heights),
                    densities: Some(tile.densities),
                    errors: Some(tile.errors),
                };
                (contents, Vec::new())
            }
            Err(reason) => (Contents::default(), vec![Fault::Format { path, reason }]),
        };
    }
    let heights =
        HeightTile::decode_stamped(&bytes, address).and_then(|read| of_terrain(read, stamp));
    let densities =
        DensityTile::decode_stamped(&bytes, address).and_then(|read| of_terrain(read, stamp));
    let errors =
        ErrorTile::decode_stamped(&bytes, address).and_then(|read| of_terrain(read, stamp));
    let mut reasons: Vec<TileFormatError> = heights.as_ref().err().cloned().into_iter().collect();
    for reason in [densities.as_ref().err(), errors.as_ref().err()]
        .into_iter()
        .flatten()
    {
        // Where a section is damaged, those behind it may not be found for that.
        let follows = matches!(reason, TileFormatError::Magic { .. }) && !reasons.is_empty();
        if !follows && !reasons.contains(reason) {
            reasons.push(reason.clone());
        }
    }
    let named = |reason| Fault::Format {
        path: path.clone(),
        reason,
    };
    let faults = reasons.into_iter().map(named).collect();
    let contents = Contents {
        heights: heights.ok(),
        densities: densities.ok(),
        errors: errors.ok(),
    };
    (contents, faults)
}

/// Checks a tile's error bounds: in themselves, and against those of its children that can be read.
fn check_errors<T: Tiles + ?Sized>(
    tiles: &T,
    terrain: &TerrainManifest,
    address: TileAddress,
    contents: &Contents,
) -> Vec<Fault> {
    let Some(errors) = &contents.errors else {
        return Vec::new();
    };
    let mut faults = Vec::new();
    let falls = |texel: &[u8; 8]| !texel[..ERROR_SPACINGS].is_sorted();
    if let Some(at) = errors.texels().iter().position(falls) {
        let texel = [at as u32 % DENSITY_TEXELS, at as u32 / DENSITY_TEXELS];
        faults.push(Fault::ErrorOrder { texel });
    }
    let stored = |child: &TileAddress| terrain.index.get(*child).is_some();
    for child in address.children().into_iter().flatten().filter(stored) {
        // What is wrong with the child is said of the child.
        let finer = tiles.read(child).ok().and_then(|bytes| {
            if is_packed(&bytes) {
                let tile = TerrainTile::decode(&bytes, child).ok();
                return tile.map(|tile| tile.errors);
            }
            ErrorTile::decode(&bytes, child).ok()
        });
        if finer.is_some_and(|finer| !covers(errors, child, &finer)) {
            faults.push(Fault::ErrorBelowChild { child });
        }
    }
    faults
}

/// Whether a tile's error bounds are no less than those of its child for the same distances.
fn covers(errors: &ErrorTile, child: TileAddress, finer: &ErrorTile) -> bool {
    let half = DENSITY_TEXELS / 2;
    let (first_x, first_z) = (child.x % 2 * half, child.z % 2 * half);
    (0..DENSITY_TEXELS).all(|z| {
        (0..DENSITY_TEXELS).all(|x| {
            let above = errors.get(first_x + x / 2, first_z + z / 2);
            let below = &finer.get(x, z)[1..ERROR_SPACINGS];
            above.iter().zip(below).all(|(above, below)| above >= below)
        })
    })
}

fn check_index(terrain: &TerrainManifest, address: TileAddress, contents: &Contents) -> Vec<Fault> {
    let TerrainManifest { file, index, .. } = terrain;
    let mut faults = Vec::new();
    if address.level + 1 < file.levels && index.get(address.parent()).is_none() {
        faults.push(Fault::Orphan);
    }
    if let (Some(heights), Some(found)) = (&contents.heights, index.get(address)) {
        let wanted = covering_range(index, address, heights);
        if found != wanted {
            faults.push(Fault::Range { found, wanted });
        }
    }
    faults
}

/// A tile's own range and its stored children's.
fn covering_range(index: &TileIndex, address: TileAddress, heights: &HeightTile) -> TileRange {
    let children = address.children().into_iter().flatten();
    children
        .filter_map(|child| index.get(child))
        .fold(heights.range(), TileRange::union)
}

/// Compares what two neighbouring tiles both hold. `step` leads from the first to the second.
pub(super) fn check_seam(
    address: TileAddress,
    contents: &Contents,
    neighbour: TileAddress,
    other: &Contents,
    step: [i32; 2],
) -> Vec<(TileAddress, Fault)> {
    // Samples of `a` in -low..=high that `b` holds too, and where they lie in `b`.
    let shared = |step: i32, own: i32, low: i32, high: i32| {
        let shift = step * own;
        ((low + shift).max(low)..=(high + shift).min(high)).map(move |at| (at, at - shift))
    };
    let mut faults = Vec::new();
    if let (Some(a), Some(b)) = (&contents.heights, &other.heights) {
        let axis = |step| shared(step, TILE_SAMPLES as i32, -2, 130);
        let equal = axis(step[1]).all(|(z, other_z)| {
            axis(step[0]).all(|(x, other_x)| a.get(x, z) == b.get(other_x, other_z))
        });
        if !equal {
            faults.push((address, Fault::HeightBorder { neighbour }));
        }
    }
    if let (Some(a), Some(b)) = (&contents.densities, &other.densities) {
        let axis = |step| shared(step, 32, -1, 33);
        let equal = axis(step[1]).all(|(z, other_z)| {
            axis(step[0]).all(|(x, other_x)| a.get(x, z) == b.get(other_x, other_z))
        });
        if !equal {
            faults.push((address, Fault::DensityBorder { neighbour }));
        }
    }
    faults
}
