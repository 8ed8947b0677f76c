//! Terrains in one file, or behind a web server, as asset sources of a Bevy app.
//!
//! ```no_run
//! # use bevy::prelude::*;
//! # use bevy_tessera::source::TerrainSourcePlugin;
//! # use bevy_tessera::terrain::Terrain;
//! // Before `DefaultPlugins`, which Bevy asks of all asset sources:
//! # let mut app = App::new();
//! app.add_plugins(TerrainSourcePlugin::new("alps", "assets/terrains/alps.pmtiles"));
//!
//! fn setup(mut commands: Commands, assets: Res<AssetServer>) {
//!     commands.spawn(Terrain::new(assets.load("alps://terrain.ron")));
//! }
//! ```

#[cfg(feature = "http")]
use crate::archive::ARCHIVE_EXTENSION;
#[cfg(not(feature = "http"))]
use crate::archive::RangeError;
use crate::archive::{ArchiveError, TerrainArchive};
#[cfg(feature = "http")]
use crate::archive::{HttpClient, HttpFolder, HttpRange, HttpSettings};
use crate::terrain::{INDEX_FILE, MANIFEST_FILE};
use crate::tile::address_of;
use bevy::asset::io::{
    AssetReader, AssetReaderError, AssetSourceBuilder, AssetSourceEvent, AssetWatcher, PathStream,
    Reader, ReaderNotSeekableError, SeekableReader, VecReader, file::FileAssetReader,
};
#[cfg(feature = "http")]
use bevy::log::error;
use bevy::prelude::*;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use std::task::{Context, Poll};
use std::time::Duration;

/// How often an archive's file is looked at where Bevy watches for changes.
const WATCH_EVERY: Duration = Duration::from_millis(500);

/// Makes a terrain's archive, or a terrain's folder or archive behind a web server, an asset source
/// of the app. Add one for each, before `DefaultPlugins` (before Bevy's `AssetPlugin`).
///
/// A location is
/// - a file's name that ends in `.pmtiles`, relative to the folder that Bevy's own `assets` folder
///   lies in, or absolute;
/// - with the feature `http`, a URL (`http://` or `https://`) whose path ends in `.pmtiles`: an
///   archive, read by ranges;
/// - with the feature `http`, any other URL: a terrain's folder, read file by file.
///
/// The manifest is then `NAME://terrain.ron`. Where Bevy watches for changes, an archive's file that
/// has changed is read anew; for what a web server holds, call
/// [`AssetServer::reload`] with the manifest's path.
///
/// Files are read in threads of their own, so that a slow server doesn't hold up other assets.
#[derive(Clone, Debug)]
pub struct TerrainSourcePlugin {
    name: String,
    location: String,
    #[cfg(feature = "http")]
    settings: HttpSettings,
}

impl TerrainSourcePlugin {
    /// What lies at `location` as the source `name`.
    #[must_use]
    pub fn new(name: impl Into<String>, location: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            location: location.into(),
            #[cfg(feature = "http")]
            settings: HttpSettings::default(),
        }
    }

    /// The same with other timeouts and retries.
    #[cfg(feature = "http")]
    #[must_use]
    pub fn with_http(mut self, settings: HttpSettings) -> Self {
        self.settings = settings;
        self
    }

    fn place(&self) -> Place {
        let location = &self.location;
        let is_url = ["http://", "https://"].iter().any(|scheme| {
            let start = location.get(..scheme.len());
            start.is_some_and(|start| start.eq_ignore_ascii_case(scheme))
        });
        if !is_url {
            let path = FileAssetReader::get_base_path().join(location);
            return Place::Archive(Archive::File(path));
        }
        #[cfg(feature = "http")]
        {
            let refused = |error| error!("source {}: {error}; the default is used", self.name);
            let client = HttpClient::new(&self.settings.checked(refused));
            let path = location.split(['?', '#']).next().unwrap_or_default();
            if path.ends_with(&format!(".{ARCHIVE_EXTENSION}")) {
                Place::Archive(Archive::Web(client, location.clone()))
            } else {
                Place::Folder(HttpFolder::new(client, location))
            }
        }
        #[cfg(not(feature = "http"))]
        Place::Archive(Archive::Unreadable(location.clone()))
    }
}

