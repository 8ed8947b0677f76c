//! What each edit draws: functions of the edit and of a texel's place, in integers.

use crate::edit::StampImage;
use std::sync::LazyLock;

/// One, in fractions of an edit's reach, of weights and of angles.
const ONE: u32 = 65536;
/// Entries of [`Tables::roots`], as a power of two.
const ROOTS_LOG2: u32 = 12;
/// Texels after which the noise begins anew.
const NOISE_SIDE: usize = 64;
/// Directions in which a crater's scorch reaches differently far.
const RAYS: usize = 64;
/// Part of the bowl's radius within which all is scorched.
const DARK: (u32, u32) = (55, 100);
/// How far rays reach, of the way from the dark middle to the reach: the shortest, and the longest,
/// of 256. With the noise, which takes up to a quarter off, the longest end before the reach.
const RAY_LENGTHS: (u32, u32) = (100, 190);
/// What a stamp's image has to differ from 0 by for its whole scorch: less than a hundredth of what
/// it holds, so that nothing but its outline is soft.
const STAMP_EDGE: u32 = 256;

/// What all edits share.
struct Tables {
    /// Square roots of fractions, from the middle of each step.
    roots: [u16; 1 << ROOTS_LOG2],
    /// Noise of two wavelengths, 4 and 2 texels, that goes on where it ends.
    noise: [u8; NOISE_SIDE * NOISE_SIDE],
}

static TABLES: LazyLock<Tables> = LazyLock::new(|| {
    let mut tables = Tables {
        roots: [0; 1 << ROOTS_LOG2],
        noise: [0; NOISE_SIDE * NOISE_SIDE],
    };
    for (at, root) in (0_u64..).zip(&mut tables.roots) {
        *root = ((2 * at + 1) << (31 - ROOTS_LOG2)).isqrt() as u16;
    }
    for z in 0..NOISE_SIDE {
        for x in 0..NOISE_SIDE {
            let coarse = value_noise(x, z, 4, 0x51ed_270b);
            let fine = value_noise(x, z, 2, 0xb529_7a4d);
            tables.noise[z * NOISE_SIDE + x] = ((2 * coarse + fine) / 3) as u8;
        }
    }
    tables
});

