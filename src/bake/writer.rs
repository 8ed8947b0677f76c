//! Writing a terrain so that it is there as a whole or not at all.

use super::BakeError;
use crate::output::is_gone;
use crate::terrain::{INDEX_FILE, MANIFEST_FILE, ManifestFile};
use crate::tile::{DensityTile, ErrorTile, HeightTile, TileAddress, TileIndex, tile_path};
use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Between a terrain's name and the process's number, in the name of a folder being written.
const PARTIAL: &str = ".tessera-partial-";
/// The same for a terrain that was moved aside to be replaced.
const OLD: &str = ".tessera-old-";

/// How long a folder stands in its place before watchers are told of it.
const WATCHERS_DELAY: std::time::Duration = std::time::Duration::from_millis(200);

/// Numbers the bakes of this process, so that two of them never share a folder.
static BAKES: AtomicU32 = AtomicU32::new(0);

fn failed(path: &Path) -> impl FnOnce(io::Error) -> BakeError {
    let path = path.to_owned();
    |reason| BakeError::Write { path, reason }
}

/// The output's parent folder and its own name.
fn split(out: &Path) -> Result<(PathBuf, OsString), BakeError> {
    let name = out.file_name().ok_or_else(|| BakeError::OutputName {
        path: out.to_owned(),
    })?;
    let parent = match out.parent() {
        Some(parent) if parent != Path::new("") => parent.to_owned(),
        _ => PathBuf::from("."),
    };
    Ok((parent, name.to_owned()))
}

/// Puts right what bakes of the same terrain left behind that were killed, and checks whether `out`
/// may be written.
pub(super) fn prepare(out: &Path, force: bool) -> Result<(), BakeError> {
    put_right(out)?;
    check_output(out, force)
}

/// Puts right what bakes of the terrain `out` left behind that were killed: where one had moved the
/// old terrain aside and not yet put the new one in its place, the old one comes back; half-made
/// folders are removed. Bakes and rebakes do it first; whoever is about to read a terrain that seems
/// to be missing may do it too.
///
/// # Errors
/// Where `out` has no name of its own.
pub fn put_right(out: &Path) -> Result<(), BakeError> {
    let (parent, name) = split(out)?;
    recover(&parent, &name, out);
    Ok(())
}

/// Whether `out` may be written; changes nothing.
fn check_output(out: &Path, force: bool) -> Result<(), BakeError> {
    let path = || out.to_owned();
    // Not `exists`, to which a dangling link is nothing.
    let Ok(metadata) = fs::symlink_metadata(out) else {
        return Ok(());
    };
    if metadata.is_dir() && fs::read_dir(out).is_ok_and(|mut inside| inside.next().is_none()) {
        return Ok(());
    }
    let terrain = metadata.is_dir() && out.join(MANIFEST_FILE).is_file();
    match (terrain, force) {
        (_, false) => Err(BakeError::OutputExists { path: path() }),
        (true, true) => Ok(()),
        (false, true) => Err(BakeError::OutputNotTerrain { path: path() }),
    }
}

/// A terrain being written, in a folder beside the one where it will lie. Dropped, it is removed.
pub(super) struct PartialTerrain {
    dir: PathBuf,
    parent: PathBuf,
    out: PathBuf,
    old: PathBuf,
    published: bool,
}

impl PartialTerrain {
    /// Makes the folder, with room for every level.
    pub(super) fn create(out: &Path, manifest: &ManifestFile) -> Result<Self, BakeError> {
        let (parent, name) = split(out)?;
        fs::create_dir_all(&parent).map_err(failed(&parent))?;
        let bake = BAKES.fetch_add(1, Ordering::Relaxed);
        let sibling = |kind: &str| {
            let mut file = OsString::from(".");
            file.push(&name);
            file.push(format!("{kind}{}-{bake}", std::process::id()));
            parent.join(file)
        };
        let partial = Self {
            dir: sibling(PARTIAL),
            old: sibling(OLD),
            out: out.to_owned(),
            parent,
            published: false,
        };
        // Fails where it exists: it would be another bake's.
        fs::create_dir(&partial.dir).map_err(failed(&partial.dir))?;
        for level in 0..manifest.levels {
            let dir = partial.dir.join(format!("tile/{level}"));
            fs::create_dir_all(&dir).map_err(failed(&dir))?;
        }
        Ok(partial)
    }

    pub(super) fn dir(&self) -> &Path {
        &self.dir
    }

