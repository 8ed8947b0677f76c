//! The frame around every binary file of a terrain: magic, version, address, length, checksum.
//!
//! ```text
//! offset  size  what
//!      0     8  magic, which names the kind of file
//!      8     4  version
//!     12     4  level     (index: number of levels)
//!     16     4  x         (index: 0)
//!     20     4  z         (index: 0)
//!     24     4  stamp of the terrain that the tile belongs to (index: 0)
//!     28     4  length of the payload in bytes
//!     32     4  CRC-32 (IEEE) of bytes 0..32 and the payload
//!     36        payload
//! ```
//!
//! All numbers are little endian. The checksum covers the header too, so that a tile that was
//! copied over another one is found out even where both hold the same heights. The
//! [stamp](crate::terrain::ManifestFile::stamp) does the same for tiles of another terrain.

use super::{TileAddress, TileRange};
use thiserror::Error;

/// Bytes before the payload.
pub(crate) const HEADER_LEN: usize = 36;
/// The version that this crate writes and reads, for every kind of file.
pub(crate) const FORMAT_VERSION: u32 = 2;

/// The kinds of binary files in a terrain's folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum TileKind {
    /// A tile of heights, the first section of `tile/{level}/{x}_{z}.tile`.
    Height,
    /// A tile of densities, the second section of `tile/{level}/{x}_{z}.tile`.
    Density,
    /// A tile of bounds on what triangles leave, the third section of `tile/{level}/{x}_{z}.tile`.
    Error,
    /// The index of all tiles, `tiles.index`.
    Index,
}

impl TileKind {
    /// The eight bytes that a file of this kind starts with.
    #[must_use]
    pub const fn magic(self) -> [u8; 8] {
        match self {
            Self::Height => *b"TSRHGHT\0",
            Self::Density => *b"TSRDENS\0",
            Self::Error => *b"TSRERRB\0",
            Self::Index => *b"TSRINDX\0",
        }
    }

    /// What the kind is called in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Height => "height tile",
            Self::Density => "density tile",
            Self::Error => "error tile",
            Self::Index => "tile index",
        }
    }
}

/// Why bytes are not the tile, or the index, that was asked for.
///
/// The messages don't name the file: whoever read it knows its name and says so in front.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum TileFormatError {
    /// Fewer bytes than a header takes.
    #[error("it ends after {found} bytes where its header alone takes {wanted}")]
    TooShort {
        /// Bytes found.
        found: usize,
        /// Bytes that a header takes.
        wanted: usize,
    },
    /// The first eight bytes are another format's.
    #[error(
        "it starts with \"{}\" where a {} starts with \"{}\"",
        found.escape_ascii(),
        kind.name(),
        kind.magic().escape_ascii()
    )]
    Magic {
        /// The bytes found.
        found: [u8; 8],
        /// What was wanted.
        kind: TileKind,
    },
    /// Written by another version of this crate.
    #[error("it has format version {found} where this program reads version {wanted}; bake again")]
    Version {
        /// Version found.
        found: u32,
        /// Version that this crate reads.
        wanted: u32,
    },
    /// A good tile, but another one.
    #[error("it holds tile {found} where tile {wanted} belongs")]
    Address {
        /// The tile that the bytes hold.
        found: TileAddress,
        /// The tile that was asked for.
        wanted: TileAddress,
    },
    /// A good tile, but another terrain's.
    #[error(
        "it belongs to another terrain (stamp {found:08x} where terrain.ron has {wanted:08x}); \
         bake again"
    )]
    Stamp {
        /// Stamp found in the tile.
        found: u32,
        /// [Stamp](crate::terrain::ManifestFile::stamp) of the terrain.
        wanted: u32,
    },
    /// The tile's file was put together from two terrains' tiles.
    #[error(
        "its {} belongs to another terrain (stamp {found:08x} where its heights have \
         {wanted:08x}); bake again",
        kind.name()
    )]
    MixedStamps {
        /// The section.
        kind: TileKind,
        /// The section's stamp.
        found: u32,
        /// Stamp of the first section.
        wanted: u32,
    },
    /// A tile with heights that the index doesn't promise.
    #[error(
        "its heights reach from {} to {} where tiles.index has {} to {}; bake again",
        found.min,
        found.max,
        wanted.min,
        wanted.max
    )]
    Range {
        /// Where the tile's heights reach.
        found: TileRange,
        /// Where the index has them reach, children's included.
        wanted: TileRange,
    },
    /// A tile that the terrain's index doesn't have.
    #[error("tiles.index has no such tile; bake again")]
    NotInIndex,
    /// A packed tile that can't be unpacked.
    #[cfg(feature = "archive")]
    #[error(transparent)]
    Packed(super::PackError),
    /// A packed tile, in a program that can't unpack it.
    #[cfg(not(feature = "archive"))]
    #[error("it is packed, which this program can't read: enable bevy_tessera's feature `archive`")]
    PackedUnsupported,
    /// More or fewer bytes than this kind of file has.
    #[error("its payload has {found} bytes where {wanted} belong")]
    Length {
        /// Bytes found, or promised by the header where that is less plausible.
        found: u64,
        /// Bytes that belong there.
        wanted: u64,
    },
    /// The bytes changed since they were written.
    #[error("its checksum is {found:08x} where its header says {wanted:08x}: it is damaged")]
    Checksum {
        /// Checksum of the bytes found.
        found: u32,
        /// Checksum that the header promises.
        wanted: u32,
    },
    /// An index whose levels can't be those of a terrain.
    #[error("its level {level} has {found:?} tiles where {wanted:?} belong")]
    Levels {
        /// The level, 0 the finest.
        level: u32,
        /// Tiles in x and z that the index claims.
        found: [u32; 2],
        /// Tiles in x and z that fit the other levels (the limit, where it is exceeded).
        wanted: [u32; 2],
    },
    /// An index with no level, or more levels than any terrain has.
    #[error("it claims {found} levels where a terrain has between 1 and {limit}")]
    LevelCount {
        /// Levels that the index claims.
        found: u32,
        /// The most levels that a terrain can have.
        limit: u32,
    },
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

