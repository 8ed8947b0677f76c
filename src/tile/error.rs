//! Bounds on what triangles leave of one tile's ground.

use super::{DENSITY_TEXELS, ERROR_SPACINGS, TileAddress, TileFormatError, TileKind, format};
use std::sync::Arc;

const OWN: usize = DENSITY_TEXELS as usize;
const BYTES: usize = 8;

/// Bounds on the vertical error that triangles leave, for each of one tile's own 32 × 32 texels.
/// There is no border: whoever needs a neighbour's texel asks the neighbour.
///
/// Byte `k < 7` of a texel bounds, [encoded](encode_error), the error of every triangle that meets
/// the texel's square and whose edges are no longer than `2^k` samples of the tile's level in plan;
/// [`error_bound::bound`](crate::error_bound::bound) reads it at any spacing. The eighth byte is 0.
/// Bytes of a texel don't fall. A parent's byte `k` is at least its children's `k + 1`, which stands
/// for the same distance on the ground. Texels beyond the terrain are 0.
///
/// Takes 8 KiB.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ErrorTile {
    /// Shared by all clones until one is changed.
    texels: Arc<[[u8; BYTES]]>,
}

impl ErrorTile {
    /// A tile of 32 × 32 `texels` in row order; `None` where there are more or fewer.
    #[must_use]
    pub fn from_texels(texels: Box<[[u8; BYTES]]>) -> Option<Self> {
        (texels.len() == OWN * OWN).then(|| Self {
            texels: texels.into(),
        })
    }

    /// The tile of ground without any relief: all bounds are 0.
    #[must_use]
    pub fn flat() -> Self {
        Self {
            texels: vec![[0; BYTES]; OWN * OWN].into(),
        }
    }

    /// All texels, row by row.
    #[must_use]
    pub fn texels(&self) -> &[[u8; BYTES]] {
        &self.texels
    }

    /// All texels, to be changed.
    #[must_use]
    pub fn texels_mut(&mut self) -> &mut [[u8; BYTES]] {
        Arc::make_mut(&mut self.texels)
    }

    /// The texel in column `x` and row `z`, `0..32` each.
    ///
    /// # Panics
    /// Where `x` or `z` is 32 or more.
    #[must_use]
    pub fn get(&self, x: u32, z: u32) -> [u8; BYTES] {
        let (column, row) = (x as usize, z as usize);
        assert!(
            column < OWN && row < OWN,
            "an error tile has no texel ({x}, {z})"
        );
        self.texels[row * OWN + column]
    }

    /// The bytes of this tile's section: 36 of header, then the texels.
    #[must_use]
    pub fn encode(&self, address: TileAddress, stamp: u32) -> Vec<u8> {
        let numbers = [u32::from(address.level), address.x, address.z];
        let mut bytes = format::start(TileKind::Error, numbers, stamp, OWN * OWN * BYTES);
        bytes.extend_from_slice(self.texels.as_flattened());
        format::finish(bytes)
    }

    /// Reads what [`encode`](Self::encode) wrote, alone or beside the tile's other sections.
    ///
    /// # Errors
    /// Where the bytes are short, damaged, of another format or version, or another tile's than
    /// `expected`.
    pub fn decode(bytes: &[u8], expected: TileAddress) -> Result<Self, TileFormatError> {
        Self::decode_stamped(bytes, expected).map(|(tile, _)| tile)
    }

    /// [`decode`](Self::decode), with the stamp of the terrain that the section belongs to.
    pub(crate) fn decode_stamped(
        bytes: &[u8],
        expected: TileAddress,
    ) -> Result<(Self, u32), TileFormatError> {
        let (stamp, payload) =
            format::open_tile(bytes, TileKind::Error, expected, OWN * OWN * BYTES)?;
        let (texels, _) = payload.as_chunks::<BYTES>();
        let tile = Self {
            texels: texels.into(),
        };
        Ok((tile, stamp))
    }
}

/// Parts of a stored height's step that a [decoded](decode_error) error counts.
pub const ERROR_UNIT: u32 = 64;

/// The least byte that stands for an error of at least `error`, in 64ths of a stored height's step.
/// Never rounds down, and up by less than an eighth (small errors: to an eighth of a step).
#[must_use]
pub const fn encode_error(error: u32) -> u8 {
    if error == 0 {
        return 0;
    }
    // The exponent at which 8 + m has to be at most 15.
    let mut exponent = (u32::BITS - error.leading_zeros()).saturating_sub(4);
    let mut mantissa = error.div_ceil(1 << exponent);
    if mantissa > 15 {
        exponent += 1;
        mantissa = 8;
    }
    let above_8 = mantissa.saturating_sub(8);
    (1 + (exponent << 3) + above_8) as u8
}

/// The error that a stored byte stands for, in 64ths of a stored height's step: 0 for 0, otherwise
/// `(8 + m) · 2^e` with `m` the lower three bits and `e` the upper five of the byte less one.
/// `u32::MAX` where that doesn't fit, which no bake writes.
#[must_use]
pub const fn decode_error(byte: u8) -> u32 {
    if byte == 0 {
        return 0;
    }
    let (exponent, mantissa) = ((byte - 1) >> 3, (byte - 1) & 7);
    let error = (8 + mantissa as u64) << exponent;
    if error > u32::MAX as u64 {
        u32::MAX
    } else {
        error as u32
    }
}

const _: () = assert!(ERROR_SPACINGS < BYTES);
