//! What an edit is, in integers.

use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Units in which edits count horizontal distances, per sample of level 0.
pub const EDIT_UNITS: i32 = 64;
/// The furthest that an edit reaches from its centre, in units: 512 samples of level 0.
pub const MAX_REACH: u32 = 512 * EDIT_UNITS as u32;
/// The least reach of an edit, in units: one sample of level 0.
pub const MIN_REACH: u32 = EDIT_UNITS as u32;

/// A change of the ground as the log holds it. Games make one from a
/// command in metres, which captures whatever depends on the ground.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Edit {
    /// Centre in x and z, in [`EDIT_UNITS`]. May lie beyond the terrain.
    pub centre: [i32; 2],
    /// No sample of level 0 further than this from the centre changes, in [`EDIT_UNITS`];
    /// [`MIN_REACH`]`..=`[`MAX_REACH`].
    pub reach: u32,
    /// What it does there.
    pub change: Change,
}

/// What an edit does to the ground around its centre. Heights and differences of heights are stored
/// units ([`ManifestFile::height_step_m`](crate::terrain::ManifestFile::height_step_m)).
///
/// `may_clamp` says that the sum may leave `0..=65535` somewhere; it is cut off there anyway, but the
/// error bounds trust that it doesn't happen where this is `false`.
///
/// `density` is what texels that the edit's disc meets have at least from then on.
///
/// `scorch` is how strongly the destruction mask shows it.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Change {
    /// A bowl with a rim around it, which is added to the ground.
    Crater {
        /// How much lower the centre gets.
        depth: u16,
        /// How much higher the rim's crest gets.
        rim: u16,
        /// Radius of the bowl, where it crosses the ground, over [`Edit::reach`], of 65536.
        bowl: u16,
        /// How rough the outline is: the most by which the noise changes the distance from the
        /// centre, of 256.
        roughness: u8,
        /// What the noise is made of.
        seed: u32,
        /// See above.
        density: u8,
        /// See above.
        scorch: u8,
        /// See above.
        may_clamp: bool,
    },
    /// A smooth hill that is added to the ground (a hollow, where `by` is negative).
    Raise {
        /// How much higher the centre gets.
        by: i32,
        /// The part of the reach within which the change is whole, of 256. Beyond, it falls to
        /// nothing smoothly.
        hardness: u8,
        /// See above.
        density: u8,
        /// See above.
        may_clamp: bool,
    },
    /// Draws the ground to one height.
    Flatten {
        /// The height.
        to: u16,
        /// How far it is drawn there, of 65535.
        strength: u16,
        /// As in [`Change::Raise`].
        hardness: u8,
        /// No sample changes by less (it is 0 or negative), or by more (0 or positive): the most
        /// that was needed when the edit was made, so that it is known without the ground.
        least: i32,
        /// See `least`.
        most: i32,
    },
    /// Draws the ground to what it was on a coarser grid when the edit was made.
    Smooth {
        /// The ground on that grid.
        ground: CapturedGround,
        /// How far it is drawn there, of 65535.
        strength: u16,
        /// As in [`Change::Raise`].
        hardness: u8,
        /// As in [`Change::Flatten`].
        least: i32,
        /// As in [`Change::Flatten`].
        most: i32,
    },
    /// Adds an image to the ground. The image's corners lie on the circle of [`Edit::reach`], so
    /// that it may be turned without reaching further; between its samples it is bilinear, and
    /// outside 0.
    Stamp {
        /// The image.
        image: StampImage,
        /// What a sample of 32767 adds; one of -32767 takes as much away.
        by: i32,
        /// Where the image's x axis points, as a direction in x and z of length 2^14.
        turn: [i16; 2],
        /// See above.
        density: u8,
        /// See above.
        scorch: u8,
        /// See above.
        may_clamp: bool,
    },
}

