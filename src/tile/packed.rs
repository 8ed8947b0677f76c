//! Tiles packed losslessly, as an archive stores them.
//!
//! ```text
//! offset  size  what
//!      0     8  magic, "TSRPACK\0"
//!      8     4  version
//!     12     4  stamp of the terrain that the tile belongs to
//!     16     4  length of the packed heights in bytes
//!     20     4  length of the packed densities
//!     24     4  length of the packed error bounds
//!     28     4  CRC-32 (IEEE) of bytes 0..28 and all that follows
//!     32        heights, densities, error bounds
//! ```
//!
//! All numbers are little endian. The address is not among them, so that equal tiles, such as those
//! of a flat sea, are equal bytes: whoever stores a pack vouches for where it belongs.
//!
//! What is packed is the difference of every number to what its neighbours let expect, folded to
//! small unsigned numbers (0, -1, 1, -2, ...), which `pco` then codes:
//! - heights by the plane through the samples to the left, above, and above left, or by the median
//!   of the left one, the one above, and that plane, whichever leaves less; a byte in front says so;
//! - densities by the median;
//! - error bounds one spacing after the other, by the median too. A byte in front counts the
//!   spacings, as many as have any bound.

use super::{
    DENSITY_STORED, DENSITY_TEXELS, DensityTile, ErrorTile, HeightTile, TILE_STORED, TerrainTile,
    whole::PACK_MAGIC as MAGIC,
};
use pco::data_types::Number;
use pco::{ChunkConfig, DeltaSpec, ModeSpec};
use thiserror::Error;

const VERSION: u32 = 1;
const HEADER_LEN: usize = 32;

const SIDE: usize = TILE_STORED as usize;
const SAMPLES: usize = SIDE * SIDE;
const DENSITY_SIDE: usize = DENSITY_STORED as usize;
const ERROR_SIDE: usize = DENSITY_TEXELS as usize;
const ERROR_TEXELS: usize = ERROR_SIDE * ERROR_SIDE;
/// Bytes of a texel of error bounds.
const ERROR_BYTES: usize = 8;

/// How hard `pco` looks for good bins. 12, the most, gains a four-hundredth at best and takes five
/// times as long on some ground; 8, its own choice, loses up to a fiftieth.
const LEVEL: usize = 10;

/// Predictor of heights: the plane through three neighbours.
const PLANE: u8 = 0;
/// Predictor of heights: the median of two neighbours and their plane.
const MEDIAN: u8 = 1;

/// Why bytes are not a packed tile.
///
/// The messages don't name the file: whoever read it knows its name and says so in front.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum PackError {
    /// The first eight bytes are another format's.
    #[error(
        "it starts with \"{}\" where a packed tile starts with \"TSRPACK\\x00\"",
        found.escape_ascii()
    )]
    Magic {
        /// The bytes found, fewer than eight where there are no more.
        found: Vec<u8>,
    },
    /// Written by another version of this crate.
    #[error(
        "it is packed in version {found} where this program reads version {wanted}; pack the \
         terrain again"
    )]
    Version {
        /// Version found.
        found: u32,
        /// Version that this crate reads.
        wanted: u32,
    },
    /// More or fewer bytes than its header promises.
    #[error("it has {found} bytes where {wanted} belong")]
    Length {
        /// Bytes found.
        found: u64,
        /// Bytes promised, or that a header takes.
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
    /// The checksum is right and yet what is packed makes no tile.
    #[error("its {part} can't be unpacked: {reason}")]
    Content {
        /// Heights, densities or error bounds.
        part: &'static str,
        /// What is wrong with them.
        reason: String,
    },
}

impl TerrainTile {
    /// The tile in as few bytes as it takes, its address not among them. Mostly half a
    /// millisecond, and some milliseconds where heights follow their neighbours badly.
    #[must_use]
    pub fn pack(&self) -> Vec<u8> {
        let sections = [
            pack_heights(self.heights.samples()),
            pack_densities(self.densities.samples()),
            pack_errors(self.errors.texels()),
        ];
        let mut bytes =
            Vec::with_capacity(HEADER_LEN + sections.iter().map(Vec::len).sum::<usize>());
        bytes.extend_from_slice(&MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&self.stamp.to_le_bytes());
        for section in &sections {
            // A section has at most some bytes more than the numbers in it.
            bytes.extend_from_slice(&(section.len() as u32).to_le_bytes());
        }
        bytes.extend_from_slice(&[0; 4]);
        for section in &sections {
            bytes.extend_from_slice(section);
        }
        let checksum = checksum(&bytes);
        bytes[28..32].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }

