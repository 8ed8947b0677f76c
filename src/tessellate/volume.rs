//! What a view sees, as far as faces are concerned.

use glam::{Vec3, Vec4};

/// A convex volume in a terrain's own space, in metres: everything on the inner side of all
/// planes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LocalVolume {
    planes: [Vec4; 6],
    count: usize,
}

impl LocalVolume {
    /// The volume on the inner side of `planes`, each a normal and a distance: what is inside has
    /// `normal · place + distance >= 0`. More than six are ignored, which errs on the side of seeing
    /// more.
    #[must_use]
    pub fn from_planes(planes: impl IntoIterator<Item = Vec4>) -> Self {
        let mut volume = Self::default();
        for (place, plane) in volume.planes.iter_mut().zip(planes) {
            *place = plane;
            volume.count += 1;
        }
        volume
    }

    /// The planes; the rest of the six holds everything.
    #[must_use]
    pub fn planes(&self) -> [Vec4; 6] {
        let mut planes = [Vec4::W; 6];
        planes[..self.count].copy_from_slice(&self.planes[..self.count]);
        planes
    }

    /// Whether the box may reach into the volume. Errs on the side of yes.
    #[must_use]
    pub fn may_hold(&self, low: Vec3, high: Vec3) -> bool {
        self.planes[..self.count].iter().all(|plane| {
            let normal = plane.truncate();
            let farthest = Vec3::select(normal.cmpge(Vec3::ZERO), high, low);
            // A millimetre a kilometre makes up for rounding to f32.
            normal.dot(farthest) + plane.w >= -1e-6 * farthest.abs().max_element().max(1.0)
        })
    }
}
