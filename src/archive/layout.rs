//! Where things lie in a PMTiles archive of version 3: its header, its directories, its tiles'
//! numbers. <https://github.com/protomaps/PMTiles/blob/main/spec/v3/spec.md>

use crate::tile::TileAddress;
use flate2::read::GzDecoder;
use pmtiles::{TileCoord, TileId};
use std::io::Read;

/// Bytes of the header.
pub(super) const HEADER_LEN: usize = 127;
/// Bytes within which header and root directory lie.
pub(super) const START_LEN: usize = 16_384;
const MAGIC: &[u8] = b"PMTiles";
/// No compression, in the header.
const PLAIN: u8 = 1;
/// gzip, in the header.
const GZIP: u8 = 2;
/// The most bytes of a directory, unpacked: one of all tiles of the largest terrain.
const MAX_DIRECTORY_LEN: usize = 32 << 20;

/// A part of the archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Section {
    pub(super) offset: u64,
    pub(super) length: u64,
}

impl Section {
    /// One past the last byte.
    pub(super) fn end(self) -> Option<u64> {
        self.offset.checked_add(self.length)
    }

    /// Where a part of this part lies, if within.
    pub(super) fn part(self, offset: u64, length: u64) -> Option<Self> {
        let end = offset.checked_add(length)?;
        let offset = self.offset.checked_add(offset)?;
        (end <= self.length).then_some(Self { offset, length })
    }
}

/// What the header says, as far as it matters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) root: Section,
    pub(super) metadata: Section,
    pub(super) leaves: Section,
    pub(super) tiles: Section,
    /// Tiles that the archive has.
    pub(super) addressed: u64,
    /// Of tiles and of what describes them: `None` where it is another one than is read here.
    gzip: bool,
    pub(super) zooms: [u8; 2],
}

/// Why a header is none.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum HeaderFault {
    Magic,
    Version(u8),
    /// Good, but of something else: tiles are of a known type or compressed, or directories are
    /// compressed as no terrain's are.
    Other,
    Damaged(&'static str),
}

impl Header {
    pub(super) fn decode(bytes: &[u8]) -> Result<Self, HeaderFault> {
        if !bytes.starts_with(MAGIC) {
            return Err(HeaderFault::Magic);
        }
        match bytes.get(MAGIC.len()) {
            Some(3) => {}
            Some(&other) => return Err(HeaderFault::Version(other)),
            None => return Err(HeaderFault::Damaged("it ends within its header")),
        }
        let Some(bytes) = bytes.first_chunk::<HEADER_LEN>() else {
            return Err(HeaderFault::Damaged("it ends within its header"));
        };
        let number = |at: usize| {
            let mut eight = [0; 8];
            eight.copy_from_slice(&bytes[at..at + 8]);
            u64::from_le_bytes(eight)
        };
        let section = |at: usize| Section {
            offset: number(at),
            length: number(at + 8),
        };
        let [internal, tiles, kind] = [bytes[97], bytes[98], bytes[99]];
        let unpacked = internal == PLAIN || internal == GZIP;
        if kind != 0 || tiles > PLAIN || !unpacked {
            return Err(HeaderFault::Other);
        }
        let header = Self {
            root: section(8),
            metadata: section(24),
            leaves: section(40),
            tiles: section(56),
            addressed: number(72),
            gzip: internal == GZIP,
            zooms: [bytes[100], bytes[101]],
        };
        let (entries, contents) = (number(80), number(88));
        if header.addressed < entries || entries < contents {
            return Err(HeaderFault::Damaged(
                "its header counts more tiles than it has",
            ));
        }
        let root = header.root.end().is_some_and(|end| end <= START_LEN as u64);
        if header.root.offset < HEADER_LEN as u64 || !root {
            return Err(HeaderFault::Damaged("its root directory lies elsewhere"));
        }
        let all = [header.metadata, header.leaves, header.tiles];
        if all.iter().any(|section| section.end().is_none()) {
            return Err(HeaderFault::Damaged(
                "its header places a part beyond its end",
            ));
        }
        Ok(header)
    }

