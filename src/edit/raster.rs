//! From edits to displacements, level by level.
//!
//! # Levels
//! At level 0, an edit is a function of the sample's place. A coarser level holds means of the level
//! below it, by the weights 1 2 1 along each axis, and what an edit does there is the mean of what it
//! does below. So that a large edit doesn't cost what all of level 0 does wherever it is looked at, the
//! means begin at a grid no finer than they need: for level `l`, the function is taken at every
//! `2^m`-th sample of level 0, `m` being `l − 1` or, where the reach would be less than four
//! points then, the largest at which it isn't. From there the means lead up to `l`, exact at first and
//! then in 4096ths of a step, and are rounded once, halves up.
//!
//! A sample's displacement depends on the edit, the level and the sample, and on nothing else: not on
//! which part of a level is asked for.

use super::profile::{Profile, ProfileScratch};
use super::{Edit, LevelFootprint, SampleRect};
use crate::density::{DensityExtent, DensityKernel};
use crate::terrain::ManifestFile;
use crate::tile::{TILE_BORDER, TILE_SAMPLES, TileAddress};

/// Points that the reach has at least on the coarsest grid that an edit's function is taken on.
const POINTS_LOG2: u32 = 2;
/// Fractional bits of displacements that have been through means.
const MEAN_BITS: u32 = 12;

/// What edits have to know of a terrain. Made once, and shared by all that apply edits to it.
#[derive(Clone, Debug)]
pub struct EditGround {
    levels: Vec<GroundLevel>,
}

#[derive(Clone, Debug)]
pub(super) struct GroundLevel {
    /// Samples in x and z.
    pub(super) samples: [u32; 2],
    pub(super) extent: DensityExtent,
    pub(super) kernel: DensityKernel,
}

impl GroundLevel {
    /// All samples of the level.
    pub(super) fn rect(&self) -> SampleRect {
        SampleRect::new([0; 2], self.samples.map(|count| count as i32))
    }

    /// The samples that a tile stores, as far as they lie on the terrain.
    pub(super) fn stored(&self, address: TileAddress) -> SampleRect {
        let (x, z) = address.first_sample();
        let first = [x, z].map(|at| at as i32);
        let border = TILE_BORDER as i32;
        let last = (TILE_SAMPLES + TILE_BORDER) as i32;
        SampleRect::new(first.map(|at| at - border), first.map(|at| at + last + 1))
            .intersection(&self.rect())
    }
}

/// Memory that edits are made in. Kept, it is not allocated again.
#[derive(Clone, Debug, Default)]
pub struct EditScratch {
    profile: ProfileScratch,
    grids: [Vec<i32>; 2],
    sums: Vec<i32>,
    pub(super) values: Vec<i32>,
    pub(super) tile: super::tile::TileScratch,
}

/// What one edit does to every sample of every level.
///
/// Takes 4 bytes for each sample that may change.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EditRaster {
    pub(super) edit: Edit,
    footprint: super::Footprint,
    levels: Vec<Vec<i32>>,
}

/// Where a level's displacements may differ from 0, as if terrains had no end.
#[derive(Clone, Copy)]
struct Support {
    /// The grid on which the function is taken.
    grid: u32,
    level: u32,
}

impl Support {
    fn new(edit: &Edit, level: u8) -> Self {
        let coarsest = (edit.reach >> (6 + POINTS_LOG2)).max(1).ilog2();
        let level = u32::from(level);
        Self {
            grid: level.saturating_sub(1).min(coarsest),
            level,
        }
    }

    /// On the way from the grid's points up to `level`.
    fn rect(self, profile: &Profile<'_>, level: u32) -> SampleRect {
        let mut rect = profile.support(self.grid);
        for _ in self.grid..level {
            rect = SampleRect {
                min: rect.min.map(|at| at.div_euclid(2)),
                max: rect.max.map(|end| end.div_euclid(2) + 1),
            };
        }
        rect
    }
}

impl EditGround {
    /// Of the terrain that `file` describes, which must be [valid](ManifestFile::validate).
    #[must_use]
    pub fn new(file: &ManifestFile) -> Self {
        let level = |level| GroundLevel {
            samples: file.samples(level),
            extent: DensityExtent::new(file.size, level),
            kernel: DensityKernel::new(&file.density, file.height_step_m, file.spacing_m, level),
        };
        Self {
            levels: (0..file.levels).map(level).collect(),
        }
    }

