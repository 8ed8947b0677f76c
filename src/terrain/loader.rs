//! Asset loader of manifests.

use super::{INDEX_FILE, ManifestError, TerrainManifest};
use bevy::asset::{AssetLoader, AssetPath, LoadContext, ReadAssetBytesError, io::Reader};
use bevy::reflect::TypePath;
use thiserror::Error;

/// Why a terrain's manifest was refused. Each message names the file and the reason.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ManifestLoadError {
    /// The manifest could not be read to its end.
    #[error("{path} can't be read: {reason}")]
    Read {
        /// The asset's path.
        path: String,
        /// What the asset source says.
        reason: std::io::Error,
    },
    /// The manifest is not text.
    #[error("{path} is not a terrain's manifest: it is not text; bake the terrain again")]
    Text {
        /// The asset's path.
        path: String,
    },
    /// The tile index beside the manifest could not be read.
    #[error("{path} needs {INDEX_FILE} beside it, which can't be read: {reason}")]
    Index {
        /// The manifest's asset path.
        path: String,
        /// What the asset source says.
        reason: Box<ReadAssetBytesError>,
    },
    /// Manifest or index are no terrain's, or of two different ones.
    #[error("{path} can't be used: {reason}")]
    Manifest {
        /// The manifest's asset path.
        path: String,
        /// What is wrong with it.
        reason: ManifestError,
    },
}

/// Loads [`TerrainManifest`]s: `terrain.ron` together with the `tiles.index` beside it.
///
/// A manifest of any name can be loaded where the type is known:
/// `asset_server.load::<TerrainManifest>("alps/terrain.ron")`.
#[derive(Clone, Copy, Debug, Default, TypePath)]
pub struct TerrainManifestLoader;

const EXTENSIONS: &[&str] = &["terrain.ron"];

impl AssetLoader for TerrainManifestLoader {
    type Asset = TerrainManifest;
    type Settings = ();
    type Error = ManifestLoadError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        _settings: &(),
        load_context: &mut LoadContext<'_>,
    ) -> Result<TerrainManifest, ManifestLoadError> {
        let manifest_path = load_context.path().clone();
        let path = || manifest_path.to_string();
        let mut text = Vec::new();
        reader
            .read_to_end(&mut text)
            .await
            .map_err(|reason| ManifestLoadError::Read {
                path: path(),
                reason,
            })?;
        let text = String::from_utf8(text).map_err(|_| ManifestLoadError::Text { path: path() })?;
        let index_path = AssetPath::from(manifest_path.path().with_file_name(INDEX_FILE))
            .with_source(manifest_path.source().clone());
        let index = load_context
            .read_asset_bytes(index_path)
            .await
            .map_err(|reason| ManifestLoadError::Index {
                path: path(),
                reason: Box::new(reason),
            })?;
        TerrainManifest::decode(&text, &index).map_err(|reason| ManifestLoadError::Manifest {
            path: path(),
            reason,
        })
    }

    fn extensions(&self) -> &[&str] {
        EXTENSIONS
    }
}