    /// One past the archive's last byte.
    pub(super) fn end(&self) -> u64 {
        let all = [self.root, self.metadata, self.leaves, self.tiles];
        let ends = all.iter().filter_map(|section| section.end());
        ends.max().unwrap_or_default()
    }

    /// Unpacks a directory or the metadata, of at most `limit` bytes.
    pub(super) fn unpack(&self, bytes: Vec<u8>, limit: usize) -> Result<Vec<u8>, String> {
        if !self.gzip {
            return Ok(bytes);
        }
        let mut out = Vec::new();
        let mut reader = GzDecoder::new(bytes.as_slice()).take(limit as u64 + 1);
        reader
            .read_to_end(&mut out)
            .map_err(|error| error.to_string())?;
        if out.len() > limit {
            return Err(format!("it takes more than {limit} bytes"));
        }
        Ok(out)
    }

    /// Reads a directory.
    pub(super) fn directory(&self, bytes: Vec<u8>) -> Result<Directory, String> {
        Directory::decode(&self.unpack(bytes, MAX_DIRECTORY_LEN)?)
            .ok_or_else(|| "its entries can't be understood".to_owned())
    }
}

/// A tile, a run of equal ones, or a directory of more.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Entry {
    pub(super) tile: u64,
    /// Tiles that this one stands for; 0 for a directory.
    pub(super) run: u32,
    pub(super) offset: u64,
    pub(super) length: u32,
}

/// Entries, by tile.
#[derive(Debug)]
pub(super) struct Directory {
    entries: Box<[Entry]>,
}

impl Directory {
    /// How many entries it has.
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    fn decode(mut bytes: &[u8]) -> Option<Self> {
        let count = usize::try_from(number(&mut bytes)?).ok()?;
        // Every entry takes at least four bytes.
        if count > bytes.len() / 4 {
            return None;
        }
        let mut entries = vec![Entry::default(); count].into_boxed_slice();
        let mut tile = 0_u64;
        for (at, entry) in entries.iter_mut().enumerate() {
            let step = number(&mut bytes)?;
            if at > 0 && step == 0 {
                return None;
            }
            tile = tile.checked_add(step)?;
            entry.tile = tile;
        }
        for entry in &mut entries {
            entry.run = number(&mut bytes)?.try_into().ok()?;
        }
        for entry in &mut entries {
            entry.length = number(&mut bytes)?.try_into().ok()?;
            if entry.length == 0 {
                return None;
            }
        }
        let mut end = None;
        for entry in &mut entries {
            entry.offset = match number(&mut bytes)? {
                0 => end?,
                offset => offset - 1,
            };
            end = Some(entry.offset.checked_add(entry.length.into())?);
        }
        let overlap = |two: &[Entry]| two[0].tile + u64::from(two[0].run) > two[1].tile;
        if !bytes.is_empty() || entries.windows(2).any(overlap) {
            return None;
        }
        Some(Self { entries })
    }

    /// The entry that has `tile`, or the directory that may have it.
    pub(super) fn find(&self, tile: u64) -> Option<Entry> {
        let after = self.entries.partition_point(|entry| entry.tile <= tile);
        let entry = *self.entries.get(after.checked_sub(1)?)?;
        (entry.run == 0 || tile - entry.tile < u64::from(entry.run)).then_some(entry)
    }
}

/// A number of variable length: seven bits a byte, the lowest first.
fn number(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0_u64;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        let bits = u64::from(byte & 0x7f);
        if (bits << shift) >> shift != bits {
            return None;
        }
        value |= bits << shift;
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}

/// Where a tile of a terrain with `levels` levels lies in an archive: zoom 0 is the root; columns
/// run along x, rows along z. `None` for a tile beyond the terrain.
pub(super) fn coordinate(levels: u8, address: TileAddress) -> Option<TileCoord> {
    let zoom = levels.checked_sub(1)?.checked_sub(address.level)?;
    TileCoord::new(zoom, address.x, address.z).ok()
}

/// A tile's number in an archive, by which directories are sorted.
pub(super) fn tile_number(levels: u8, address: TileAddress) -> Option<u64> {
    coordinate(levels, address).map(|coordinate| TileId::from(coordinate).value())
}
