//! Samples without data: found in a first reading, filled from their surroundings.
//!
//! Filling is by pull and push: means of ever larger blocks of the samples that have data are
//! taken until one block is left, and then every block without data takes the smooth blend of the
//! larger ones around it. Small gaps are bridged from their rims, large ones sink into a smooth
//! membrane; a sample that has data never changes.
//!
//! The blocks are kept in memory. Up to [`MAX_CELLS`] samples (4096²) the smallest block is a
//! sample. Beyond, it is the power of two a side that keeps the number of blocks below that, and
//! the rim of a gap can show a step as high as the ground rises within one block; the report says
//! which size was used.

use super::quantise::check_row;
use super::{BakeError, BakeProgress, BakeStage, HeightSource};

/// The most blocks that are held: 180 MiB of them, their means included.
const MAX_CELLS: u64 = 1 << 24;
/// Samples between two reports of progress.
const REPORT_SAMPLES: u64 = 1 << 20;

/// What a first reading found.
pub(super) struct Survey {
    /// Lowest and highest height in metres; `None` where it wasn't looked for or nothing has data.
    pub(super) heights_m: Option<(f64, f64)>,
    /// Samples without data.
    pub(super) no_data: u64,
}

/// Reads the source where its range is wanted or some of its samples may lack data.
pub(super) fn survey(
    source: &mut dyn HeightSource,
    want_range: bool,
    progress: &dyn BakeProgress,
) -> Result<Survey, BakeError> {
    if !want_range && !source.may_lack_data() {
        return Ok(Survey {
            heights_m: None,
            no_data: 0,
        });
    }
    progress.stage(BakeStage::Survey, samples(source));
    source.rewind()?;
    let [width, height] = source.size();
    let mut report = Report::new(progress, width);
    if let Some(codes) = source.codes() {
        let mut row = vec![0_u16; width as usize];
        let (mut low, mut high, mut no_data) = (u16::MAX, u16::MIN, 0_u64);
        for _ in 0..height {
            source.read_codes(&mut row)?;
            match codes.no_data {
                // A loop per case, so that each is as fast as memory.
                None => {
                    for &code in &row {
                        low = low.min(code);
                        high = high.max(code);
                    }
                }
                Some(missing) => {
                    for &code in &row {
                        let lacks = code == missing;
                        no_data += u64::from(lacks);
                        low = low.min(if lacks { u16::MAX } else { code });
                        high = high.max(if lacks { u16::MIN } else { code });
                    }
                }
            }
            report.row();
        }
        // As the source itself rounds them, so that no sample lies outside.
        let (a, b) = [low, high]
            .map(|code| f64::from((codes.scale_m * f64::from(code) + codes.offset_m) as f32))
            .into();
        let any = no_data < samples(source);
        return Ok(Survey {
            heights_m: any.then(|| (a.min(b), a.max(b))),
            no_data,
        });
    }
    let mut row = vec![0_f32; width as usize];
    let (mut low, mut high, mut no_data) = (f32::INFINITY, f32::NEG_INFINITY, 0_u64);
    for z in 0..height {
        source.read_row(&mut row)?;
        check_row(source, &row, z)?;
        for &sample in &row {
            no_data += u64::from(sample.is_nan());
            // `min` and `max` pass over NaN.
            low = low.min(sample);
            high = high.max(sample);
        }
        report.row();
    }
    Ok(Survey {
        heights_m: (low <= high).then(|| (low.into(), high.into())),
        no_data,
    })
}

fn samples(source: &dyn HeightSource) -> u64 {
    let [width, height] = source.size();
    u64::from(width) * u64::from(height)
}

/// Tells progress every so often instead of every row.
struct Report<'a> {
    progress: &'a dyn BakeProgress,
    width: u64,
    pending: u64,
}

impl<'a> Report<'a> {
    fn new(progress: &'a dyn BakeProgress, width: u32) -> Self {
        Self {
            progress,
            width: width.into(),
            pending: 0,
        }
    }

    fn row(&mut self) {
        self.pending += self.width;
        if self.pending >= REPORT_SAMPLES {
            self.progress.advance(std::mem::take(&mut self.pending));
        }
    }
}

/// Means of square blocks, and how much of each is known.
struct Cells {
    size: [usize; 2],
    values: Vec<f32>,
    weights: Vec<f32>,
}

impl Cells {
    fn new(size: [usize; 2]) -> Self {
        let cells = size[0] * size[1];
        Self {
            size,
            values: vec![0.0; cells],
            weights: vec![0.0; cells],
        }
    }

    /// Blocks of twice the side.
    fn pull(&self) -> Self {
        let mut coarse = Self::new(self.size.map(|side| side.div_ceil(2)));
        for z in 0..coarse.size[1] {
            for x in 0..coarse.size[0] {
                let (mut sum, mut weight) = (0.0, 0.0);
                for fine_z in 2 * z..(2 * z + 2).min(self.size[1]) {
                    for fine_x in 2 * x..(2 * x + 2).min(self.size[0]) {
                        let at = fine_z * self.size[0] + fine_x;
                        sum += self.values[at] * self.weights[at];
                        weight += self.weights[at];
                    }
                }
                if weight > 0.0 {
                    let at = z * coarse.size[0] + x;
                    coarse.values[at] = sum / weight;
                    coarse.weights[at] = weight.min(1.0);
                }
            }
        }
        coarse
    }

    /// Completes what isn't fully known from blocks of twice the side that are.
    fn push(&mut self, coarse: &Self) {
        for z in 0..self.size[1] {
            for x in 0..self.size[0] {
                let at = z * self.size[0] + x;
                let weight = self.weights[at];
                if weight < 1.0 {
                    let blend =
                        coarse.blend((x as f32 + 0.5) * 0.5 - 0.5, (z as f32 + 0.5) * 0.5 - 0.5);
                    self.values[at] = self.values[at] * weight + blend * (1.0 - weight);
                }
            }
        }
    }