impl Plugin for TerrainSourcePlugin {
    fn build(&self, app: &mut App) {
        let place = self.place();
        let file = match &place {
            Place::Archive(Archive::File(path)) => Some(path.clone()),
            _ => None,
        };
        let store = Arc::new(Store {
            place,
            archive: RwLock::default(),
        });
        let mut builder =
            AssetSourceBuilder::new(move || Box::new(TerrainReader(Arc::clone(&store))));
        if let Some(file) = file {
            builder = builder.with_watcher(move |sender| {
                let watcher = ArchiveWatcher::default();
                let is_over = Arc::clone(&watcher.is_over);
                let file = file.clone();
                let watch = move || {
                    let mut known = version_of(&file);
                    while !is_over.load(Ordering::Relaxed) {
                        std::thread::sleep(WATCH_EVERY);
                        let now = version_of(&file);
                        // A file that is gone is about to be replaced.
                        if now != known && now.is_some() {
                            known = now;
                            let changed = PathBuf::from(MANIFEST_FILE);
                            let told = AssetSourceEvent::ModifiedAsset(changed);
                            if sender.try_send(told).is_err() {
                                return;
                            }
                        }
                    }
                };
                let thread = std::thread::Builder::new().name("terrain archive watcher".to_owned());
                thread.spawn(watch).ok()?;
                Some(Box::new(watcher))
            });
        }
        app.register_asset_source(self.name.clone(), builder);
    }

    fn name(&self) -> &str {
        // One for each source.
        &self.name
    }
}

/// What tells one state of a file from another.
fn version_of(file: &Path) -> Option<(u64, std::time::SystemTime)> {
    let metadata = std::fs::metadata(file).ok()?;
    Some((metadata.len(), metadata.modified().ok()?))
}

/// Ends the watching when it is dropped.
#[derive(Default)]
struct ArchiveWatcher {
    is_over: Arc<AtomicBool>,
}

impl AssetWatcher for ArchiveWatcher {}

impl Drop for ArchiveWatcher {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
    }
}

/// Where a terrain lies.
enum Place {
    Archive(Archive),
    #[cfg(feature = "http")]
    Folder(HttpFolder),
}

impl Place {
    const fn archive(&self) -> Option<&Archive> {
        match self {
            Self::Archive(archive) => Some(archive),
            #[cfg(feature = "http")]
            Self::Folder(_) => None,
        }
    }
}

/// Where a terrain's archive lies.
enum Archive {
    File(PathBuf),
    #[cfg(feature = "http")]
    Web(HttpClient, String),
    /// Behind a web server that this program can't ask.
    #[cfg(not(feature = "http"))]
    Unreadable(String),
}

impl Archive {
    fn open(&self) -> Result<TerrainArchive, ArchiveError> {
        match self {
            Self::File(path) => TerrainArchive::open_file(path),
            #[cfg(feature = "http")]
            Self::Web(client, url) => {
                TerrainArchive::open(HttpRange::new(client.clone(), url.clone()))
            }
            #[cfg(not(feature = "http"))]
            Self::Unreadable(name) => Err(ArchiveError::Read(RangeError::Other {
                name: name.clone(),
                reason: "this program was built without bevy_tessera's feature `http`".to_owned(),
            })),
        }
    }
}

struct Store {
    place: Place,
    /// The archive, while it is open.
    archive: RwLock<Option<Arc<TerrainArchive>>>,
}

