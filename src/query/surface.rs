//! The ground as the resident tiles have it: its height and how it falls.

use super::BlockRanges;
use crate::terrain::ManifestFile;
use crate::tile::{HeightTile, TILE_SAMPLES, TileAddress, TileRange};
use glam::{DVec2, DVec3, UVec2};

/// The ground at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TerrainHeight {
    /// Metres above the terrain's origin.
    pub height_m: f64,
    /// The level that the answer comes from: the finest that is resident there, 0 for the samples
    /// themselves.
    pub level: u8,
}

/// The ground at a place, and how it falls there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundSample {
    /// Metres above the terrain's origin.
    pub height_m: f64,
    /// Metres that the ground rises a metre along x and along z: the exact derivatives of the
    /// bilinear surface. Where two of its patches meet, those of the one with the greater x, or z.
    pub gradient: DVec2,
    /// The level that the answer comes from, as in [`TerrainHeight::level`].
    pub level: u8,
}

impl GroundSample {
    /// The unit vector that stands upright on the ground, in the terrain's own space; its y is above
    /// 0.
    #[must_use]
    pub fn normal(&self) -> DVec3 {
        DVec3::new(-self.gradient.x, 1.0, -self.gradient.y).normalize()
    }

    /// The angle between the ground and the level, in radians: 0 on a plain, below π/2 on cliffs.
    #[must_use]
    pub fn slope(&self) -> f64 {
        self.gradient.length().atan()
    }
}

/// Where the ground is read from: tiles, as far as they are resident.
///
/// The ground at a place is that of the finest resident tile there, bilinear between its samples.
/// [`TerrainState`](crate::stream::TerrainState) is one; others need no engine.
pub trait GroundSource {
    /// The terrain's size and scale.
    fn file(&self) -> &ManifestFile;

    /// A tile's heights; `None` where it isn't resident. Where a tile is, so must its parent be.
    fn heights(&self, address: TileAddress) -> Option<&HeightTile>;

    /// Whether a tile is resident.
    fn is_resident(&self, address: TileAddress) -> bool {
        self.heights(address).is_some()
    }

    /// Between which stored heights the ground of a tile lies, and that of all resident tiles below
    /// it. `None` where that isn't known: rays then look at what is below.
    fn range(&self, address: TileAddress) -> Option<TileRange>;

    /// The ranges of a resident tile's blocks, where they are known. They must be those of
    /// [`heights`](Self::heights) as they are now. Without them, rays look at every cell on their
    /// way through the tile.
    fn blocks(&self, address: TileAddress) -> Option<&BlockRanges> {
        let _ = address;
        None
    }
}

/// Reads the ground of a [`GroundSource`] at one place after the other. Places in the same tile cost
/// one look-up together.
///
/// Cost: some 25 ns where the tile is in the processor's caches, and the wait for memory where it
/// isn't.
pub struct GroundReader<'a, S: ?Sized> {
    source: &'a S,
    file: &'a ManifestFile,
    held: Option<Held<'a>>,
}

/// A tile, and the square in which it is the finest resident one, in samples of level 0.
#[derive(Clone, Copy)]
struct Held<'a> {
    heights: &'a HeightTile,
    address: TileAddress,
    low: DVec2,
    high: DVec2,
}

impl<'a, S: GroundSource + ?Sized> GroundReader<'a, S> {
    /// Asks the ground that `source` holds. Costs nothing; tiles are looked up with each question.
    #[must_use]
    pub fn new(source: &'a S) -> Self {
        Self {
            source,
            file: source.file(),
            held: None,
        }
    }

    /// The height at `at_m`, in metres of the terrain's own x and z. `None` outside, and while
    /// nothing is resident. Not a number is outside.
    pub fn height(&mut self, at_m: DVec2) -> Option<TerrainHeight> {
        let (held, patch, part) = self.patch(at_m)?;
        Some(TerrainHeight {
            height_m: self.file.height_min_m + patch.height(part) * self.file.height_step_m,
            level: held.address.level,
        })
    }

    /// The height and the gradient at `at_m`, in metres of the terrain's own x and z. `None` outside,
    /// and while nothing is resident. Not a number is outside.
    pub fn sample(&mut self, at_m: DVec2) -> Option<GroundSample> {
        let (held, patch, part) = self.patch(at_m)?;
        let level = held.address.level;
        let spacing_m = self.file.spacing_m * f64::from(1_u32 << level);
        Some(GroundSample {
            height_m: self.file.height_min_m + patch.height(part) * self.file.height_step_m,
            gradient: patch.gradient(part) * (self.file.height_step_m / spacing_m),
            level,
        })
    }