/// Starts a file of `kind`: a header whose length and checksum [`finish`] fills in, with room for
/// `payload` bytes behind it.
pub(crate) fn start(kind: TileKind, address: [u32; 3], stamp: u32, payload: usize) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_LEN + payload);
    bytes.extend_from_slice(&kind.magic());
    bytes.extend_from_slice(&FORMAT_VERSION.to_le_bytes());
    for number in address {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    bytes.extend_from_slice(&stamp.to_le_bytes());
    bytes.extend_from_slice(&[0; 8]);
    bytes
}

/// Writes length and checksum into the header, the payload being complete.
pub(crate) fn finish(mut bytes: Vec<u8>) -> Vec<u8> {
    let payload = u32::try_from(bytes.len() - HEADER_LEN).unwrap_or(u32::MAX);
    bytes[28..32].copy_from_slice(&payload.to_le_bytes());
    let checksum = checksum(&bytes);
    bytes[32..36].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

fn checksum(bytes: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&bytes[..32]);
    hasher.update(&bytes[HEADER_LEN..]);
    hasher.finalize()
}

/// The section of `kind` in a file that may hold several, one after the other; the whole file where
/// it can't be told.
pub(crate) fn section(bytes: &[u8], kind: TileKind) -> &[u8] {
    let mut rest = bytes;
    while rest.len() > HEADER_LEN {
        let length = HEADER_LEN + u32_at(rest, 28) as usize;
        let known = |magic: &[u8]| {
            [TileKind::Height, TileKind::Density, TileKind::Error]
                .iter()
                .any(|kind| magic.starts_with(&kind.magic()))
        };
        let wanted = rest.starts_with(&kind.magic());
        if !known(rest) || length > rest.len() {
            break;
        }
        let (own, next) = rest.split_at(length);
        if wanted {
            // What follows must be a section too, or the file has grown.
            return if known(next) { own } else { rest };
        }
        rest = next;
    }
    if rest.starts_with(&kind.magic()) {
        rest
    } else {
        bytes
    }
}

/// What a file says when it is sound.
pub(crate) struct Opened<'a> {
    /// The header's three numbers.
    pub(crate) numbers: [u32; 3],
    pub(crate) stamp: u32,
    pub(crate) payload: &'a [u8],
}

/// Checks everything but the address and the stamp.
pub(crate) fn open(bytes: &[u8], kind: TileKind) -> Result<Opened<'_>, TileFormatError> {
    // The magic comes first, as far as there is one: an empty file is short, a text file is
    // another format, whatever its length.
    if let Some(found) = bytes.first_chunk::<8>()
        && *found != kind.magic()
    {
        return Err(TileFormatError::Magic {
            found: *found,
            kind,
        });
    }
    if bytes.len() < HEADER_LEN {
        return Err(TileFormatError::TooShort {
            found: bytes.len(),
            wanted: HEADER_LEN,
        });
    }
    let version = u32_at(bytes, 8);
    if version != FORMAT_VERSION {
        return Err(TileFormatError::Version {
            found: version,
            wanted: FORMAT_VERSION,
        });
    }
    let payload = &bytes[HEADER_LEN..];
    let promised = u32_at(bytes, 28);
    if payload.len() as u64 != u64::from(promised) {
        return Err(TileFormatError::Length {
            found: payload.len() as u64,
            wanted: u64::from(promised),
        });
    }
    let (found, wanted) = (checksum(bytes), u32_at(bytes, 32));
    if found != wanted {
        return Err(TileFormatError::Checksum { found, wanted });
    }
    Ok(Opened {
        numbers: [u32_at(bytes, 12), u32_at(bytes, 16), u32_at(bytes, 20)],
        stamp: u32_at(bytes, 24),
        payload,
    })
}

/// [`open`] for a tile: also checks that it is the `wanted` one and has `length` payload bytes.
/// Returns its stamp and its payload.
pub(crate) fn open_tile(
    bytes: &[u8],
    kind: TileKind,
    wanted: TileAddress,
    length: usize,
) -> Result<(u32, &[u8]), TileFormatError> {
    let opened = open(section(bytes, kind), kind)?;
    let ([level, x, z], payload) = (opened.numbers, opened.payload);
    let found = TileAddress::new(u8::try_from(level).unwrap_or(u8::MAX), x, z);
    if found != wanted || level != u32::from(wanted.level) {
        return Err(TileFormatError::Address { found, wanted });
    }
    if payload.len() != length {
        return Err(TileFormatError::Length {
            found: payload.len() as u64,
            wanted: length as u64,
        });
    }
    Ok((opened.stamp, payload))
}

/// A tile, or a part of one, that was read with its stamp, if it belongs to the terrain of the
/// stamp `wanted`.
pub(crate) fn of_terrain<T>((tile, found): (T, u32), wanted: u32) -> Result<T, TileFormatError> {
    if found == wanted {
        Ok(tile)
    } else {
        Err(TileFormatError::Stamp { found, wanted })
    }
}