    /// Levels of the terrain.
    #[must_use]
    pub fn levels(&self) -> u8 {
        self.levels.len() as u8
    }

    /// Samples of `level` in x and z.
    ///
    /// # Panics
    /// Where the terrain has no such level.
    #[must_use]
    pub fn samples(&self, level: u8) -> [u32; 2] {
        self.level(level).samples
    }

    pub(super) fn level(&self, level: u8) -> &GroundLevel {
        &self.levels[usize::from(level)]
    }

    /// Works out what an edit does, on all levels. Costs about as much as two or three times the
    /// samples of level 0 that it reaches.
    ///
    /// `edit` must be [valid](Edit::validate): others may panic, or be nonsense.
    #[must_use]
    pub fn raster(&self, edit: &Edit, scratch: &mut EditScratch) -> EditRaster {
        let profile = Profile::new(edit);
        let mut levels = Vec::with_capacity(self.levels.len());
        let mut footprints: Vec<LevelFootprint> = Vec::with_capacity(self.levels.len());
        let mut covered: Option<SampleRect> = None;
        for (number, level) in (0..self.levels()).zip(&self.levels) {
            let support = Support::new(edit, number);
            let own = support.rect(&profile, number.into());
            // A level's rectangle covers that of the level below it.
            let rect = covered.map_or(own, |finer| {
                own.union(&SampleRect {
                    min: finer.min.map(|at| at.div_euclid(2)),
                    max: finer.max.map(|end| end.div_euclid(2) + 1),
                })
            });
            covered = Some(rect);
            let rect = rect.intersection(&level.rect());
            self.window_of(&profile, edit, number, &rect, scratch);
            let values = scratch.values.clone();
            footprints.push(LevelFootprint::new(
                edit,
                rect,
                level.samples,
                &values,
                footprints.last(),
            ));
            levels.push(values);
        }
        EditRaster {
            edit: edit.clone(),
            footprint: super::Footprint::new(footprints),
            levels,
        }
    }

    /// What an edit does to some samples of a level, row by row: displacements in whole steps, or
    /// weights of 65535 of what draws the ground somewhere. Samples may lie beyond the terrain.
    ///
    /// `edit` must be [valid](Edit::validate).
    ///
    /// # Panics
    /// Where the terrain has no such level.
    #[must_use]
    pub fn window<'s>(
        &self,
        edit: &Edit,
        level: u8,
        window: &SampleRect,
        scratch: &'s mut EditScratch,
    ) -> &'s [i32] {
        self.window_of(&Profile::new(edit), edit, level, window, scratch);
        &scratch.values
    }

    /// [`window`](Self::window), which it leaves in the scratch.
    pub(super) fn window_of(
        &self,
        profile: &Profile<'_>,
        edit: &Edit,
        level: u8,
        window: &SampleRect,
        scratch: &mut EditScratch,
    ) {
        let EditScratch {
            profile: columns,
            grids: [finer, coarser],
            sums,
            values,
            ..
        } = scratch;
        values.clear();
        let [width, height] = window.size();
        values.resize(width * height, 0);
        let support = Support::new(edit, level);
        let top = support.rect(profile, support.level).intersection(window);
        if top.is_empty() {
            return;
        }
        let offset = |rect: &SampleRect| {
            let [x, z] = [0, 1].map(|axis| (rect.min[axis] - window.min[axis]) as usize);
            z * width + x
        };
        if support.level == 0 {
            let out = &mut values[offset(&top)..];
            profile.points(0, &top, true, columns, out, width);
            return;
        }
        // What each level needs of the one below it.
        let needed = |level: u32| {
            let mut rect = top;
            for below in (level..support.level).rev() {
                rect = SampleRect {
                    min: rect.min.map(|at| 2 * at - 1),
                    max: rect.max.map(|end| 2 * end),
                }
                .intersection(&support.rect(profile, below));
            }
            rect
        };
        let mut rect = needed(support.grid);
        let [columns_of, rows_of] = rect.size();
        finer.clear();
        finer.resize(columns_of * rows_of, 0);
        profile.points(
            support.grid,
            &rect,
            false,
            columns,
            finer,
            columns_of.max(1),
        );
        for level in support.grid + 1..=support.level {
            let target = needed(level);
            let exact = level == support.grid + 1;
            mean(&rect, finer, &target, coarser, sums, exact);
            rect = target;
            std::mem::swap(finer, coarser);
        }
        let [columns_of, _] = rect.size();
        let first = offset(&rect);
        if columns_of == 0 {
            return;
        }
        let rows = finer.chunks_exact(columns_of);
        for (row, out) in rows.zip(values[first..].chunks_mut(width)) {
            for (&mean, out) in row.iter().zip(out) {
                *out = (mean + (1 << (MEAN_BITS - 1))) >> MEAN_BITS;
            }
        }
    }
}

