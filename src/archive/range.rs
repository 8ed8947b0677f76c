//! Bytes that are read by range.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Bytes that can be read by range: a file, or a file behind a web server.
pub trait RangeSource: Send + Sync + 'static {
    /// What the source is called in messages: a path or a URL.
    fn name(&self) -> String;

    /// Reads exactly `length` bytes from `offset` on. Blocks.
    ///
    /// # Errors
    /// Where they can't be had, in one sentence that names the source.
    fn read_at(&self, offset: u64, length: usize) -> Result<Vec<u8>, RangeError>;
}

/// Why bytes could not be read.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum RangeError {
    /// There is no such file.
    #[error("{name} is missing")]
    Missing {
        /// The source.
        name: String,
    },
    /// A web server refused.
    #[error("{name} can't be read: the server answers {status}")]
    Status {
        /// The source.
        name: String,
        /// HTTP status.
        status: u16,
    },
    /// It took too long.
    #[error("{name} can't be read: no answer within {seconds} s")]
    Timeout {
        /// The source.
        name: String,
        /// How long was waited.
        seconds: f32,
    },
    /// It ends early.
    #[error("{name} is truncated: it ends before byte {wanted}; copy it or make it again")]
    Short {
        /// The source.
        name: String,
        /// One past the last byte that was wanted.
        wanted: u64,
    },
    /// Anything else.
    #[error("{name} can't be read: {reason}")]
    Other {
        /// The source.
        name: String,
        /// What the system says.
        reason: String,
    },
}

/// A file that is read by range, by any number of threads at once.
///
/// It stays the file that was opened: another one that is renamed to the same path isn't seen.
#[derive(Debug)]
pub struct FileRange {
    file: File,
    path: PathBuf,
}

impl FileRange {
    /// Opens the file at `path`.
    ///
    /// # Errors
    /// Where there is none, or it can't be opened.
    pub fn open(path: &Path) -> Result<Self, RangeError> {
        let name = || path.display().to_string();
        let file = File::open(path).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => RangeError::Missing { name: name() },
            _ => RangeError::Other {
                name: name(),
                reason: error.to_string(),
            },
        })?;
        Ok(Self {
            file,
            path: path.to_owned(),
        })
    }
}

impl RangeSource for FileRange {
    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn read_at(&self, offset: u64, length: usize) -> Result<Vec<u8>, RangeError> {
        let other = |error: io::Error| RangeError::Other {
            name: self.name(),
            reason: error.to_string(),
        };
        let wanted = offset.saturating_add(length as u64);
        let short = || RangeError::Short {
            name: self.name(),
            wanted,
        };
        // Before any memory is taken for bytes that aren't there.
        if self.file.metadata().map_err(other)?.len() < wanted {
            return Err(short());
        }
        let mut bytes = vec![0; length];
        read_exact_at(&self.file, &mut bytes, offset).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => short(),
            _ => other(error),
        })?;
        Ok(bytes)
    }
}

#[cfg(unix)]
fn read_exact_at(file: &File, bytes: &mut [u8], offset: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

#[cfg(windows)]
fn read_exact_at(file: &File, mut bytes: &mut [u8], mut offset: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        // Moves the file's cursor too, which nobody here goes by.
        match std::os::windows::fs::FileExt::seek_read(file, bytes, offset) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(read) => {
                bytes = &mut bytes[read..];
                offset += read as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(not(any(unix, windows)))]
fn read_exact_at(_: &File, _: &mut [u8], _: u64) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}