/// Mixes all bits of `x` (Wellons, "lowbias32").
const fn mix(x: u32) -> u32 {
    let x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    let x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Random values at every `cell`th texel, bilinear between them, 0 to 255.
fn value_noise(x: usize, z: usize, cell: usize, salt: u32) -> u32 {
    let cells = NOISE_SIDE / cell;
    let corner = |across: usize, down: usize| {
        let at = (z / cell + down) % cells * cells + (x / cell + across) % cells;
        mix(at as u32 ^ salt) >> 24
    };
    let (right, below) = ((x % cell) as u32, (z % cell) as u32);
    let (left, above) = (cell as u32 - right, cell as u32 - below);
    let top = corner(0, 0) * left + corner(1, 0) * right;
    let bottom = corner(0, 1) * left + corner(1, 1) * right;
    (top * above + bottom * below) / (cell * cell) as u32
}

/// `3 t² - 2 t³`, of fractions of 65536.
const fn smooth(t: u32) -> u32 {
    let t = t as u64;
    ((t * t * (3 * ONE as u64 - 2 * t)) >> 32) as u32
}

/// Distances from an edit's centre as fractions of its reach.
struct Distance {
    /// 2^(32 + [`ROOTS_LOG2`]) over the square of the reach in half units.
    inverse: u64,
    roots: &'static [u16; 1 << ROOTS_LOG2],
}

impl Distance {
    fn new(reach: u32) -> Self {
        let reach = 2 * u64::from(reach.max(1));
        Self {
            inverse: (1 << (32 + ROOTS_LOG2)) / (reach * reach),
            roots: &TABLES.roots,
        }
    }

    /// The fraction, of 65536, for a squared distance in half units that is within the reach.
    const fn of(&self, squared: u64) -> u32 {
        let at = (squared * self.inverse) >> 32;
        let last = (1 << ROOTS_LOG2) - 1;
        self.roots[if at < last { at } else { last } as usize] as u32
    }
}

/// A texel as an edit sees it.
#[derive(Clone, Copy)]
pub(super) struct ScorchPlace {
    /// From the edit's centre to the texel's, in half units.
    pub(super) from_centre: [i32; 2],
    /// Which texel it is, modulo what 32 bits hold.
    pub(super) texel: [u32; 2],
}

impl ScorchPlace {
    fn squared(self) -> u64 {
        let [x, z] = self
            .from_centre
            .map(|along| u64::from(along.unsigned_abs()));
        x * x + z * z
    }
}

/// What an edit makes of a texel within its reach.
pub(super) trait Brush {
    /// The texel's value after the edit, from what it was.
    fn value(&self, place: ScorchPlace, before: u8) -> u8;
}

/// Scorches a disc: dark in the bowl, then in rays of different lengths, broken up by noise.
pub(super) struct CraterBrush {
    distance: Distance,
    /// Fraction of the reach within which all is scorched.
    dark: u32,
    /// 256 over the lengths of the rays as fractions of the reach; the first again at the end.
    rays: [u32; RAYS + 1],
    /// What is drawn by how far along a ray it lies, 0 to 255.
    profile: [u8; 256],
    noise_offset: [u32; 2],
    noise: &'static [u8; NOISE_SIDE * NOISE_SIDE],
}

impl CraterBrush {
    pub(super) fn new(reach: u32, bowl: u16, seed: u32, scorch: u8) -> Self {
        let dark = u32::from(bowl) * DARK.0 / DARK.1;
        let way = ONE - dark;
        // Some rays are long and thin, between stretches that hardly differ.
        let stretch = |at: usize| mix(seed ^ mix(at as u32 / 4 % 16 + 1)) >> 24;
        let mut rays = [0; RAYS + 1];
        for (at, ray) in rays.iter_mut().enumerate() {
            let inside = (at % 4) as u32;
            let wide = (stretch(at) * (4 - inside) + stretch(at + 4) * inside) / 4;
            let thin = mix(seed ^ mix((at % RAYS) as u32 + 0x100)) >> 24;
            let thin = thin * thin / 255;
            let (shortest, longest) = RAY_LENGTHS;
            let length = shortest + (longest - shortest) * (wide + thin) / (2 * 255);
            *ray =
                u32::try_from((u64::from(ONE) << 16) / u64::from(way * length)).unwrap_or(u32::MAX);
        }
        let mut profile = [0; 256];
        for (along, value) in (0..).zip(&mut profile) {
            *value = (smooth(ONE - along * 256) * u32::from(scorch) / ONE) as u8;
        }
        Self {
            distance: Distance::new(reach),
            dark,
            rays,
            profile,
            noise_offset: [mix(seed ^ 0x68bc_21eb), mix(seed ^ 0x02e5_be93)],
            noise: &TABLES.noise,
        }
    }

    /// One over the length of the ray at `along`, linear between rays. Angles are those of a square
    /// rather than a circle: a division, and no root.
    fn ray(&self, [x, z]: [i32; 2]) -> u32 {
        let (across, down) = (x.unsigned_abs(), z.unsigned_abs());
        let quarter = (down << 14) / (across + down).max(1);
        let angle = match (x >= 0, z >= 0) {
            (true, true) => quarter,
            (false, true) => 2 * 16384 - quarter,
            (false, false) => 2 * 16384 + quarter,
            (true, false) => 4 * 16384 - quarter,
        } % ONE;
        const STEP: u32 = ONE / RAYS as u32;
        let (ray, beyond) = ((angle / STEP) as usize, angle % STEP);
        (self.rays[ray] * (STEP - beyond) + self.rays[ray + 1] * beyond) / STEP
    }
}

impl Brush for CraterBrush {
    fn value(&self, place: ScorchPlace, before: u8) -> u8 {
        if before >= self.profile[0] {
            return before;
        }
        let far = self.distance.of(place.squared());
        let Some(beyond) = far.checked_sub(self.dark) else {
            return self.profile[0];
        };
        let along = (beyond * self.ray(place.from_centre)) >> 8;
        let [x, z] = [0, 1].map(|axis| {
            place.texel[axis].wrapping_add(self.noise_offset[axis]) as usize % NOISE_SIDE
        });
        let noise = i32::from(self.noise[z * NOISE_SIDE + x]) - 128;
        let along = along.cast_signed();
        let along = (along + (along >> 8) * noise / 2) >> 8;
        let drawn = self.profile.get(along as usize).copied().unwrap_or(0);
        before.max(drawn)
    }
}

/// Scorches where a stamp's image is not 0.
pub(super) struct StampBrush<'a> {
    image: &'a StampImage,
    turn: [i16; 2],
    /// Half the side of the image, in half units.
    half: i64,
    scorch: u8,
}