    /// The patch at a place, and where in it that is.
    fn patch(&mut self, at_m: DVec2) -> Option<(Held<'a>, Patch, DVec2)> {
        let sample = at_m / self.file.spacing_m;
        let held = match self.held {
            Some(held) if sample.cmpge(held.low).all() && sample.cmplt(held.high).all() => held,
            _ => self.hold(sample)?,
        };
        let (first_x, first_z) = held.address.first_sample();
        let at = sample / f64::from(1_u32 << held.address.level)
            - DVec2::new(first_x.into(), first_z.into());
        let cell = at
            .floor()
            .clamp(DVec2::ZERO, DVec2::splat(f64::from(TILE_SAMPLES - 1)));
        let patch = Patch::new(held.heights, cell.x as u32, cell.y as u32);
        Some((held, patch, at - cell))
    }

    /// Finds the finest resident tile at a place, in samples of level 0.
    fn hold(&mut self, sample: DVec2) -> Option<Held<'a>> {
        let last = DVec2::from(self.file.size.map(|samples| f64::from(samples) - 1.0));
        // Not a number is nowhere.
        if !(sample.cmpge(DVec2::ZERO).all() && sample.cmple(last).all()) {
            return None;
        }
        // The last sample belongs to the last tile.
        let tiles = UVec2::from(self.file.tiles(0));
        let leaf = (sample.as_uvec2() / TILE_SAMPLES).min(tiles - 1);
        let (address, heights) = (0..self.file.levels).find_map(|level| {
            let address = TileAddress::new(level, leaf.x >> level, leaf.y >> level);
            Some((address, self.source.heights(address)?))
        })?;
        // Some of the tile's quarters may have finer tiles; this one has none.
        let level = u32::from(address.level.saturating_sub(1));
        let size = f64::from(TILE_SAMPLES) * f64::from(1_u32 << level);
        let low = (leaf >> level).as_dvec2() * size;
        let held = Held {
            heights,
            address,
            low,
            // Beyond the last sample there is nothing, however far the tile reaches.
            high: (low + size).min(last),
        };
        self.held = Some(held);
        Some(held)
    }
}

/// The bilinear ground of one cell, in stored units: `at + x·u + z·v + twist·u·v`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    at: f64,
    x: f64,
    z: f64,
    twist: f64,
}

impl Patch {
    /// That of the cell in column `x` and row `z` of a tile, 0 to 127.
    pub(super) fn new(heights: &HeightTile, x: u32, z: u32) -> Self {
        Self::through(corners(heights, x, z))
    }

    /// That through four samples, row by row.
    pub(super) fn through(corners: [u16; 4]) -> Self {
        let [at, x, z, both] = corners.map(f64::from);
        Self {
            at,
            x: x - at,
            z: z - at,
            twist: at - x - z + both,
        }
    }

    pub(super) fn height(&self, part: DVec2) -> f64 {
        self.at + self.x * part.x + (self.z + self.twist * part.x) * part.y
    }

    fn gradient(&self, part: DVec2) -> DVec2 {
        DVec2::new(self.x + self.twist * part.y, self.z + self.twist * part.x)
    }

    /// How high a line is above the ground, `c + b s + a s²`, as `[c, b, a]`: it starts at `part` and
    /// `height` and goes on by `step` and `rise` a unit of `s`.
    pub(super) fn clearance(&self, part: DVec2, height: f64, step: DVec2, rise: f64) -> [f64; 3] {
        let gradient = self.gradient(part);
        [
            height - self.height(part),
            rise - gradient.dot(step),
            -self.twist * step.x * step.y,
        ]
    }
}

/// The four samples around the cell in column `x` and row `z`, row by row.
pub(super) fn corners(heights: &HeightTile, x: u32, z: u32) -> [u16; 4] {
    use crate::tile::{TILE_BORDER, TILE_STORED};
    let near = ((z + TILE_BORDER) * TILE_STORED + x + TILE_BORDER) as usize;
    let far = near + TILE_STORED as usize;
    let samples = heights.samples();
    [
        samples[near],
        samples[near + 1],
        samples[far],
        samples[far + 1],
    ]
}