impl Store {
    /// The bytes of a file of the terrain's folder.
    fn read(&self, path: &Path) -> std::io::Result<Vec<u8>> {
        #[cfg(feature = "http")]
        if let Place::Folder(folder) = &self.place {
            // Paths have backslashes on some systems, URLs on none.
            let bytes = folder.read(&path.to_string_lossy().replace('\\', "/"));
            return bytes.map_err(std::io::Error::other);
        }
        self.read_of(path)
            .map_err(|error| {
                // Perhaps the file has been replaced: it is opened anew the next time.
                self.set_opened(None);
                std::io::Error::other(error)
            })?
            .ok_or_else(|| std::io::Error::other("the archive lacks it"))
    }

    fn read_of(&self, path: &Path) -> Result<Option<Vec<u8>>, ArchiveError> {
        let Some(archive) = self.place.archive() else {
            return Ok(None);
        };
        // The manifest is read first, and again where the file may have changed.
        let is_manifest = path == Path::new(MANIFEST_FILE);
        let open = match self.opened().filter(|_| !is_manifest) {
            Some(open) => open,
            None => {
                let new = Arc::new(archive.open()?);
                self.set_opened(Some(Arc::clone(&new)));
                new
            }
        };
        let (manifest, index) = open.manifest();
        if is_manifest {
            return Ok(Some(manifest.as_bytes().to_owned()));
        }
        if path == Path::new(INDEX_FILE) {
            return Ok(Some(index.to_owned()));
        }
        match address_of(path) {
            Some(address) => open.tile(address),
            None => Ok(None),
        }
    }

    fn opened(&self) -> Option<Arc<TerrainArchive>> {
        let open = self.archive.read().unwrap_or_else(PoisonError::into_inner);
        open.clone()
    }

    fn set_opened(&self, archive: Option<Arc<TerrainArchive>>) {
        let mut open = self.archive.write().unwrap_or_else(PoisonError::into_inner);
        *open = archive;
    }
}

/// Reads when it is read from, and not before: the asset server can cancel that, but not the making
/// of a reader.
enum LateReader {
    Asked(Arc<Store>, PathBuf),
    Reading(blocking::Task<std::io::Result<Vec<u8>>>),
    Read(VecReader),
}

impl futures_io::AsyncRead for LateReader {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut [u8],
    ) -> Poll<std::io::Result<usize>> {
        let this = self.get_mut();
        if let Self::Asked(store, path) = this {
            let (store, path) = (Arc::clone(store), std::mem::take(path));
            *this = Self::Reading(blocking::unblock(move || store.read(&path)));
        }
        if let Self::Reading(reading) = this {
            match Pin::new(reading).poll(context) {
                Poll::Pending => return Poll::Pending,
                Poll::Ready(Ok(bytes)) => *this = Self::Read(VecReader::new(bytes)),
                Poll::Ready(Err(error)) => {
                    *this = Self::Read(VecReader::new(Vec::new()));
                    return Poll::Ready(Err(error));
                }
            }
        }
        match this {
            Self::Read(bytes) => Pin::new(bytes).poll_read(context, buffer),
            Self::Asked(..) | Self::Reading(_) => Poll::Pending,
        }
    }
}

impl Reader for LateReader {
    fn seekable(&mut self) -> Result<&mut dyn SeekableReader, ReaderNotSeekableError> {
        Err(ReaderNotSeekableError)
    }
}

struct TerrainReader(Arc<Store>);

impl AssetReader for TerrainReader {
    async fn read<'a>(&'a self, path: &'a Path) -> Result<impl Reader + 'a, AssetReaderError> {
        Ok(LateReader::Asked(Arc::clone(&self.0), path.to_owned()))
    }

    async fn read_meta<'a>(&'a self, path: &'a Path) -> Result<impl Reader + 'a, AssetReaderError> {
        // A terrain has none.
        Err::<VecReader, _>(AssetReaderError::NotFound(path.to_owned()))
    }

    async fn read_directory<'a>(
        &'a self,
        path: &'a Path,
    ) -> Result<Box<PathStream>, AssetReaderError> {
        Err(AssetReaderError::NotFound(path.to_owned()))
    }

    async fn is_directory<'a>(&'a self, _path: &'a Path) -> Result<bool, AssetReaderError> {
        Ok(false)
    }
}