    /// Bilinear value, cell centres lying on whole numbers.
    fn blend(&self, x: f32, z: f32) -> f32 {
        let axis = |at: f32, count: usize| {
            let at = at.clamp(0.0, (count - 1) as f32);
            let first = at as usize;
            (first, (first + 1).min(count - 1), at - first as f32)
        };
        let (x0, x1, u) = axis(x, self.size[0]);
        let (z0, z1, v) = axis(z, self.size[1]);
        let value = |x: usize, z: usize| self.values[z * self.size[0] + x];
        let above = value(x0, z0) * (1.0 - u) + value(x1, z0) * u;
        let below = value(x0, z1) * (1.0 - u) + value(x1, z1) * u;
        above * (1.0 - v) + below * v
    }
}

/// What samples without data are filled with.
pub(super) struct Fill {
    /// `None` where every sample has data.
    cells: Option<Cells>,
    block: u32,
}

impl Fill {
    /// Reads the source again where the survey found samples without data.
    pub(super) fn build(
        source: &mut dyn HeightSource,
        survey: &Survey,
        progress: &dyn BakeProgress,
    ) -> Result<Self, BakeError> {
        let [width, height] = source.size();
        if survey.no_data == 0 {
            return Ok(Self {
                cells: None,
                block: 1,
            });
        }
        progress.stage(BakeStage::Fill, samples(source));
        source.rewind()?;
        let block = block_for([width, height]);
        let mut cells = Cells::new([width, height].map(|side| side.div_ceil(block) as usize));
        let mut report = Report::new(progress, width);
        let mut row = vec![0_f32; width as usize];
        for z in 0..height {
            source.read_row(&mut row)?;
            check_row(source, &row, z)?;
            let first = (z / block) as usize * cells.size[0];
            for (x, &sample) in row.iter().enumerate() {
                if !sample.is_nan() {
                    let at = first + x / block as usize;
                    cells.values[at] += sample;
                    cells.weights[at] += 1.0;
                }
            }
            report.row();
        }
        for (value, weight) in cells.values.iter_mut().zip(&mut cells.weights) {
            if *weight > 0.0 {
                *value /= *weight;
                *weight = 1.0;
            }
        }
        let mut levels = vec![cells];
        while let Some(finest) = levels.last().filter(|level| level.size != [1, 1]) {
            let coarser = finest.pull();
            levels.push(coarser);
        }
        let mut filled = levels.pop().unwrap_or_else(|| Cells::new([1, 1]));
        while let Some(mut finer) = levels.pop() {
            finer.push(&filled);
            filled = finer;
        }
        filled.weights = Vec::new();
        Ok(Self {
            cells: Some(filled),
            block,
        })
    }

    /// Whether there is nothing to fill.
    pub(super) fn is_empty(&self) -> bool {
        self.cells.is_none()
    }

    /// Side of the smallest block in samples.
    pub(super) fn block(&self) -> u32 {
        self.block
    }

    /// Fills in row `z`.
    pub(super) fn apply(&self, row: &mut [f32], z: u32) {
        let Some(cells) = &self.cells else { return };
        for (x, sample) in row.iter_mut().enumerate() {
            if !sample.is_nan() {
                continue;
            }
            *sample = if self.block == 1 {
                cells.values[z as usize * cells.size[0] + x]
            } else {
                let block = self.block as f32;
                cells.blend(
                    (x as f32 + 0.5) / block - 0.5,
                    (z as f32 + 0.5) / block - 0.5,
                )
            };
        }
    }
}

/// The smallest block that keeps the number of blocks within bounds.
fn block_for(size: [u32; 2]) -> u32 {
    let mut block = 1_u32;
    while size
        .iter()
        .map(|side| u64::from(side.div_ceil(block)))
        .product::<u64>()
        > MAX_CELLS
    {
        block *= 2;
    }
    block
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::MemorySource;

    fn fill(size: [u32; 2], heights: Vec<f32>) -> (Fill, u64) {
        let mut source = MemorySource::new(size, heights).expect("sizes match");
        let survey = survey(&mut source, true, &()).expect("readable");
        (
            Fill::build(&mut source, &survey, &()).expect("readable"),
            survey.no_data,
        )
    }

    #[test]
    fn a_gap_in_a_plane_is_filled_close_to_the_plane() {
        let plane = |x: u32, z: u32| x as f32 * 2.0 + z as f32;
        let hole = |x: u32, z: u32| (20..28).contains(&x) && (10..15).contains(&z);
        let heights = (0..64 * 64)
            .map(|at| (at % 64, at / 64))
            .map(|(x, z)| if hole(x, z) { f32::NAN } else { plane(x, z) })
            .collect();
        let (fill, count) = fill([64, 64], heights);
        assert_eq!(count, 40);
        for z in 10..15 {
            let mut row: Vec<f32> = (0..64).map(|x| plane(x, z)).collect();
            row[20..28].fill(f32::NAN);
            row[3] = 1234.0;
            fill.apply(&mut row, z);
            assert_eq!(row[3], 1234.0, "a sample with data changed");
            for x in 20..28 {
                let error = (row[x as usize] - plane(x, z)).abs();
                assert!(error < 6.0, "({x}, {z}) is off by {error}");
            }
        }
    }

    #[test]
    fn large_sources_are_filled_from_blocks() {
        assert_eq!(block_for([4096, 4096]), 1);
        assert_eq!(block_for([4097, 4096]), 2);
        assert_eq!(block_for([131_072, 131_072]), 32);
        assert_eq!(block_for([2, 1 << 24]), 2);
    }
}