impl<'a> StampBrush<'a> {
    /// `None` where the image is none.
    pub(super) fn new(
        reach: u32,
        image: &'a StampImage,
        turn: [i16; 2],
        scorch: u8,
    ) -> Option<Self> {
        let side = usize::from(image.side);
        (side >= 2 && image.samples.len() >= side * side).then_some(Self {
            image,
            turn,
            // The corners lie on the circle of the reach: over the root of 2.
            half: (2 * i64::from(reach) * 46341) >> 16,
            scorch,
        })
    }

    /// The image's magnitude at a place, bilinear; 0 outside.
    fn magnitude(&self, [x, z]: [i32; 2]) -> u32 {
        let [along, across] = self.turn.map(i64::from);
        let (x, z) = (i64::from(x), i64::from(z));
        let last = i64::from(self.image.side) - 1;
        // In samples, 16 bits after the point.
        let to_samples =
            |at: i64| ((((at >> 14) + self.half) * last) << 16) / (2 * self.half).max(1);
        let u = to_samples(x * along + z * across);
        let v = to_samples(z * along - x * across);
        let inside = |at: i64| (0..=last << 16).contains(&at);
        if !inside(u) || !inside(v) {
            return 0;
        }
        let column = (u >> 16).min(last - 1);
        let row = (v >> 16).min(last - 1);
        let (right, below) = (u - (column << 16), v - (row << 16));
        let sample = |across: i64, down: i64| {
            let at = (row + down) * (last + 1) + column + across;
            i64::from(self.image.samples[at as usize])
        };
        let top = sample(0, 0) * (65536 - right) + sample(1, 0) * right;
        let bottom = sample(0, 1) * (65536 - right) + sample(1, 1) * right;
        let value = (top * (65536 - below) + bottom * below) >> 32;
        value.unsigned_abs() as u32
    }
}

impl Brush for StampBrush<'_> {
    fn value(&self, place: ScorchPlace, before: u8) -> u8 {
        let strength = self.magnitude(place.from_centre).min(STAMP_EDGE);
        before.max((strength * u32::from(self.scorch) / STAMP_EDGE) as u8)
    }
}

/// Takes scorch away, as far as an edit draws the ground somewhere else.
pub(super) struct FadeBrush {
    distance: Distance,
    /// Fraction of the reach within which the change is whole.
    whole: u32,
    strength: u16,
}

impl FadeBrush {
    pub(super) fn new(reach: u32, hardness: u8, strength: u16) -> Self {
        Self {
            distance: Distance::new(reach),
            whole: u32::from(hardness) * 256,
            strength,
        }
    }
}

impl Brush for FadeBrush {
    fn value(&self, place: ScorchPlace, before: u8) -> u8 {
        let far = self.distance.of(place.squared());
        let weight = match far.checked_sub(self.whole) {
            None => ONE,
            Some(beyond) => {
                let along = (u64::from(beyond) << 16) / u64::from(ONE - self.whole);
                smooth(ONE - along as u32)
            }
        };
        // At full strength nothing is left.
        let taken = u64::from(weight) * (u64::from(self.strength) + u64::from(self.strength >> 15));
        let left = (1_u64 << 32) - taken;
        ((u64::from(before) * left) >> 32) as u8
    }
}
