//! Files that are written as a whole or not at all.

use crate::terrain::{INDEX_FILE, MANIFEST_FILE};
use std::fs::{self, File, Metadata, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use thiserror::Error;

/// Why nothing may be written at a path, whatever kind of file it is to be.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum OutputError {
    /// It names a folder, or nothing (`/`, `..`).
    #[error("{} is no name for a {kind}: it is a folder; give --out a file's name", path.display())]
    Folder {
        /// The path.
        path: PathBuf,
        /// What was to be written.
        kind: &'static str,
    },
    /// The folder in which it lies isn't there.
    #[error(
        "{} can't be written: there is no folder {}; make it, or choose another --out",
        path.display(),
        folder.display()
    )]
    Parent {
        /// The path.
        path: PathBuf,
        /// The folder that is missing.
        folder: PathBuf,
    },
    /// It is a part of a terrain, or no regular file (a device, a pipe).
    #[error("{} is {what}, and is not replaced by a {kind}; choose another --out", path.display())]
    Other {
        /// The path.
        path: PathBuf,
        /// What it is.
        what: &'static str,
        /// What was to be written.
        kind: &'static str,
    },
}

/// Where a file is to be written.
pub(crate) struct Place {
    /// The folder in which it lies.
    pub folder: PathBuf,
    /// Of the file that stands there already.
    pub metadata: Option<Metadata>,
}

/// Whether a file may be put at `out`, as far as that doesn't depend on what `kind` of file it is.
pub(crate) fn check_place(out: &Path, kind: &'static str) -> Result<Place, OutputError> {
    let path = || out.to_owned();
    let other = |what| OutputError::Other {
        path: path(),
        what,
        kind,
    };
    if out.file_name().is_none() {
        return Err(OutputError::Folder { path: path(), kind });
    }
    let folder = match out.parent() {
        Some(parent) if parent != Path::new("") => parent.to_owned(),
        _ => PathBuf::from("."),
    };
    if !folder.is_dir() {
        return Err(OutputError::Parent {
            path: path(),
            folder,
        });
    }
    let metadata = fs::metadata(out).ok();
    if let Some(metadata) = &metadata {
        if metadata.is_dir() {
            return Err(OutputError::Folder { path: path(), kind });
        }
        if !metadata.is_file() {
            return Err(other("no regular file"));
        }
        let named = |name: &str| out.ends_with(name);
        let of_terrain = [MANIFEST_FILE, INDEX_FILE].into_iter().any(named)
            || out.extension().is_some_and(|extension| extension == "tile");
        if of_terrain {
            return Err(other("a part of a terrain"));
        }
    }
    Ok(Place { folder, metadata })
}

/// Removes what processes that are gone left half-written in `folder`, of files that were to become
/// `what`.
pub(crate) fn remove_leftovers(folder: &Path, what: &str) {
    let start = format!(".tessera-{what}-");
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let process = name
            .strip_prefix(&start)
            .and_then(|rest| rest.strip_suffix(".partial")?.split_once('-'))
            .and_then(|(process, number)| number.parse::<u32>().and(process.parse()).ok());
        if process.is_some_and(is_gone) {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Whether the process surely runs no more. Only Linux tells without further ado; elsewhere what
/// a killed process left has to be removed by hand.
pub(crate) fn is_gone(process: u32) -> bool {
    let processes = Path::new("/proc");
    processes.join("self").exists() && !processes.join(process.to_string()).exists()
}

/// A file being written under another name. Dropped before it is published, it is removed.
pub(crate) struct PartialFile {
    path: PathBuf,
    published: bool,
}

impl PartialFile {
    /// A new file in `folder` whose name says `what` it is to become.
    pub(crate) fn create(folder: &Path, what: &str) -> io::Result<(Self, File)> {
        static FILES: AtomicU32 = AtomicU32::new(0);
        let number = FILES.fetch_add(1, Ordering::Relaxed);
        let process = std::process::id();
        let path = folder.join(format!(".tessera-{what}-{process}-{number}.partial"));
        // Only a process that was killed can have left it, since this one has the number now.
        let _ = fs::remove_file(&path);
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&path)?;
        let published = false;
        Ok((Self { path, published }, file))
    }

    /// Brings `file` to the disk and puts it at `out`, in place of what stood there.
    pub(crate) fn publish(mut self, file: File, out: &Path) -> io::Result<()> {
        file.sync_all()?;
        // Not every system renames what is open.
        drop(file);
        fs::rename(&self.path, out)?;
        self.published = true;
        Ok(())
    }
}

impl Drop for PartialFile {
    fn drop(&mut self) {
        if !self.published {
            let _ = fs::remove_file(&self.path);
        }
    }
}
