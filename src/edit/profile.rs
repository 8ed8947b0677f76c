//! What an edit does at one point, as a function of integers.
//!
//! Everything is a function of `u`, the square of the distance from the centre over that of the
//! reach, which counts 2^28 here: it is the sum of a column's and a row's share, so that a sample
//! costs neither a division nor a product of 64 bits. Curves are polynomials in numbers that count
//! 2^15, which 32 bits hold at every step, and so all of it runs in vector registers and gives the
//! same integers on every machine.

use super::{CapturedGround, Change, EDIT_UNITS, Edit, SampleRect, StampImage};
use pulp::{Arch, NullaryFnOnce};

/// What counts as 1 for squares of distances.
const SQUARE_ONE: u32 = 1 << 28;
/// What counts as 1 for polynomials.
const ONE: i32 = 1 << 15;
/// Products of a column's number and a row's, whose sum is the outline's noise.
const NOISE_TERMS: usize = 4;
/// Samples that vector registers take at once.
const LANES: usize = 8;
/// Points of the noise along the reach, of the first two terms and of the others.
const NOISE_POINTS: [u32; 2] = [2, 5];
/// Points of a term's noise along both reaches, with one that closes the last cell, and one more.
const NOISE_LATTICE: usize = 2 * NOISE_POINTS[1] as usize + 2;

/// Memory that point functions are evaluated in.
#[derive(Clone, Debug, Default)]
pub(super) struct ProfileScratch {
    squares: Vec<u32>,
    noise: [Vec<i16>; NOISE_TERMS],
    line: Vec<i32>,
}

/// An edit, prepared so that it can be evaluated at many points.
#[derive(Clone, Debug)]
pub(super) struct Profile<'a> {
    centre: [i64; 2],
    /// 2^60 over the square of the reach, rounded up.
    square_scale: u64,
    reach: u32,
    shape: Shape<'a>,
}

#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "one at a time lives on the stack, while its edit is evaluated"
)]
enum Shape<'a> {
    Crater(Bowl, Option<Outline>),
    Disc(Disc),
    Stamp(Stamp<'a>),
}

/// How much of a range has been gone through, from 0 to [`ONE`].
#[derive(Clone, Copy, Debug)]
struct Ramp {
    shift: u32,
    factor: u32,
}

impl Ramp {
    /// `range` is at most 2^28.
    fn new(range: u32) -> Self {
        let range = range.max(1);
        let shift = (u32::BITS - range.leading_zeros()).saturating_sub(16);
        // The part after the shift has at most 16 bits, and the factor makes 2^31 of the range.
        Self {
            shift,
            factor: (1_u32 << 31).div_ceil(range >> shift),
        }
    }

    /// `part` is at most the range.
    #[inline(always)]
    fn at(self, part: u32) -> i32 {
        let at = ((part >> self.shift).wrapping_mul(self.factor) >> 16) as i32;
        if at < ONE { at } else { ONE }
    }
}

/// A crater's cross-section. The bowl is a polynomial in `t`, the square of the distance over that of
/// the bowl's radius; it has the slope there with which the rim begins, up to 4, where it is the
/// flattest that there is (`t⁴`). The rim is `v (1 − v)²` over the rest of the square, and so ends
/// without a kink; of a rim that would need more slope than that, a part is `v² (1 − v)²`, which
/// begins without any.
#[derive(Clone, Copy, Debug)]
struct Bowl {
    edge: u32,
    inside: Ramp,
    outside: Ramp,
    /// Coefficients of `t`, `t²` and `t⁴`, of 2^14.
    coefficients: [i32; 3],
    /// How much of the rim begins with a slope, of 2^15.
    sloped: i32,
    depth: i32,
    rim: i32,
}

