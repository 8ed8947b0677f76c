//! A terrain's run-time state as a source of ground.

use super::{
    BlockRanges, GroundHit, GroundRay, GroundReader, GroundSample, GroundSource, TerrainHeight,
};
use crate::stream::TerrainState;
use crate::terrain::ManifestFile;
use crate::tile::{HeightTile, TileAddress, TileRange};
use bevy::math::DVec2;

impl GroundSource for TerrainState {
    fn file(&self) -> &ManifestFile {
        &self.manifest().file
    }

    fn heights(&self, address: TileAddress) -> Option<&HeightTile> {
        self.tile_data(address).map(|tile| &tile.heights)
    }

    fn is_resident(&self, address: TileAddress) -> bool {
        self.pages().get(address).is_some()
    }

    fn range(&self, address: TileAddress) -> Option<TileRange> {
        self.ground_range(address)
    }

    fn blocks(&self, address: TileAddress) -> Option<&BlockRanges> {
        self.ground_blocks(address)
    }
}

impl TerrainState {
    /// The ground at `at_m`, in metres of the terrain's own x and z: bilinear between the samples of
    /// the finest level that is resident there. `None` outside, and while nothing is resident.
    #[must_use]
    pub fn height(&self, at_m: DVec2) -> Option<TerrainHeight> {
        GroundReader::new(self).height(at_m)
    }

    /// The same with how the ground falls there.
    #[must_use]
    pub fn ground(&self, at_m: DVec2) -> Option<GroundSample> {
        GroundReader::new(self).sample(at_m)
    }

    /// Where a ray in the terrain's own space first meets the ground, from either side: see
    /// [`GroundRay::cast`].
    #[must_use]
    pub fn ray(&self, ray: &GroundRay) -> Option<GroundHit> {
        ray.cast(self)
    }
}
