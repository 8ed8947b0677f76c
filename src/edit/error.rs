//! What an edit has to be like.

use super::{Change, EDIT_UNITS, Edit, MAX_REACH, MIN_REACH, StampImage};
use thiserror::Error;

/// The furthest that an edit's centre lies from the terrain's corner, less its reach.
const FURTHEST: i64 = 1 << 30;
/// Samples along the side of an image, at least and at most.
const IMAGE_SIDES: std::ops::RangeInclusive<u16> = 2..=1024;
/// The most points of a captured grid.
const MAX_CAPTURED: usize = 1 << 20;
/// The most samples of level 0 between points of a captured grid, as a power of two.
const MAX_CAPTURED_SPACING: u8 = 12;
/// How far the square of a direction's length may be from that of 2^14: more than what rounding does.
const DIRECTION_TOLERANCE: i64 = 1 << 16;

/// Why an edit can't be applied to any terrain.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum InvalidEdit {
    /// The reach is too small or too large.
    #[error(
        "the edit reaches {found} units from its centre where {MIN_REACH} to {MAX_REACH} are \
         possible ({EDIT_UNITS} make a sample); make it larger or smaller"
    )]
    Reach {
        /// The reach found.
        found: u32,
    },
    /// The centre is further away than any terrain is large.
    #[error(
        "the edit's centre {found:?} lies beyond any terrain; at most 2^30 units and the reach from \
         0 are possible ({EDIT_UNITS} make a sample)"
    )]
    Centre {
        /// The centre found.
        found: [i32; 2],
    },
    /// A number that can't be.
    #[error("the edit has {name} = {found} where {wanted} is wanted")]
    Number {
        /// The field.
        name: &'static str,
        /// Its value.
        found: i64,
        /// What it may be.
        wanted: &'static str,
    },
    /// An image or a grid holds more or fewer samples than its size says.
    #[error("the edit's {name} holds {found} samples where its size says {wanted}")]
    Samples {
        /// The field.
        name: &'static str,
        /// Samples found.
        found: usize,
        /// Samples that the size promises.
        wanted: usize,
    },
    /// An image that isn't square.
    #[error("the image has {width} x {height} pixels; a stamp takes square ones")]
    NotSquare {
        /// Pixels in x.
        width: u32,
        /// Pixels in y.
        height: u32,
    },
    /// An image whose pixels can't be read.
    #[error("the image can't be made a stamp: {reason}")]
    Image {
        /// Why.
        reason: String,
    },
}

impl Edit {
    /// Checks that the numbers make sense together, so that whatever applies the edit may count on
    /// it, on any terrain. Whoever reads edits from files or from other machines calls this. Looks at
    /// every sample of an image.
    ///
    /// # Errors
    /// For a reach outside [`MIN_REACH`]`..=`[`MAX_REACH`], a centre further than 2^30 units and the
    /// reach from 0, and fields that don't keep to what [`Change`] says of them.
    pub fn validate(&self) -> Result<(), InvalidEdit> {
        if !(MIN_REACH..=MAX_REACH).contains(&self.reach) {
            return Err(InvalidEdit::Reach { found: self.reach });
        }
        let furthest = FURTHEST + i64::from(self.reach);
        if self.centre.iter().any(|&at| i64::from(at).abs() > furthest) {
            return Err(InvalidEdit::Centre { found: self.centre });
        }
        let number = |name, found: i64, good: bool, wanted| {
            if good {
                Ok(())
            } else {
                Err(InvalidEdit::Number {
                    name,
                    found,
                    wanted,
                })
            }
        };
        let amount = |by: i32| {
            let good = by.unsigned_abs() <= u32::from(u16::MAX);
            number("by", by.into(), good, "-65535 to 65535")
        };
        let limits = |least: i32, most: i32| {
            let range = -i32::from(u16::MAX)..=i32::from(u16::MAX);
            let good = least <= 0 && range.contains(&least);
            number("least", least.into(), good, "-65535 to 0")?;
            let good = most >= 0 && range.contains(&most);
            number("most", most.into(), good, "0 to 65535")
        };
        match &self.change {
            Change::Crater { bowl, .. } => {
                number("bowl", i64::from(*bowl), *bowl > 0, "1 to 65535")
            }
            Change::Raise { by, .. } => amount(*by),
            Change::Flatten { least, most, .. } => limits(*least, *most),
            Change::Smooth {
                ground,
                least,
                most,
                ..
            } => {
                limits(*least, *most)?;
                let log2 = ground.spacing_log2;
                let good = log2 <= MAX_CAPTURED_SPACING;
                number("spacing_log2", log2.into(), good, "0 to 12")?;
                let wanted: usize = ground.size.map(usize::from).iter().product();
                let good = (1..=MAX_CAPTURED).contains(&wanted);
                number(
                    "the captured grid's size",
                    wanted as i64,
                    good,
                    "1 to 2^20 points",
                )?;
                samples("captured grid", ground.heights.len(), wanted)
            }
            Change::Stamp {
                image, by, turn, ..
            } => {
                amount(*by)?;
                let [x, z] = turn.map(i64::from);
                let square = x * x + z * z;
                let good = (square - (1 << 28)).abs() <= DIRECTION_TOLERANCE;
                number("turn's squared length", square, good, "2^28")?;
                image.validate()
            }
        }
    }
}

impl StampImage {
    /// Checks the image's size and every sample of it.
    pub(super) fn validate(&self) -> Result<(), InvalidEdit> {
        let side = self.side;
        if !IMAGE_SIDES.contains(&side) {
            return Err(InvalidEdit::Number {
                name: "the image's side",
                found: side.into(),
                wanted: "2 to 1024",
            });
        }
        let wanted = usize::from(side) * usize::from(side);
        samples("image", self.samples.len(), wanted)?;
        if self.samples.contains(&i16::MIN) {
            return Err(InvalidEdit::Number {
                name: "an image's sample",
                found: i16::MIN.into(),
                wanted: "-32767 to 32767",
            });
        }
        Ok(())
    }
}

fn samples(name: &'static str, found: usize, wanted: usize) -> Result<(), InvalidEdit> {
    if found == wanted {
        Ok(())
    } else {
        Err(InvalidEdit::Samples {
            name,
            found,
            wanted,
        })
    }
}