impl Bowl {
    fn new(depth: u16, rim: u16, bowl: u16) -> Self {
        let edge = ((u64::from(bowl) * u64::from(bowl)) >> 4) as u32;
        let rest = u64::from(SQUARE_ONE - edge);
        // The rim's slope over the bowl's, of 2^14: the rim's is 27/4 of its height.
        let rise = (u128::from(rim) * 27 * u128::from(edge)) << 14;
        let run = u128::from(depth) * 4 * u128::from(rest);
        let steepest = 4_u128 << 14;
        let (slope, sloped) = if rise <= steepest * run {
            (rise.checked_div(run).unwrap_or(0) as i32, ONE)
        } else {
            let part = ((steepest * run) << 15).checked_div(rise).unwrap_or(0);
            (4 << 14, part as i32)
        };
        let one = 1 << 14;
        let coefficients = if slope <= 2 * one {
            [2 * one - slope, slope - one, 0]
        } else {
            let fourth = (slope - 2 * one) / 2;
            [0, one - fourth, fourth]
        };
        Self {
            edge,
            inside: Ramp::new(edge),
            outside: Ramp::new(SQUARE_ONE - edge),
            coefficients,
            sloped,
            depth: depth.into(),
            rim: rim.into(),
        }
    }

    #[inline(always)]
    fn at(&self, square: u32) -> i32 {
        let within = if square < self.edge {
            square
        } else {
            self.edge
        };
        let t = self.inside.at(within);
        let [first, second, fourth] = self.coefficients;
        let outer = second + ((((t * t) >> 15) * fourth) >> 15);
        let bowl = ((t * (first + ((t * outer) >> 15))) >> 14) - ONE;
        let v = self.outside.at(square - within);
        let y = ONE - v;
        let product = (v * y) >> 13;
        let sloped = (((product * y) >> 15) * 27) >> 4;
        let rounded = (product * product) >> 15;
        let mixed = rounded + (((sloped - rounded) * self.sloped) >> 15);
        if square < self.edge {
            (bowl * self.depth) >> 7
        } else {
            (mixed * self.rim) >> 7
        }
    }
}

/// What makes a crater's outline rough: a sum of products of noise along x and noise along z, by
/// which the distance from the centre changes. Fades out towards the reach.
#[derive(Clone, Copy, Debug)]
struct Outline {
    roughness: i32,
    /// 2^28 times the points along the reach, over the reach.
    scale: [u64; 2],
    lattice: [[[i16; NOISE_LATTICE]; NOISE_TERMS]; 2],
}

/// Mixes the bits of a number.
const fn mixed(mut bits: u32) -> u32 {
    bits = (bits ^ (bits >> 16)).wrapping_mul(0x7FEB_352D);
    bits = (bits ^ (bits >> 15)).wrapping_mul(0x846C_A68B);
    bits ^ (bits >> 16)
}

impl Outline {
    fn new(roughness: u8, seed: u32, reach: u32) -> Option<Self> {
        if roughness == 0 {
            return None;
        }
        let mut state = mixed(seed ^ 0x9E37_79B9);
        let mut lattice = [[[0; NOISE_LATTICE]; NOISE_TERMS]; 2];
        for value in lattice.as_flattened_mut().as_flattened_mut() {
            state = state.wrapping_add(0x9E37_79B9);
            *value = ((mixed(state) >> 17) as i32 - (1 << 14)) as i16;
        }
        Some(Self {
            roughness: roughness.into(),
            scale: NOISE_POINTS.map(|points| (u64::from(points) << 28) / u64::from(reach)),
            lattice,
        })
    }

    /// The terms' numbers at a distance from the centre along an axis, of 2^14.
    #[inline(always)]
    fn terms(&self, axis: usize, from_edge: u32) -> [i16; NOISE_TERMS] {
        let places = self.scale.map(|scale| {
            let at = ((u64::from(from_edge) * scale) >> 16) as u32;
            let part = at & 0xfff;
            let smooth = (((part * part) >> 12) * (0x3000 - 2 * part)) >> 12;
            ((at >> 12) as usize, smooth as i32)
        });
        std::array::from_fn(|term| {
            let (cell, smooth) = places[term / 2];
            let lattice = &self.lattice[axis][term];
            let cell = cell.min(NOISE_LATTICE - 2);
            let (a, b) = (i32::from(lattice[cell]), i32::from(lattice[cell + 1]));
            (a + (((b - a) * smooth) >> 12)) as i16
        })
    }