    /// Writes index and manifest; returns the number of bytes.
    pub(super) fn write_index(
        &self,
        manifest: &mut ManifestFile,
        index: &TileIndex,
    ) -> Result<u64, BakeError> {
        let bytes = index.encode();
        manifest.index_crc32 = crc32fast::hash(&bytes);
        let path = self.dir.join(INDEX_FILE);
        fs::write(&path, &bytes).map_err(failed(&path))?;
        let path = self.dir.join(MANIFEST_FILE);
        let pretty = ron::ser::PrettyConfig::default();
        let text = ron::ser::to_string_pretty(manifest, pretty)
            .map_err(|error| failed(&path)(io::Error::other(error)))?;
        fs::write(&path, &text).map_err(failed(&path))?;
        Ok((bytes.len() + text.len()) as u64)
    }

    /// Gives whatever else lies in the folder that will be replaced a place in the new one, but for
    /// what `skip` names (a path below the folder). A terrain's folder may hold more than a terrain:
    /// textures, notes, metadata. Nothing of it may be lost.
    pub(super) fn carry_over(&self, skip: &dyn Fn(&Path) -> bool) -> Result<(), BakeError> {
        if self.out.join(MANIFEST_FILE).is_file() {
            carry_over(&self.out, &self.dir, skip)?;
        }
        Ok(())
    }

    /// Puts the finished terrain in its place.
    pub(super) fn publish(mut self, force: bool) -> Result<(), BakeError> {
        // Something may have appeared since the bake began.
        check_output(&self.out, force)?;
        let replaces = self.out.join(MANIFEST_FILE).is_file();
        if replaces {
            fs::rename(&self.out, &self.old).map_err(failed(&self.out))?;
        } else if self.out.is_dir() {
            fs::remove_dir(&self.out).map_err(failed(&self.out))?;
        }
        if let Err(reason) = fs::rename(&self.dir, &self.out) {
            if replaces {
                // Back to where it was; should that fail too, the next bake does it.
                let _ = fs::rename(&self.old, &self.out);
            }
            return Err(failed(&self.out)(reason));
        }
        self.published = true;
        if replaces {
            // The new terrain stands; what can't be removed now, the next bake removes.
            let _ = fs::remove_dir_all(&self.old);
            // Whoever watches the files of a running program is told of files that were written,
            // not of a folder that was renamed, and watches the new one only after a moment.
            std::thread::sleep(WATCHERS_DELAY);
            let manifest = self.out.join(MANIFEST_FILE);
            let _ = fs::OpenOptions::new().append(true).open(manifest);
        }
        // A rename is on disk when its folder is. Not every system can sync a folder.
        let _ = fs::File::open(&self.parent).and_then(|folder| folder.sync_all());
        Ok(())
    }
}

impl Drop for PartialTerrain {
    fn drop(&mut self) {
        if !self.published {
            let _ = fs::remove_dir_all(&self.dir);
        }
    }
}