    /// Reads what [`pack`](Self::pack) wrote.
    ///
    /// # Errors
    /// Where the bytes are short, damaged, or of another format or version. Nothing larger than a
    /// tile is allocated, whatever the bytes promise.
    pub fn unpack(bytes: &[u8]) -> Result<Self, PackError> {
        let found = bytes.get(..8).unwrap_or(bytes);
        if found != MAGIC {
            return Err(PackError::Magic {
                found: found.to_owned(),
            });
        }
        let number = |at: usize| {
            let four = bytes.get(at..at + 4).and_then(|four| four.try_into().ok());
            four.map(u32::from_le_bytes).ok_or(PackError::Length {
                found: bytes.len() as u64,
                wanted: HEADER_LEN as u64,
            })
        };
        let version = number(8)?;
        if version != VERSION {
            return Err(PackError::Version {
                found: version,
                wanted: VERSION,
            });
        }
        let stamp = number(12)?;
        let lengths = [number(16)?, number(20)?, number(24)?];
        let wanted = number(28)?;
        let promised = lengths.iter().map(|&length| u64::from(length)).sum::<u64>();
        if bytes.len() as u64 != HEADER_LEN as u64 + promised {
            return Err(PackError::Length {
                found: bytes.len() as u64,
                wanted: HEADER_LEN as u64 + promised,
            });
        }
        let found = checksum(bytes);
        if found != wanted {
            return Err(PackError::Checksum { found, wanted });
        }
        let (heights, rest) = bytes[HEADER_LEN..].split_at(lengths[0] as usize);
        let (densities, errors) = rest.split_at(lengths[1] as usize);
        Ok(Self {
            heights: unpack_heights(heights)?,
            densities: unpack_densities(densities)?,
            errors: unpack_errors(errors)?,
            stamp,
        })
    }
}

fn checksum(bytes: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&bytes[..28]);
    hasher.update(&bytes[HEADER_LEN..]);
    hasher.finalize()
}

/// Appends coded numbers.
fn code<T: Number>(numbers: &[T], out: &mut Vec<u8>) {
    let config = ChunkConfig::default()
        .with_compression_level(LEVEL)
        // The numbers are differences already.
        .with_delta_spec(DeltaSpec::NoOp)
        .with_mode_spec(ModeSpec::Classic)
        .with_enable_8_bit(true);
    let coded = pco::standalone::simple_compress(numbers, &config)
        .expect("the settings are valid, and memory doesn't refuse to be written");
    out.extend_from_slice(&coded);
}

/// Reads as many numbers as `out` has room for, no more and no less.
fn decode<T: Number>(bytes: &[u8], part: &'static str, out: &mut [T]) -> Result<(), PackError> {
    let wrong = |reason: String| PackError::Content { part, reason };
    let progress = pco::standalone::simple_decompress_into(bytes, out)
        .map_err(|error| wrong(error.to_string()))?;
    if progress.finished && progress.n_processed == out.len() {
        Ok(())
    } else {
        Err(wrong(format!("{} numbers belong there", out.len())))
    }
}

/// The front byte of a section, and the rest.
fn split_front<'a>(bytes: &'a [u8], part: &'static str) -> Result<(u8, &'a [u8]), PackError> {
    let (&front, rest) = bytes.split_first().ok_or_else(|| PackError::Content {
        part,
        reason: "there are none".to_owned(),
    })?;
    Ok((front, rest))
}

const fn fold(difference: u16) -> u16 {
    let signed = difference.cast_signed();
    ((signed << 1) ^ (signed >> 15)).cast_unsigned()
}

const fn unfold(folded: u16) -> u16 {
    (folded >> 1) ^ (folded & 1).wrapping_neg()
}