    /// The square of the distance with its noise.
    #[inline(always)]
    fn roughened(roughness: i32, square: u32, noise: i32) -> u32 {
        let square = (square >> 13) as i32;
        let noise = noise >> 13;
        let noise = if noise > -ONE { noise } else { -ONE };
        let noise = if noise < ONE { noise } else { ONE };
        let change = (noise * roughness) >> 8;
        let fade = ONE - ((square * square) >> 15);
        let factor = (ONE + ((change * fade) >> 15)) as u32;
        let rough = (square as u32).wrapping_mul(factor.wrapping_mul(factor) >> 15) >> 2;
        if rough < SQUARE_ONE {
            rough
        } else {
            SQUARE_ONE
        }
    }
}

/// 1 as far as some part of the reach, from there to 0 in a smooth step of the square.
#[derive(Clone, Copy, Debug)]
struct Disc {
    from: u32,
    fall: Ramp,
    by: i32,
}

impl Disc {
    fn new(hardness: u8, by: i32) -> Self {
        let from = (u32::from(hardness) * u32::from(hardness)) << 12;
        Self {
            from,
            fall: Ramp::new(SQUARE_ONE - from),
            by,
        }
    }

    #[inline(always)]
    fn at(&self, square: u32) -> i32 {
        let beyond = square.saturating_sub(self.from);
        let y = (ONE - self.fall.at(beyond)) as u32;
        let weight = (((y * y) >> 15) * (3 * ONE as u32 - 2 * y)) >> 15;
        (weight as i32 * self.by) >> 7
    }
}

/// An image, and how to get from units to its samples.
#[derive(Clone, Debug)]
struct Stamp<'a> {
    image: &'a StampImage,
    /// Samples of the image along x and along z of its own, for each unit along the ground's x; of 2^44.
    /// Along the ground's z they are those, turned.
    along: [i64; 2],
    /// What a sample's step adds, of 2^24.
    step: i64,
}

impl<'a> Stamp<'a> {
    fn new(image: &'a StampImage, by: i32, turn: [i16; 2], reach: u32) -> Self {
        // Half the root of 2, of 2^30: the image's half side over the reach, and its inverse's half.
        const HALF_ROOT: i64 = 759_250_125;
        let cells = i64::from(image.side) - 1;
        let scale = cells * HALF_ROOT / i64::from(reach);
        let by = i64::from(by) << 24;
        Self {
            image,
            along: turn.map(|part| scale * i64::from(part)),
            step: (by + (by.signum() * 32767 / 2)) / 32767,
        }
    }

    fn at(&self, [dx, dz]: [i64; 2]) -> i32 {
        let cells = i64::from(self.image.side) - 1;
        let [cos, sin] = self.along;
        let middle = cells << 43;
        let places = [middle + dx * cos + dz * sin, middle - dx * sin + dz * cos];
        if places.iter().any(|&at| at < 0 || at > cells << 44) {
            return 0;
        }
        let [(x, right), (z, down)] = places.map(|at| {
            let cell = (at >> 44).min(cells - 1);
            (cell as usize, (at - (cell << 44)) >> 28)
        });
        let side = usize::from(self.image.side);
        let row = |z: usize| {
            let at = z * side + x;
            let (a, b) = (self.image.samples[at], self.image.samples[at + 1]);
            (i64::from(a) << 16) + (i64::from(b) - i64::from(a)) * right
        };
        let (above, below) = (row(z), row(z + 1));
        let sample = above + (((below - above) * down) >> 16);
        ((sample * self.step + (1 << 31)) >> 32) as i32
    }
}

impl<'a> Profile<'a> {
    pub(super) fn new(edit: &'a Edit) -> Self {
        let reach = edit.reach.max(1);
        let shape = match &edit.change {
            &Change::Crater {
                depth,
                rim,
                bowl,
                roughness,
                seed,
                ..
            } => Shape::Crater(
                Bowl::new(depth, rim, bowl),
                Outline::new(roughness, seed, reach),
            ),
            &Change::Raise { by, hardness, .. } => Shape::Disc(Disc::new(hardness, by)),
            &Change::Flatten {
                strength, hardness, ..
            }
            | &Change::Smooth {
                strength, hardness, ..
            } => Shape::Disc(Disc::new(hardness, strength.into())),
            Change::Stamp {
                image, by, turn, ..
            } => Shape::Stamp(Stamp::new(image, *by, *turn, reach)),
        };
        Self {
            centre: edit.centre.map(i64::from),
            square_scale: (1_u64 << 60).div_ceil(u64::from(reach) * u64::from(reach)),
            reach,
            shape,
        }
    }