/// Removes what killed bakes of the terrain `name` left in `parent`. Where one was killed between
/// moving the old terrain aside and putting the new one in its place, the old one comes back.
fn recover(parent: &Path, name: &OsString, out: &Path) {
    let Ok(entries) = fs::read_dir(parent) else {
        return;
    };
    let name = name.to_string_lossy();
    for entry in entries.flatten() {
        let file = entry.file_name().to_string_lossy().into_owned();
        let Some(rest) = file
            .strip_prefix('.')
            .and_then(|file| file.strip_prefix(&*name))
        else {
            continue;
        };
        let left_by = |kind: &str| {
            let (process, _) = rest.strip_prefix(kind)?.split_once('-')?;
            process.parse::<u32>().ok()
        };
        if left_by(OLD).is_some_and(is_gone) {
            if fs::symlink_metadata(out).is_err() {
                let _ = fs::rename(entry.path(), out);
            } else {
                let _ = fs::remove_dir_all(entry.path());
            }
        } else if left_by(PARTIAL).is_some_and(is_gone) {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

/// What a tile's file is made of. What is `None` is left out, for benchmarks.
pub(super) struct Tile<'a> {
    pub(super) heights: &'a HeightTile,
    pub(super) densities: Option<&'a DensityTile>,
    pub(super) errors: Option<&'a ErrorTile>,
    /// The terrain's.
    pub(super) stamp: u32,
}

impl Tile<'_> {
    /// Writes the tile's file; returns the number of bytes.
    pub(super) fn write(&self, dir: &Path, address: TileAddress) -> Result<u64, BakeError> {
        let mut bytes = self.heights.encode(address, self.stamp);
        if let Some(densities) = self.densities {
            bytes.extend(densities.encode(address, self.stamp));
        }
        if let Some(errors) = self.errors {
            bytes.extend(errors.encode(address, self.stamp));
        }
        let path = dir.join(tile_path(address));
        fs::write(&path, &bytes).map_err(failed(&path))?;
        Ok(bytes.len() as u64)
    }
}

/// Whether what lies at `path` below a terrain's folder is a part of the terrain.
pub(super) fn is_ours(path: &Path) -> bool {
    // The last two are those of version 1.
    let ours = [MANIFEST_FILE, INDEX_FILE, "tile", "height", "density"];
    ours.iter().any(|name| path == Path::new(name))
}

/// A terrain whose files are known as they are, being written beside the folder where it will lie.
#[cfg(feature = "archive")]
pub(crate) struct FolderWriter {
    partial: PartialTerrain,
    force: bool,
}

#[cfg(feature = "archive")]
impl FolderWriter {
    /// Makes the folder, with room for every level, where it may take `out`'s place.
    pub(crate) fn create(
        out: &Path,
        manifest: &ManifestFile,
        force: bool,
    ) -> Result<Self, BakeError> {
        prepare(out, force)?;
        let partial = PartialTerrain::create(out, manifest)?;
        Ok(Self { partial, force })
    }

    /// Writes a file at `path` below the folder.
    pub(crate) fn write(&self, path: &Path, bytes: &[u8]) -> Result<(), BakeError> {
        let path = self.partial.dir().join(path);
        fs::write(&path, bytes).map_err(failed(&path))
    }

    /// Puts the finished terrain in its place.
    pub(crate) fn publish(self) -> Result<(), BakeError> {
        self.partial.carry_over(&is_ours)?;
        self.partial.publish(self.force)
    }
}

/// A path beside `out` that [`put_right`] clears away once this process is gone.
#[cfg(feature = "archive")]
pub(crate) fn partial_path(out: &Path, what: &str) -> Result<PathBuf, BakeError> {
    let (parent, name) = split(out)?;
    let mut file = OsString::from(".");
    file.push(&name);
    file.push(format!("{PARTIAL}{}-{what}", std::process::id()));
    Ok(parent.join(file))
}

/// Which terrain lies in a folder, to tell whether another has taken its place.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Identity {
    folder: Option<(u64, u64)>,
    manifest: Vec<u8>,
}

impl Identity {
    pub(super) fn of(dir: &Path) -> Result<Self, BakeError> {
        let path = dir.join(MANIFEST_FILE);
        let manifest = fs::read(&path).map_err(failed(&path))?;
        #[cfg(unix)]
        let folder = {
            use std::os::unix::fs::MetadataExt;
            fs::metadata(dir).ok().map(|dir| (dir.dev(), dir.ino()))
        };
        #[cfg(not(unix))]
        let folder = None;
        Ok(Self { folder, manifest })
    }
}

/// Gives everything that lies in the folder `from` a second name in the folder `to`, but for what is
/// there already and for what `skip` names (a path below `from`). Files are linked, or copied where
/// the file system can't; links are made again; folders keep their permissions.
fn carry_over(from: &Path, to: &Path, skip: &dyn Fn(&Path) -> bool) -> Result<(), BakeError> {
    carry_below(from, to, Path::new(""), skip)?;
    if let Ok(folder) = fs::metadata(from) {
        // Not every file system keeps permissions.
        let _ = fs::set_permissions(to, folder.permissions());
    }
    Ok(())
}

fn carry_below(
    from: &Path,
    to: &Path,
    below: &Path,
    skip: &dyn Fn(&Path) -> bool,
) -> Result<(), BakeError> {
    let folder = from.join(below);
    for entry in fs::read_dir(&folder).map_err(failed(&folder))? {
        let entry = entry.map_err(failed(&folder))?;
        let path = below.join(entry.file_name());
        let (source, target) = (entry.path(), to.join(&path));
        let kind = entry.file_type().map_err(failed(&source))?;
        if skip(&path) {
            continue;
        }
        if kind.is_dir() {
            fs::create_dir_all(&target).map_err(failed(&target))?;
            carry_below(from, to, &path, skip)?;
        } else if fs::symlink_metadata(&target).is_ok() {
            continue;
        } else if kind.is_symlink() {
            carry_link(&source, &target).map_err(failed(&target))?;
        } else if kind.is_file() && fs::hard_link(&source, &target).is_err() {
            fs::copy(&source, &target)
                .map(drop)
                .map_err(failed(&target))?;
        }
    }
    Ok(())
}

#[cfg(unix)]
fn carry_link(source: &Path, target: &Path) -> io::Result<()> {
    std::os::unix::fs::symlink(fs::read_link(source)?, target)
}

#[cfg(not(unix))]
fn carry_link(source: &Path, target: &Path) -> io::Result<()> {
    fs::copy(source, target).map(drop)
}