const fn fold_byte(difference: u8) -> u8 {
    let signed = difference.cast_signed();
    ((signed << 1) ^ (signed >> 7)).cast_unsigned()
}

const fn unfold_byte(folded: u8) -> u8 {
    (folded >> 1) ^ (folded & 1).wrapping_neg()
}

/// The median of `left`, `above` and the plane through them and `corner`, which lies above left.
fn median(left: i32, above: i32, corner: i32) -> i32 {
    let (low, high) = (left.min(above), left.max(above));
    (left + above - corner).clamp(low, high)
}

/// Differences to the plane; what lies outside counts as 0, and everything wraps.
fn plane_differences(samples: &[u16]) -> Vec<u16> {
    let mut out = Vec::with_capacity(SAMPLES);
    let zeros = [0; SIDE];
    let mut above: &[u16] = &zeros;
    for row in samples.chunks_exact(SIDE) {
        let mut before = 0_u16;
        for (&sample, &above) in row.iter().zip(above) {
            let step = sample.wrapping_sub(above);
            out.push(fold(step.wrapping_sub(before)));
            before = step;
        }
        above = row;
    }
    out
}

/// Turns folded differences to the plane into samples.
fn add_planes(numbers: &mut [u16]) {
    let mut above = [0_u16; SIDE];
    for row in numbers.chunks_exact_mut(SIDE) {
        let mut step = 0_u16;
        for (number, above) in row.iter_mut().zip(&mut above) {
            step = step.wrapping_add(unfold(*number));
            *above = above.wrapping_add(step);
            *number = *above;
        }
    }
}

/// Differences to the median; the first row's are to the left, the first column's to above.
fn median_differences(samples: &[u16]) -> Vec<u16> {
    let mut out = Vec::with_capacity(SAMPLES);
    let mut above: Option<&[u16]> = None;
    for row in samples.chunks_exact(SIDE) {
        let (mut left, mut corner) = (above.map_or(0, |row| row[0]), above.map_or(0, |row| row[0]));
        for (x, &sample) in row.iter().enumerate() {
            let over = above.map_or(left, |row| row[x]);
            if above.is_none() {
                corner = left;
            }
            let expected = median(left.into(), over.into(), corner.into()) as u16;
            out.push(fold(sample.wrapping_sub(expected)));
            (left, corner) = (sample, over);
        }
        above = Some(row);
    }
    out
}

/// Turns folded differences to the median into samples.
fn add_medians(numbers: &mut [u16]) {
    let (first, mut rest) = numbers.split_at_mut(SIDE);
    let mut left = 0_u16;
    for number in &mut *first {
        left = left.wrapping_add(unfold(*number));
        *number = left;
    }
    let mut above: &mut [u16] = first;
    while !rest.is_empty() {
        let (row, next) = rest.split_at_mut(SIDE);
        let (mut left, mut corner) = (i32::from(above[0]), i32::from(above[0]));
        for (number, &over) in row.iter_mut().zip(&*above) {
            let over = i32::from(over);
            let expected = median(left, over, corner) as u16;
            *number = expected.wrapping_add(unfold(*number));
            (left, corner) = (i32::from(*number), over);
        }
        (above, rest) = (row, next);
    }
}

fn pack_heights(samples: &[u16]) -> Vec<u8> {
    // Which of them codes shorter is known well enough from how many bits their differences have.
    let bits =
        |numbers: &[u16]| -> u32 { numbers.iter().map(|n| u16::BITS - n.leading_zeros()).sum() };
    let (plane, by_median) = (plane_differences(samples), median_differences(samples));
    let (predictor, numbers) = if bits(&plane) <= bits(&by_median) {
        (PLANE, plane)
    } else {
        (MEDIAN, by_median)
    };
    let mut out = vec![predictor];
    code(&numbers, &mut out);
    out
}