    /// The samples of the grid with a point at every `2^grid`-th sample of level 0 that lie less than
    /// the reach from the centre along both axes. Others don't change.
    pub(super) fn support(&self, grid: u32) -> SampleRect {
        let (unit, reach) = (i64::from(EDIT_UNITS) << grid, i64::from(self.reach));
        SampleRect {
            min: self
                .centre
                .map(|at| ((at - reach).div_euclid(unit) + 1) as i32),
            max: self
                .centre
                .map(|at| (-(-(at + reach)).div_euclid(unit)) as i32),
        }
    }

    /// Distances from the centre in units.
    fn distance(&self, axis: usize, sample: i32, grid: u32) -> i64 {
        ((i64::from(sample) * i64::from(EDIT_UNITS)) << grid) - self.centre[axis]
    }

    #[inline(always)]
    fn square(&self, distance: i64) -> u32 {
        let square = distance.unsigned_abs() * distance.unsigned_abs();
        // Rounded up, so that what lies beyond the reach stays there.
        ((square * self.square_scale + u64::from(u32::MAX)) >> 32) as u32
    }

    /// Writes the displacements (or weights) of the samples in `rect`, a part of the
    /// [support](Self::support) of the same grid, row by row, `stride` apart. They count 256, or whole
    /// ones where `whole`.
    pub(super) fn points(
        &self,
        grid: u32,
        rect: &SampleRect,
        whole: bool,
        scratch: &mut ProfileScratch,
        out: &mut [i32],
        stride: usize,
    ) {
        if rect.is_empty() {
            return;
        }
        Arch::new().dispatch(Points {
            profile: self,
            grid,
            rect,
            whole,
            scratch,
            out,
            stride,
        });
    }
}

/// The arguments of [`Profile::points`], which is compiled for several instruction sets.
struct Points<'a, 'b> {
    profile: &'a Profile<'b>,
    grid: u32,
    rect: &'a SampleRect,
    whole: bool,
    scratch: &'a mut ProfileScratch,
    out: &'a mut [i32],
    stride: usize,
}

impl NullaryFnOnce for Points<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        if self.whole {
            self.run(|value| (value + 128) >> 8);
        } else {
            self.run(|value| value);
        }
    }
}

