//! From a source's rows to stored heights.

use super::fill::Fill;
use super::{BakeError, CodeMapping, HeightSource, MAX_HEIGHT_M};
use rayon::prelude::*;
use std::ops::{Range, RangeInclusive};

/// Rows as a source gives them.
pub(super) struct RawBand {
    /// The source's row that comes first.
    pub(super) first_row: u32,
    width: usize,
    values: RawValues,
}

enum RawValues {
    Codes(Vec<u16>),
    Metres(Vec<f32>),
}

impl RawBand {
    pub(super) fn samples(&self) -> u64 {
        match &self.values {
            RawValues::Codes(values) => values.len() as u64,
            RawValues::Metres(values) => values.len() as u64,
        }
    }
}

/// Rows as the pyramid takes them.
pub(super) struct ConvertedBand {
    /// Stored heights.
    pub(super) heights: Vec<Vec<u16>>,
    /// Samples that lay outside the range.
    pub(super) clamped: u64,
}

/// Reads a source band by band.
pub(super) struct BandReader<'a> {
    source: &'a mut dyn HeightSource,
    fill: &'a Fill,
    bands: Bands,
    next_row: u32,
    as_codes: bool,
}

/// Which rows of a source are read, and how many at once.
#[derive(Clone, Debug)]
pub(super) struct Bands {
    pub(super) rows: Range<u32>,
    /// The most rows of a band.
    pub(super) at_once: u32,
    /// No band reaches over a multiple of so many rows.
    pub(super) unit: u32,
}

impl<'a> BandReader<'a> {
    /// Goes to the first of the rows.
    pub(super) fn new(
        source: &'a mut dyn HeightSource,
        fill: &'a Fill,
        quantiser: &Quantiser,
        bands: Bands,
    ) -> Result<Self, BakeError> {
        source.rewind()?;
        if bands.rows.start > 0 {
            source.skip_rows(bands.rows.start)?;
        }
        // What has to be filled in is no code.
        let as_codes = quantiser.codes.is_some() && fill.is_empty();
        Ok(Self {
            source,
            fill,
            next_row: bands.rows.start,
            bands,
            as_codes,
        })
    }

    /// The next rows, or `None` after the last.
    pub(super) fn read(&mut self) -> Result<Option<RawBand>, BakeError> {
        let first_row = self.next_row;
        let Bands {
            rows,
            at_once,
            unit,
        } = &self.bands;
        let rows = (*at_once)
            .min(rows.end - first_row)
            .min(unit - first_row % unit) as usize;
        if rows == 0 {
            return Ok(None);
        }
        let width = self.source.size()[0] as usize;
        let values = if self.as_codes {
            let mut values = vec![0_u16; rows * width];
            for row in values.chunks_exact_mut(width) {
                self.source.read_codes(row)?;
            }
            RawValues::Codes(values)
        } else {
            let mut values = vec![0_f32; rows * width];
            for (row, z) in values.chunks_exact_mut(width).zip(self.next_row..) {
                self.source.read_row(row)?;
                check_row(self.source, row, z)?;
                self.fill.apply(row, z);
            }
            RawValues::Metres(values)
        };
        self.next_row += rows as u32;
        Ok(Some(RawBand {
            first_row,
            width,
            values,
        }))
    }
}

/// Refuses what is no height: infinities, and numbers beyond all mountains.
pub(super) fn check_row(source: &dyn HeightSource, row: &[f32], z: u32) -> Result<(), BakeError> {
    // A comparison with NaN is false, which lets samples without data pass.
    let bad = |height: &f32| height.abs() > MAX_HEIGHT_M as f32;
    if !row.iter().fold(false, |any, height| any | bad(height)) {
        return Ok(());
    }
    let x = row.iter().position(bad).unwrap_or_default();
    let (name, found) = (source.name(), row[x]);
    let x = x as u32;
    Err(if found.is_infinite() {
        BakeError::Infinite { name, x, z }
    } else {
        BakeError::Implausible { name, x, z, found }
    })
}

/// Turns heights in metres, or codes, into stored heights.
pub(super) struct Quantiser {
    low: f64,
    step: f64,
    codes: Option<CodeTable>,
}

/// Every code's stored height: a look-up is the fastest conversion there is, and the
/// same numbers come out as from metres.
struct CodeTable {
    heights: Box<[u16]>,
    /// Whether the code lies outside the range; `None` where no code does.
    clamped: Option<Box<[bool]>>,
}

impl Quantiser {
    pub(super) fn new(range: &RangeInclusive<f64>, codes: Option<CodeMapping>) -> Self {
        let low = *range.start();
        let mut quantiser = Self {
            low,
            step: (range.end() - low) / f64::from(u16::MAX),
            codes: None,
        };
        quantiser.codes = codes.map(|mapping| {
            let converted: Vec<_> = (0..=u16::MAX)
                .map(|code| quantiser.sample(mapping.sample(code)))
                .collect();
            CodeTable {
                heights: converted.iter().map(|sample| sample.0).collect(),
                clamped: converted
                    .iter()
                    .any(|sample| sample.1)
                    .then(|| converted.iter().map(|sample| sample.1).collect()),
            }
        });
        quantiser
    }

    pub(super) fn low_m(&self) -> f64 {
        self.low
    }

    pub(super) fn step_m(&self) -> f64 {
        self.step
    }

    /// Stored height, and whether the height lay outside the range by more than rounding.
    fn sample(&self, height_m: f32) -> (u16, bool) {
        let wanted = (f64::from(height_m) - self.low) / self.step;
        let top = f64::from(u16::MAX);
        let kept = wanted.clamp(0.0, top);
        let outside = wanted < -0.5 || wanted > top + 0.5;
        ((kept + 0.5) as u16, outside)
    }

    pub(super) fn convert(&self, band: &RawBand) -> ConvertedBand {
        let width = band.width;
        let rows: Vec<(Vec<u16>, u64)> = match (&band.values, &self.codes) {
            (RawValues::Codes(values), Some(table)) => values
                .par_chunks_exact(width)
                .map(|row| table.convert(row))
                .collect(),
            (RawValues::Metres(values), _) => values
                .par_chunks_exact(width)
                .map(|row| {
                    let mut clamped = 0;
                    let heights = row.iter().map(|&height_m| {
                        let (height, outside) = self.sample(height_m);
                        clamped += u64::from(outside);
                        height
                    });
                    (heights.collect(), clamped)
                })
                .collect(),
            (RawValues::Codes(_), None) => Vec::new(),
        };
        let mut band = ConvertedBand {
            heights: Vec::with_capacity(rows.len()),
            clamped: 0,
        };
        for (heights, clamped) in rows {
            band.heights.push(heights);
            band.clamped += clamped;
        }
        band
    }
}

impl CodeTable {
    fn convert(&self, row: &[u16]) -> (Vec<u16>, u64) {
        let heights = row.iter().map(|&code| self.heights[usize::from(code)]);
        let clamped = self.clamped.as_ref().map_or(0, |clamped| {
            let outside = |code: &&u16| clamped[usize::from(**code)];
            row.iter().filter(outside).count() as u64
        });
        (heights.collect(), clamped)
    }
}