/// The means that the samples in `target` of a level are of those of the level below it, which
/// are 0 outside of `source`. `exact` where these count 256ths of a step: their sums are means in
/// 4096ths. Means of 4096ths are rounded to such.
fn mean(
    source: &SampleRect,
    finer: &[i32],
    target: &SampleRect,
    coarser: &mut Vec<i32>,
    sums: &mut Vec<i32>,
    exact: bool,
) {
    let [columns, rows] = target.size();
    coarser.clear();
    coarser.resize(columns * rows, 0);
    let [width, height] = source.size();
    if width == 0 || height == 0 || columns == 0 {
        return;
    }
    // Three rows of sums, from the column before the first one's to the one after the last one's.
    let span = 2 * columns + 1;
    sums.clear();
    sums.resize(span, 0);
    let left = source.min[0] - (2 * target.min[0] - 1);
    let from = left.max(0) as usize;
    let skip = (-left).max(0) as usize;
    let count = (width.saturating_sub(skip)).min(span.saturating_sub(from));
    // 4096ths need two bits less on the way, to stay within 31.
    let keep = if exact { 0 } else { 2 };
    let half = if exact { 0 } else { 2 };
    for (out, z) in coarser.chunks_exact_mut(columns).zip(target.min[1]..) {
        let row = |z: i32| {
            let at = i64::from(z) - i64::from(source.min[1]);
            let inside = (0..height as i64).contains(&at);
            inside.then(|| &finer[at as usize * width + skip..][..count])
        };
        let sums = &mut sums[..];
        let inner = &mut sums[from..from + count];
        inner.fill(0);
        for (z, weight) in [(2 * z - 1, 1), (2 * z, 2), (2 * z + 1, 1)] {
            if let Some(row) = row(z) {
                for (sum, &value) in inner.iter_mut().zip(row) {
                    *sum += weight * value;
                }
            }
        }
        for sum in inner {
            *sum = (*sum + half) >> keep;
        }
        let windows = sums.windows(3).step_by(2);
        for (out, window) in out.iter_mut().zip(windows) {
            *out = (window[0] + 2 * window[1] + window[2] + half) >> keep;
        }
    }
}

impl EditRaster {
    /// The edit that is being applied.
    #[must_use]
    pub fn edit(&self) -> &Edit {
        &self.edit
    }

    /// Where it changes what, and by how much at most.
    #[must_use]
    pub fn footprint(&self) -> &super::Footprint {
        &self.footprint
    }

    /// Where it changes what, for those who need nothing more.
    #[must_use]
    pub fn into_footprint(self) -> super::Footprint {
        self.footprint
    }

    /// The samples of a level that may change, and what happens to them, row by row: displacements in
    /// whole steps, or weights of 65535.
    ///
    /// # Panics
    /// Where the terrain has no such level.
    #[must_use]
    pub fn level(&self, level: u8) -> (SampleRect, &[i32]) {
        (
            self.footprint.level(level).heights,
            &self.levels[usize::from(level)],
        )
    }

    /// What happens to one sample of a level; 0 where nothing does.
    ///
    /// # Panics
    /// Where the terrain has no such level.
    #[must_use]
    pub fn value(&self, level: u8, [x, z]: [i32; 2]) -> i32 {
        let (rect, values) = self.level(level);
        let inside =
            (rect.min[0]..rect.max[0]).contains(&x) && (rect.min[1]..rect.max[1]).contains(&z);
        if !inside {
            return 0;
        }
        let at = (z - rect.min[1]) as usize * rect.size()[0] + (x - rect.min[0]) as usize;
        values[at]
    }
}