impl Points<'_, '_> {
    #[inline(always)]
    fn run(self, finish: impl Fn(i32) -> i32 + Copy) {
        let Self {
            profile,
            grid,
            rect,
            scratch,
            out,
            stride,
            ..
        } = self;
        let ProfileScratch {
            squares,
            noise,
            line,
        } = scratch;
        let [columns, _] = rect.size();
        // Whole vectors: what is left over of a row costs more than the rest, one sample at a time.
        let padded = columns.next_multiple_of(LANES);
        let distance = |axis: usize, at: i32| profile.distance(axis, at, grid);
        let from_edge = |distance: i64| (distance + i64::from(profile.reach)) as u32;
        let xs = rect.min[0]..rect.max[0];
        squares.clear();
        squares.extend(xs.clone().map(|x| profile.square(distance(0, x))));
        squares.resize(padded, SQUARE_ONE);
        line.resize(padded, 0);
        if let Shape::Crater(_, Some(outline)) = &profile.shape {
            for terms in noise.iter_mut() {
                terms.resize(padded, 0);
            }
            for (at, x) in xs.enumerate() {
                let terms = outline.terms(0, from_edge(distance(0, x)));
                for (noise, term) in noise.iter_mut().zip(terms) {
                    noise[at] = term;
                }
            }
        }
        let squares = &squares[..padded];
        let line = &mut line[..padded];
        let rows = out.chunks_mut(stride).zip(rect.min[1]..rect.max[1]);
        for (out, z) in rows {
            let out = &mut out[..columns];
            let row = profile.square(distance(1, z));
            // Copies of what the loops need, which no store can change, or they run one sample at a
            // time.
            match &profile.shape {
                Shape::Disc(disc) => {
                    let disc = *disc;
                    row_of(line, squares, row, |square| finish(disc.at(square)));
                }
                Shape::Crater(bowl, None) => {
                    let bowl = *bowl;
                    row_of(line, squares, row, |square| finish(bowl.at(square)));
                }
                Shape::Crater(bowl, Some(outline)) => {
                    let (bowl, roughness) = (*bowl, outline.roughness);
                    let own = outline.terms(1, from_edge(distance(1, z))).map(i32::from);
                    let noise = noise.each_ref().map(|terms| &terms[..padded]);
                    rough_row_of(line, squares, row, noise, own, |square, noise| {
                        finish(bowl.at(Outline::roughened(roughness, square, noise)))
                    });
                }
                Shape::Stamp(stamp) => {
                    let dz = distance(1, z);
                    let columns = (rect.min[0]..).zip(squares);
                    for (out, (x, &column)) in line.iter_mut().zip(columns) {
                        *out = if column + row < SQUARE_ONE {
                            finish(stamp.at([distance(0, x), dz]))
                        } else {
                            0
                        };
                    }
                }
            }
            out.copy_from_slice(&line[..columns]);
        }
    }
}

/// The square of a distance from the shares of a row and a column.
#[inline(always)]
fn square_of(column: u32, row: u32) -> u32 {
    let square = column + row;
    if square < SQUARE_ONE {
        square
    } else {
        SQUARE_ONE
    }
}

/// A function of its own, as slices that are arguments are known not to overlap.
#[inline(always)]
fn row_of(line: &mut [i32], squares: &[u32], row: u32, value: impl Fn(u32) -> i32) {
    let squares = &squares[..line.len()];
    for (out, &column) in line.iter_mut().zip(squares) {
        *out = value(square_of(column, row));
    }
}

/// [`row_of`] with noise: sums of the terms' products.
#[inline(always)]
fn rough_row_of(
    line: &mut [i32],
    squares: &[u32],
    row: u32,
    [a, b, c, d]: [&[i16]; NOISE_TERMS],
    own: [i32; NOISE_TERMS],
    value: impl Fn(u32, i32) -> i32,
) {
    let count = line.len();
    let squares = &squares[..count];
    let [a, b, c, d] = [&a[..count], &b[..count], &c[..count], &d[..count]];
    for x in 0..count {
        let noise = i32::from(a[x]) * own[0]
            + i32::from(b[x]) * own[1]
            + i32::from(c[x]) * own[2]
            + i32::from(d[x]) * own[3];
        line[x] = value(square_of(squares[x], row), noise);
    }
}

/// The height that [`Change::Smooth`] draws a sample to: bilinear between the points captured, the
/// outermost of which go on beyond them. `sample` counts samples of level 0.
pub(super) fn captured(ground: &CapturedGround, sample: [i64; 2]) -> i32 {
    let log2 = u32::from(ground.spacing_log2);
    let [(x, right), (z, down)] = [0, 1].map(|axis| {
        let last = i64::from(ground.size[axis]) - 1;
        let at = (sample[axis] - i64::from(ground.first[axis])).clamp(0, last << log2);
        let cell = (at >> log2).min((last - 1).max(0));
        (cell as usize, at - (cell << log2))
    });
    let columns = usize::from(ground.size[0]);
    // A grid with one point along an axis has no second one there.
    let next = |axis: usize| usize::from(ground.size[axis] > 1);
    let one = 1_i64 << log2;
    let row = |z: usize| {
        let at = z * columns + x;
        let (a, b) = (ground.heights[at], ground.heights[at + next(0)]);
        i64::from(a) * (one - right) + i64::from(b) * right
    };
    let sum = row(z) * (one - down) + row(z + next(1)) * down;
    ((2 * sum + one * one) >> (2 * log2 + 1)) as i32
}
