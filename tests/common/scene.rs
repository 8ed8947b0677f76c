//! A landscape that a formula describes, baked, and what a ray from a camera sees of it: the
//! pictures' oracle.

use bevy::math::{Vec2, Vec3};
use bevy::transform::components::Transform;
use bevy_tessera::bake::{BakeSettings, MemorySource, bake};
use image::RgbImage;
use std::path::{Path, PathBuf};

/// Samples of the landscape in x and z, and metres between them.
const SAMPLES: [u32; 2] = [385, 321];
const SPACING_M: f32 = 2.0;
/// Farther than this nothing is looked for.
const FAR_M: f32 = 3000.0;

/// Two shadow cascades that reach over the landscape.
pub fn two_cascades() -> bevy::light::CascadeShadowConfig {
    bevy::light::CascadeShadowConfigBuilder {
        num_cascades: 2,
        first_cascade_far_bound: 400.0,
        maximum_distance: 1500.0,
        ..Default::default()
    }
    .build()
}

/// A test binary's own asset folder, emptied, with [`hills`] baked into it.
pub fn assets_with_hills(binary: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{binary}/assets"));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    Scene::new(hills).bake(&folder.join("hills"));
    folder
}

/// Ground, and boxes that stand on it.
#[derive(Clone)]
pub struct Scene {
    pub height: fn(Vec2) -> f32,
    pub size: Vec2,
    /// Lowest and highest corner of each.
    pub boxes: Vec<(Vec3, Vec3)>,
}

/// What a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    pub point: Vec3,
    pub distance: f32,
    pub on_ground: bool,
}

/// Rolling ground with two hills that throw shadows.
pub fn hills(place: Vec2) -> f32 {
    let hill = |x: f32, z: f32, wide: Vec2, high: f32| {
        let from = (place - Vec2::new(x, z)) / wide;
        high * (-from.length_squared()).exp()
    };
    30.0 + 9.0 * (place.x / 70.0).sin() * (place.y / 55.0).cos()
        + hill(430.0, 290.0, Vec2::new(55.0, 70.0), 95.0)
        + hill(230.0, 190.0, Vec2::new(45.0, 45.0), 60.0)
}

/// Flat to the left of the middle; to the right it rises by one metre in two.
pub fn ramp(place: Vec2) -> f32 {
    20.0 + 0.5 * (place.x - 384.0).max(0.0)
}

impl Scene {
    pub fn new(height: fn(Vec2) -> f32) -> Self {
        Self {
            height,
            size: Vec2::new((SAMPLES[0] - 1) as f32, (SAMPLES[1] - 1) as f32) * SPACING_M,
            boxes: Vec::new(),
        }
    }

    /// Bakes the ground into `folder`.
    pub fn bake(&self, folder: &Path) {
        let heights = (0..SAMPLES[1])
            .flat_map(|z| (0..SAMPLES[0]).map(move |x| Vec2::new(x as f32, z as f32) * SPACING_M))
            .map(self.height)
            .collect();
        let mut source = MemorySource::new(SAMPLES, heights)
            .unwrap()
            .with_spacing_m(f64::from(SPACING_M));
        bake(&mut source, folder, &BakeSettings::default(), &()).unwrap();
    }

    pub fn ground(&self, x: f32, z: f32) -> Vec3 {
        Vec3::new(x, (self.height)(Vec2::new(x, z)), z)
    }

    pub fn normal(&self, point: Vec3) -> Vec3 {
        let rise = |along: Vec2| {
            let place = Vec2::new(point.x, point.z);
            ((self.height)(place + along) - (self.height)(place - along)) / (2.0 * along.length())
        };
        Vec3::new(
            -rise(Vec2::new(SPACING_M, 0.0)),
            1.0,
            -rise(Vec2::new(0.0, SPACING_M)),
        )
        .normalize()
    }

    fn above(&self, point: Vec3) -> Option<f32> {
        let place = Vec2::new(point.x, point.z);
        (place.cmpge(Vec2::ZERO).all() && place.cmple(self.size).all())
            .then(|| point.y - (self.height)(place))
    }

    fn box_hit(&self, from: Vec3, along: Vec3) -> Option<f32> {
        let entry = |&(low, high): &(Vec3, Vec3)| {
            let (a, b) = ((low - from) / along, (high - from) / along);
            let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
            (near < far && near > 0.0).then_some(near)
        };
        self.boxes.iter().filter_map(entry).min_by(f32::total_cmp)
    }

    /// The first thing that a ray meets within `reach`; `along` is one long.
    pub fn cast(&self, from: Vec3, along: Vec3, reach: f32) -> Option<Hit> {
        let mut before = 0.0;
        let mut here = 0.0;
        let mut ground = None;
        while here < reach {
            match self.above(from + along * here) {
                Some(above) if above < 0.0 => {
                    let (mut out, mut inside) = (before, here);
                    for _ in 0..20 {
                        let middle = 0.5 * (out + inside);
                        if self
                            .above(from + along * middle)
                            .is_some_and(|above| above < 0.0)
                        {
                            inside = middle;
                        } else {
                            out = middle;
                        }
                    }
                    ground = Some(out);
                    break;
                }
                Some(above) => {
                    before = here;
                    here += (above * 0.35).max(0.25);
                }
                None => {
                    before = here;
                    here += 1.0;
                }
            }
        }
        let met = self
            .box_hit(from, along)
            .filter(|distance| *distance < reach);
        let on_ground = match (ground, met) {
            (None, None) => return None,
            (Some(ground), Some(met)) => ground <= met,
            (ground, _) => ground.is_some(),
        };
        let distance = if on_ground { ground } else { met }?;
        Some(Hit {
            point: from + along * distance,
            distance,
            on_ground,
        })
    }