/// Heights of the ground on a coarse grid, as they were when an edit was made.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct CapturedGround {
    /// The level 0 sample of the grid's first point, in x and z.
    pub first: [i32; 2],
    /// Samples of level 0 between points, as a power of two.
    pub spacing_log2: u8,
    /// Points in x and z.
    pub size: [u16; 2],
    /// Stored heights, row by row.
    #[serde(with = "super::compact::samples")]
    pub heights: Arc<[u16]>,
}

/// A square image that edits of an image stamp share.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct StampImage {
    /// Samples a side, 2 to 1024.
    pub side: u16,
    /// Samples row by row, from -32767 to 32767.
    #[serde(with = "super::compact::samples")]
    pub samples: Arc<[i16]>,
}

impl Change {
    /// No sample of any level changes by less, or by more: 0 or negative, and 0 or positive.
    #[must_use]
    pub fn limits(&self) -> (i32, i32) {
        match *self {
            Self::Crater { depth, rim, .. } => (-i32::from(depth), rim.into()),
            Self::Raise { by, .. } => (by.min(0), by.max(0)),
            Self::Flatten { least, most, .. } | Self::Smooth { least, most, .. } => (least, most),
            Self::Stamp { by, .. } => (-by.abs(), by.abs()),
        }
    }
}

impl StampImage {
    /// An image of `side` × `side` samples, row by row, -32767 to 32767.
    ///
    /// # Errors
    /// For a side outside 2 to 1024, another number of samples, and samples of -32768.
    pub fn new(side: u16, samples: impl Into<Arc<[i16]>>) -> Result<Self, super::InvalidEdit> {
        let image = Self {
            side,
            samples: samples.into(),
        };
        image.validate()?;
        Ok(image)
    }

    /// An image of grey values, row by row: 0 changes nothing, 255 is a full sample.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn from_grey8(side: u16, grey: &[u8]) -> Result<Self, super::InvalidEdit> {
        let samples = grey
            .iter()
            .map(|&grey| (i32::from(grey) * 32_767 / 255) as i16);
        Self::new(side, samples.collect::<Vec<_>>())
    }

    /// An image of 16-bit grey values, row by row: 0 changes nothing, 65535 is a full sample.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn from_grey16(side: u16, grey: &[u16]) -> Result<Self, super::InvalidEdit> {
        let samples = grey.iter().map(|&grey| (grey >> 1) as i16);
        Self::new(side, samples.collect::<Vec<_>>())
    }

    /// The brightness of a Bevy image that is in main memory: black changes nothing, white is a full
    /// sample.
    ///
    /// # Errors
    /// For an image that isn't square or in main memory, of 2 to 1024 pixels a side, or whose pixels
    /// have a format that can't be read one by one.
    #[cfg(feature = "render")]
    pub fn from_image(image: &bevy::image::Image) -> Result<Self, super::InvalidEdit> {
        let (width, height) = (image.width(), image.height());
        if width != height {
            return Err(super::InvalidEdit::NotSquare { width, height });
        }
        let side = u16::try_from(width).unwrap_or(u16::MAX);
        let mut samples = Vec::new();
        if (2..=1024).contains(&side) {
            for (x, z) in (0..height).flat_map(|z| (0..width).map(move |x| (x, z))) {
                let color =
                    image
                        .get_color_at(x, z)
                        .map_err(|error| super::InvalidEdit::Image {
                            reason: error.to_string(),
                        })?;
                let bright = bevy::color::Luminance::luminance(&color).clamp(0.0, 1.0);
                samples.push((bright * 32_767.0).round() as i16);
            }
        }
        Self::new(side, samples)
    }
}

impl Edit {
    /// The part of level 0 that may change, in samples: those at most the reach from the centre.
    #[must_use]
    pub fn rect(&self) -> super::SampleRect {
        let reach = self.reach as i32;
        let low = |at: i32| (at.saturating_sub(reach)).div_euclid(EDIT_UNITS);
        let high = |at: i32| (at.saturating_add(reach)).div_euclid(EDIT_UNITS) + 1;
        super::SampleRect::new(self.centre.map(low), self.centre.map(high))
    }
}
