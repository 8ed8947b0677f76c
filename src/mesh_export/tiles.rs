//! A terrain's tiles on disk, read when they are asked for.

use crate::lattice::{Lattice, NodeBounds, ResidencyField};
use crate::terrain::{TerrainManifest, tile_bounds};
use crate::tessellate::PageSource;
use crate::tile::{TerrainTile, TileAddress, TileIndex};
use glam::{IVec2, UVec2};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};

/// Tiles of a terrain's folder, each read once, when something of it is wanted for the first time.
///
/// What has been read stays in memory, 37 KB a tile: a view wants the tiles that lie within the
/// reach of their level, whose number doesn't grow with the terrain's area. 16 bytes are held for
/// every tile that there could be.
pub(super) struct StoredTiles<'a> {
    dir: &'a Path,
    manifest: &'a TerrainManifest,
    columns: Vec<u32>,
    levels: Vec<Vec<OnceLock<Option<Box<TerrainTile>>>>>,
    faults: Mutex<Vec<TileFault>>,
}

/// A tile that can't be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct TileFault {
    pub address: TileAddress,
    pub path: PathBuf,
    pub reason: String,
}

impl<'a> StoredTiles<'a> {
    pub fn new(dir: &'a Path, manifest: &'a TerrainManifest) -> Self {
        let sizes: Vec<[u32; 2]> = manifest
            .index
            .levels()
            .iter()
            .map(|level| level.tiles())
            .collect();
        Self {
            dir,
            manifest,
            columns: sizes.iter().map(|size| size[0]).collect(),
            levels: sizes
                .iter()
                .map(|size| {
                    let tiles = size[0] as usize * size[1] as usize;
                    (0..tiles).map(|_| OnceLock::new()).collect()
                })
                .collect(),
            faults: Mutex::default(),
        }
    }

    /// What couldn't be read since the last call, by tile.
    pub fn take_faults(&self) -> Vec<TileFault> {
        let mut held = self
            .faults
            .lock()
            .unwrap_or_else(|error| error.into_inner());
        let mut faults = std::mem::take(&mut *held);
        faults.sort_by_key(|fault| fault.address);
        faults
    }

    /// How many tiles have been read.
    pub fn read_count(&self) -> u64 {
        let slots = self.levels.iter().flatten();
        slots
            .filter(|slot| matches!(slot.get(), Some(Some(_))))
            .count() as u64
    }

    /// `None` where there is no such tile; the inner one where it can't be read.
    fn tile(&self, address: TileAddress) -> Option<Option<&TerrainTile>> {
        let level = usize::from(address.level);
        let columns = *self.columns.get(level)?;
        if address.x >= columns {
            return None;
        }
        let at = address.z as usize * columns as usize + address.x as usize;
        let slot = self.levels[level].get(at)?;
        Some(slot.get_or_init(|| self.read(address)).as_deref())
    }

    fn read(&self, address: TileAddress) -> Option<Box<TerrainTile>> {
        let path = self.dir.join(TerrainTile::path(address));
        let read = std::fs::read(&path)
            .map_err(|error| format!("can't be read: {error}"))
            .and_then(|bytes| {
                TerrainTile::decode(&bytes, address)
                    .and_then(|tile| tile.check(self.manifest, address).map(|()| tile))
                    .map_err(|error| format!("can't be used: {error}"))
            });
        match read {
            Ok(tile) => Some(Box::new(tile)),
            Err(reason) => {
                let mut faults = self
                    .faults
                    .lock()
                    .unwrap_or_else(|error| error.into_inner());
                faults.push(TileFault {
                    address,
                    path,
                    reason,
                });
                None
            }
        }
    }
}

/// A tile that can't be read gives what is as good as anything: whoever asks looks at the faults
/// afterwards, and doesn't use what was made of it.
impl PageSource for StoredTiles<'_> {
    fn height(&self, tile: TileAddress, x: i32, z: i32) -> Option<u16> {
        let tile = self.tile(tile)?;
        Some(tile.map_or(0, |tile| tile.heights.get(x, z)))
    }

    fn errors(&self, tile: TileAddress, x: i32, z: i32) -> Option<[u8; 8]> {
        let tile = self.tile(tile)?;
        let at = |tile: &TerrainTile| tile.errors.get(x.cast_unsigned(), z.cast_unsigned());
        Some(tile.map_or([0; 8], at))
    }

    fn density(&self, tile: TileAddress, x: i32, z: i32) -> Option<u8> {
        let tile = self.tile(tile)?;
        Some(tile.map_or(u8::MAX, |tile| tile.densities.get(x, z)))
    }
}

/// The residency field of a terrain of which every tile in `index` is resident whose ancestors are
/// there too; `None` where the root isn't.
pub(super) fn field_of(lattice: &Lattice, index: &TileIndex) -> Option<ResidencyField> {
    let root = TileAddress::new(lattice.root_level.unsigned_abs() as u8, 0, 0);
    index.get(root)?;
    let mut field = ResidencyField::new(lattice, 0);
    let mut cells = vec![0_u8; field.cells.x as usize * field.cells.y as usize];
    mark(lattice, index, root, &field, &mut cells);
    // Each corner holds the coarsest of its four cells' levels.
    for z in 0..=field.cells.y {
        for x in 0..=field.cells.x {
            let corner = UVec2::new(x, z);
            let low = corner.saturating_sub(UVec2::ONE);
            let high = corner.min(field.cells - 1);
            let around = (low.y..=high.y).flat_map(|z| (low.x..=high.x).map(move |x| (x, z)));
            let level = around
                .map(|(x, z)| cells[(z * field.cells.x + x) as usize])
                .max();
            let at = field.corner_index(corner);
            field.corners[at] = u16::from(level.unwrap_or(0)) << 8;
        }
    }
    Some(field)
}

/// Raises the cells below `tile`, which is stored, to the finest levels that are.
fn mark(
    lattice: &Lattice,
    index: &TileIndex,
    tile: TileAddress,
    field: &ResidencyField,
    cells: &mut [u8],
) {
    for child in tile.children().into_iter().flatten() {
        let Some(NodeBounds { low, high }) = tile_bounds(lattice, child) else {
            continue;
        };
        if index.get(child).is_some() {
            mark(lattice, index, child, field, cells);
            continue;
        }
        let log2 = IVec2::splat(field.cell_log2.cast_signed());
        let (first, last) = ((low >> log2).as_uvec2(), ((high - 1) >> log2).as_uvec2());
        for z in first.y..=last.y {
            for x in first.x..=last.x {
                let cell = &mut cells[(z * field.cells.x + x) as usize];
                *cell = (*cell).max(tile.level);
            }
        }
    }
}