    /// What each pixel's middle sees through Bevy's default perspective, row by row.
    pub fn look(&self, eye: &Transform, size: [u32; 2]) -> Vec<Option<Hit>> {
        let rays = rays(eye, size);
        rays.map(|along| self.cast(eye.translation, along, FAR_M))
            .collect()
    }

    /// Whether something stands between a point and a light, at a place or in a direction.
    pub fn in_shadow(&self, hit: &Hit, light: Light) -> bool {
        let from = hit.point + Vec3::Y * 0.3;
        match light {
            Light::Sun(towards) => self.cast(from, towards, FAR_M).is_some(),
            Light::Lamp(place) => {
                let way = place - from;
                self.cast(from, way.normalize(), way.length() - 1.0)
                    .is_some()
            }
        }
    }
}

#[derive(Clone, Copy)]
pub enum Light {
    Sun(Vec3),
    Lamp(Vec3),
}

impl Light {
    pub fn towards(self, point: Vec3) -> Vec3 {
        match self {
            Self::Sun(towards) => towards,
            Self::Lamp(place) => (place - point).normalize(),
        }
    }
}

fn rays(eye: &Transform, size: [u32; 2]) -> impl Iterator<Item = Vec3> + '_ {
    let half = (std::f32::consts::FRAC_PI_4 * 0.5).tan();
    let aspect = size[0] as f32 / size[1] as f32;
    (0..size[1]).flat_map(move |y| {
        (0..size[0]).map(move |x| {
            let right = (2.0 * (x as f32 + 0.5) / size[0] as f32 - 1.0) * half * aspect;
            let up = (1.0 - 2.0 * (y as f32 + 0.5) / size[1] as f32) * half;
            eye.rotation * Vec3::new(right, up, -1.0).normalize()
        })
    })
}

/// Pixels whose eight neighbours all say what `of` says of themselves.
pub fn interior<T: PartialEq>(size: [u32; 2], of: impl Fn(usize) -> T) -> Vec<usize> {
    let (across, down) = (size[0] as usize, size[1] as usize);
    let mut inside = Vec::new();
    for y in 1..down - 1 {
        for x in 1..across - 1 {
            let middle = of(y * across + x);
            let alike = (0..9).all(|n| of((y + n / 3 - 1) * across + x + n % 3 - 1) == middle);
            if alike {
                inside.push(y * across + x);
            }
        }
    }
    inside
}

pub fn pixel(picture: &RgbImage, index: usize) -> [u8; 3] {
    let across = picture.width();
    picture
        .get_pixel(index as u32 % across, index as u32 / across)
        .0
}

/// Linear light that a pixel stands for.
pub fn linear(pixel: [u8; 3]) -> Vec3 {
    let channel = |value: u8| {
        let value = f32::from(value) / 255.0;
        if value <= 0.04045 {
            value / 12.92
        } else {
            ((value + 0.055) / 1.055).powf(2.4)
        }
    };
    Vec3::from(pixel.map(channel))
}

pub fn brightness(pixel: [u8; 3]) -> f32 {
    pixel.iter().map(|channel| f32::from(*channel)).sum::<f32>() / 3.0
}

/// Mean over all pixels of their largest difference in a channel.
pub fn mean_difference(a: &RgbImage, b: &RgbImage) -> f32 {
    assert_eq!(a.dimensions(), b.dimensions());
    let sum: u64 = differences(a, b).map(u64::from).sum();
    sum as f32 / (a.width() * a.height()) as f32
}

/// Share of pixels that differ by more than `most` in a channel.
pub fn share_beyond(a: &RgbImage, b: &RgbImage, most: u8) -> f32 {
    let beyond = differences(a, b)
        .filter(|difference| *difference > most)
        .count();
    beyond as f32 / (a.width() * a.height()) as f32
}

fn differences<'a>(a: &'a RgbImage, b: &'a RgbImage) -> impl Iterator<Item = u8> + 'a {
    a.pixels().zip(b.pixels()).map(|(a, b)| {
        (0..3)
            .map(|channel| a.0[channel].abs_diff(b.0[channel]))
            .max()
            .unwrap_or(0)
    })
}

/// Whether what all neighbours of a pixel see is no farther than `most` from what it sees itself.
pub fn covered_around(hits: &[Option<Hit>], size: [u32; 2], index: usize, most: f32) -> bool {
    let (across, down) = (size[0] as usize, size[1] as usize);
    let (x, y) = (index % across, index / across);
    let Some(middle) = hits[index] else {
        return false;
    };
    x > 0
        && y > 0
        && x + 1 < across
        && y + 1 < down
        && (0..9).all(|n| {
            hits[(y + n / 3 - 1) * across + x + n % 3 - 1].is_some_and(|hit| {
                hit.on_ground == middle.on_ground && (hit.distance - middle.distance).abs() < most
            })
        })
}