fn unpack_heights(bytes: &[u8]) -> Result<HeightTile, PackError> {
    const PART: &str = "heights";
    let (predictor, coded) = split_front(bytes, PART)?;
    let wrong = |reason: String| PackError::Content { part: PART, reason };
    let mut samples = vec![0; SAMPLES].into_boxed_slice();
    decode(coded, PART, &mut samples)?;
    match predictor {
        PLANE => add_planes(&mut samples),
        MEDIAN => add_medians(&mut samples),
        other => return Err(wrong(format!("there is no predictor {other}"))),
    }
    HeightTile::from_samples(samples).ok_or_else(|| wrong("too few".to_owned()))
}

/// What the texels before texel `at` let expect of it, in rows of `side` texels.
fn expected_texel(texels: &[u8], side: usize, at: usize) -> u8 {
    match (!at.is_multiple_of(side), at.checked_sub(side)) {
        (true, Some(above)) => median(
            texels[at - 1].into(),
            texels[above].into(),
            texels[above - 1].into(),
        ) as u8,
        (true, None) => texels[at - 1],
        (false, Some(above)) => texels[above],
        (false, None) => 0,
    }
}

/// Appends folded differences to the median.
fn texel_differences(texels: &[u8], side: usize, out: &mut Vec<u8>) {
    let difference = |at: usize| texels[at].wrapping_sub(expected_texel(texels, side, at));
    out.extend((0..texels.len()).map(|at| fold_byte(difference(at))));
}

/// Turns folded differences to the median into texels.
fn add_texels(numbers: &mut [u8], side: usize) {
    for at in 0..numbers.len() {
        numbers[at] = unfold_byte(numbers[at]).wrapping_add(expected_texel(numbers, side, at));
    }
}

fn pack_densities(texels: &[u8]) -> Vec<u8> {
    let mut folded = Vec::with_capacity(texels.len());
    texel_differences(texels, DENSITY_SIDE, &mut folded);
    let mut out = Vec::new();
    code(&folded, &mut out);
    out
}

fn unpack_densities(bytes: &[u8]) -> Result<DensityTile, PackError> {
    const PART: &str = "densities";
    let mut texels = vec![0; DENSITY_SIDE * DENSITY_SIDE].into_boxed_slice();
    decode(bytes, PART, &mut texels)?;
    add_texels(&mut texels, DENSITY_SIDE);
    DensityTile::from_samples(texels).ok_or_else(|| PackError::Content {
        part: PART,
        reason: "too few".to_owned(),
    })
}

fn pack_errors(texels: &[[u8; ERROR_BYTES]]) -> Vec<u8> {
    let any = |spacing: &usize| texels.iter().any(|texel| texel[*spacing] != 0);
    let spacings = (0..ERROR_BYTES).rev().find(any).map_or(0, |last| last + 1);
    let mut out = vec![spacings as u8];
    let mut folded = Vec::with_capacity(spacings * ERROR_TEXELS);
    for spacing in 0..spacings {
        let bounds: Vec<u8> = texels.iter().map(|texel| texel[spacing]).collect();
        texel_differences(&bounds, ERROR_SIDE, &mut folded);
    }
    if spacings > 0 {
        code(&folded, &mut out);
    }
    out
}

fn unpack_errors(bytes: &[u8]) -> Result<ErrorTile, PackError> {
    const PART: &str = "error bounds";
    let wrong = |reason: String| PackError::Content { part: PART, reason };
    let (spacings, coded) = split_front(bytes, PART)?;
    let spacings = usize::from(spacings);
    if spacings > ERROR_BYTES || (spacings == 0 && !coded.is_empty()) {
        return Err(wrong(format!("there can't be {spacings} spacings")));
    }
    let mut texels = vec![[0; ERROR_BYTES]; ERROR_TEXELS].into_boxed_slice();
    let mut bounds = [0; ERROR_BYTES * ERROR_TEXELS];
    let bounds = &mut bounds[..spacings * ERROR_TEXELS];
    if spacings > 0 {
        decode(coded, PART, bounds)?;
    }
    for (spacing, bounds) in bounds.chunks_exact_mut(ERROR_TEXELS).enumerate() {
        add_texels(bounds, ERROR_SIDE);
        for (texel, &bound) in texels.iter_mut().zip(&*bounds) {
            texel[spacing] = bound;
        }
    }
    ErrorTile::from_texels(texels).ok_or_else(|| wrong("too few".to_owned()))
}
