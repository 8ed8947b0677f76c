//! Asset loader of tiles.

use super::{TerrainTile, TileAddress, TileFormatError};
use bevy::asset::{AssetLoader, LoadContext, io::Reader};
use bevy::reflect::TypePath;
use std::path::Path;
use thiserror::Error;

/// Why a tile's file was refused. Each message names the file and the reason.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TileLoadError {
    /// The file could not be read to its end.
    #[error("{path} can't be read: {reason}")]
    Read {
        /// The asset's path.
        path: String,
        /// What the asset source says.
        reason: std::io::Error,
    },
    /// The path doesn't say which tile the file holds.
    #[error("{path} can't be a terrain tile: a tile's path ends in level/x_z.tile")]
    Path {
        /// The asset's path.
        path: String,
    },
    /// The bytes are not the tile that the path promises.
    #[error("{path} can't be used: {reason}")]
    Format {
        /// The asset's path.
        path: String,
        /// What is wrong with the bytes.
        reason: TileFormatError,
    },
}

/// Loads [`TerrainTile`]s from `tile/{level}/{x}_{z}.tile`.
///
/// The path says which tile is wanted; a file that holds another one is refused.
#[derive(Clone, Copy, Debug, Default, TypePath)]
pub struct TerrainTileLoader;

const EXTENSIONS: &[&str] = &["tile"];

impl AssetLoader for TerrainTileLoader {
    type Asset = TerrainTile;
    type Settings = ();
    type Error = TileLoadError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        _settings: &(),
        load_context: &mut LoadContext<'_>,
    ) -> Result<TerrainTile, TileLoadError> {
        let path = || load_context.path().to_string();
        let address = address_of(load_context.path().path())
            .ok_or_else(|| TileLoadError::Path { path: path() })?;
        let mut bytes = Vec::new();
        reader
            .read_to_end(&mut bytes)
            .await
            .map_err(|reason| TileLoadError::Read {
                path: path(),
                reason,
            })?;
        TerrainTile::decode(&bytes, address).map_err(|reason| TileLoadError::Format {
            path: path(),
            reason,
        })
    }

    fn extensions(&self) -> &[&str] {
        EXTENSIONS
    }
}

/// The address that a path `.../{level}/{x}_{z}.{extension}` names.
pub(crate) fn address_of(path: &Path) -> Option<TileAddress> {
    let level = path.parent()?.file_name()?.to_str()?.parse().ok()?;
    let (x, z) = path.file_stem()?.to_str()?.split_once('_')?;
    Some(TileAddress::new(level, x.parse().ok()?, z.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tiles_path_names_its_address() {
        let address = TileAddress::new(3, 17, 4);
        let at = |path: String| address_of(Path::new(&path));
        assert_eq!(at(TerrainTile::path(address)), Some(address));
        let deep = format!("worlds/alps/{}", TerrainTile::path(address));
        assert_eq!(at(deep), Some(address));
        for bad in [
            "1_2.tile",
            "tile/x/1_2.tile",
            "tile/0/12.tile",
            "",
            "tile/999/1_2.tile",
        ] {
            assert_eq!(address_of(Path::new(bad)), None, "{bad}");
        }
    }
}
