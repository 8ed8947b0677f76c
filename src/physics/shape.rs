//! One collider's heights: where they come from, and the shape that is made of them.

use crate::edit::SampleRect;
use crate::stream::TerrainState;
use crate::terrain::ManifestFile;
use crate::tile::{HeightTile, TILE_SAMPLES, TILE_STORED, TileAddress};
use avian3d::parry::shape::{HeightField, HeightFieldFlags, SharedShape};
use avian3d::parry::utils::Array2;
use bevy::math::{DVec2, Vec3};

/// The square of level 0 samples that one collider covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// First sample, and one past the last: neighbours share the samples on their border.
    pub(super) rect: SampleRect,
    spacing_m: f64,
}

impl Place {
    /// The place of `chunk` (column, row) of `cells` cells a side, cut off at the terrain's last
    /// sample. `None` where nothing of it lies on the terrain.
    pub(super) fn new(file: &ManifestFile, cells: u32, chunk: [u32; 2]) -> Option<Self> {
        let along = |chunk: u32, size: u32| {
            let first = chunk.checked_mul(cells)?;
            let last = first.checked_add(cells)?.min(size - 1);
            // A single row of samples is no ground.
            let (first, end) = (i32::try_from(first).ok()?, i32::try_from(last).ok()? + 1);
            (end - first > 1).then_some([first, end])
        };
        let x = along(chunk[0], file.size[0])?;
        let z = along(chunk[1], file.size[1])?;
        let rect = SampleRect::new([x[0], z[0]], [x[1], z[1]]);
        Some(Self {
            rect,
            spacing_m: file.spacing_m,
        })
    }

    /// Samples in x and z.
    fn samples(&self) -> [usize; 2] {
        self.rect.size()
    }

    /// Middle of the square, in metres of the terrain's own x and z.
    fn middle_m(&self) -> DVec2 {
        let SampleRect { min, max } = self.rect;
        let sum = [0, 1].map(|axis| f64::from(min[axis]) + f64::from(max[axis] - 1));
        DVec2::from(sum) * 0.5 * self.spacing_m
    }

    /// Where the collider's entity stands in the terrain's space: in the middle of its square, at
    /// the height that the shape's heights are counted from.
    pub(super) fn translation(&self, base_m: f32) -> Vec3 {
        let middle = self.middle_m();
        Vec3::new(middle.x as f32, base_m, middle.y as f32)
    }

    /// What the shape, which is a unit wide, is multiplied with.
    fn scale(&self) -> Vec3 {
        let along = self.samples().map(|samples| {
            // The precision of `f32` is relative to the collider's own size.
            ((samples - 1) as f64 * self.spacing_m) as f32
        });
        Vec3::new(along[0], 1.0, along[1])
    }

    /// The samples in which two shapes at this place differ; `None` where they are the same.
    pub(super) fn difference(&self, a: &HeightField, b: &HeightField) -> Option<SampleRect> {
        let [_, rows] = self.samples();
        let columns = a.heights().data().chunks_exact(rows);
        let pairs = columns.zip(b.heights().data().chunks_exact(rows)).zip(0..);
        let differing = pairs.filter_map(|((a, b), column)| {
            let differs = |row: &usize| a[*row].to_bits() != b[*row].to_bits();
            let first = (0..rows).find(differs)? as i32;
            let last = (0..rows).rev().find(differs)? as i32;
            Some(SampleRect::new([column, first], [column + 1, last + 1]))
        });
        let rect = differing.reduce(|all, one| all.union(&one))?;
        let shift = |at: [i32; 2]| [at[0] + self.rect.min[0], at[1] + self.rect.min[1]];
        Some(SampleRect::new(shift(rect.min), shift(rect.max)))
    }

    /// The sample in a place of the terrain's own x and z, as a column and row of the shape, with
    /// fractions; `None` outside.
    pub(super) fn inside(&self, at_m: DVec2) -> Option<DVec2> {
        let first = DVec2::from(self.rect.min.map(f64::from));
        let last = DVec2::from(self.samples().map(|samples| (samples - 1) as f64));
        let at = at_m / self.spacing_m - first;
        (at.cmpge(DVec2::ZERO).all() && at.cmple(last).all()).then_some(at)
    }
}

/// The finest resident ground under a collider. Cheap to clone, for other threads.
#[derive(Clone, Debug)]
pub(super) struct Ground {
    pub(super) address: TileAddress,
    heights: HeightTile,
    height_min_m: f64,
    height_step_m: f64,
}

impl Ground {
    /// The finest tile that is resident under `place`, which never lies in two; `None` where not even
    /// the coarsest is.
    pub(super) fn under(place: &Place, state: &TerrainState) -> Option<Self> {
        let file = &state.manifest().file;
        let tile = place.rect.min.map(|first| first as u32 / TILE_SAMPLES);
        let finest = TileAddress::new(0, tile[0], tile[1]);
        let (address, data) = (0..file.levels).find_map(|level| {
            let address = finest.ancestor(level)?;
            Some((address, state.tile_data(address)?))
        })?;
        Some(Self {
            address,
            heights: data.heights.clone(),
            height_min_m: file.height_min_m,
            height_step_m: file.height_step_m,
        })
    }

    /// The height that a shape's heights are counted from, so that they are small numbers.
    pub(super) fn base_m(&self, place: &Place) -> f32 {
        let [x, z] = [0, 1].map(|axis| place.rect.min[axis]);
        let mut stored = [0.0];
        self.read(SampleRect::new([x, z], [x + 1, z + 1]), &mut |_, _, h| {
            stored[0] = h;
        });
        (self.height_min_m + stored[0] * self.height_step_m).round() as f32
    }

    /// Gives all stored heights of `rect`, in samples of level 0, to `take`: column and row counted
    /// from the rectangle's first, and the height, bilinear between the samples of the ground's level.
    fn read(&self, rect: SampleRect, take: &mut dyn FnMut(usize, usize, f64)) {
        let (first_x, first_z) = self.address.first_sample();
        let [columns, rows] = rect.size();
        if self.address.level == 0 {
            let border = crate::tile::TILE_BORDER as usize;
            let column = rect.min[0] as usize - first_x as usize + border;
            for row in 0..rows {
                let stored = rect.min[1] as usize + row - first_z as usize + border;
                let start = stored * TILE_STORED as usize + column;
                let samples = &self.heights.samples()[start..start + columns];
                for (column, &sample) in samples.iter().enumerate() {
                    take(column, row, f64::from(sample));
                }
            }
            return;
        }
        let spacing = f64::from(1_u32 << self.address.level);
        let along = |sample: i32, first: u32| {
            let at = f64::from(sample) / spacing - f64::from(first);
            let cell = at.floor().clamp(0.0, f64::from(TILE_SAMPLES - 1));
            (cell as i32, at - cell)
        };
        for row in 0..rows {
            let (z, part_z) = along(rect.min[1] + row as i32, first_z);
            for column in 0..columns {
                let (x, part_x) = along(rect.min[0] + column as i32, first_x);
                let corner = |dx: i32, dz: i32| f64::from(self.heights.get(x + dx, z + dz));
                let side = |dz: i32| corner(0, dz) + (corner(1, dz) - corner(0, dz)) * part_x;
                let near = side(0);
                take(column, row, near + (side(1) - near) * part_z);
            }
        }
    }

    /// Writes the heights of `rect` into those of a shape at `place`.
    fn write(&self, place: &Place, base_m: f32, rect: SampleRect, heights: &mut [f32]) {
        let rect = rect.intersection(&place.rect);
        if rect.is_empty() {
            return;
        }
        let [_, rows] = place.samples();
        let [column_0, row_0] = [0, 1].map(|axis| (rect.min[axis] - place.rect.min[axis]) as usize);
        let base_m = f64::from(base_m);
        // Columns follow one another: parry's rows run along x's own axis, z.
        self.read(rect, &mut |column, row, stored| {
            let height_m = self.height_min_m + stored * self.height_step_m;
            heights[(column_0 + column) * rows + row_0 + row] = (height_m - base_m) as f32;
        });
    }

    /// The shape at `place`, with heights counted from `base_m`.
    pub(super) fn shape(&self, place: &Place, base_m: f32) -> SharedShape {
        let [columns, rows] = place.samples();
        let mut heights = vec![0.0; columns * rows];
        self.write(place, base_m, place.rect, &mut heights);
        shape_of(place, heights)
    }

    /// The same where only the heights in `dirty` have changed since `known` was made at the same
    /// place, with the same base, of a tile of the same level.
    pub(super) fn changed_shape(
        &self,
        place: &Place,
        base_m: f32,
        known: &HeightField,
        dirty: SampleRect,
    ) -> SharedShape {
        let mut heights = known.heights().data().to_vec();
        self.write(place, base_m, dirty, &mut heights);
        shape_of(place, heights)
    }
}

/// A shape of heights column by column.
fn shape_of(place: &Place, heights: Vec<f32>) -> SharedShape {
    let [columns, rows] = place.samples();
    // Without it, bodies that slide catch on the edges between triangles.
    let flags = HeightFieldFlags::FIX_INTERNAL_EDGES;
    SharedShape::heightfield_with_flags(Array2::new(rows, columns, heights), place.scale(), flags)
}

/// The height of a shape at `at` (column and row, with fractions), bilinear, above its base.
pub(super) fn height_at(field: &HeightField, at: DVec2) -> f32 {
    let heights = field.heights();
    let along = |at: f64, count: usize| {
        let cell = at.floor().clamp(0.0, (count - 2) as f64);
        (cell as usize, (at - cell) as f32)
    };
    let (column, part_x) = along(at.x, heights.ncols());
    let (row, part_z) = along(at.y, heights.nrows());
    let side = |row: usize| {
        let near = heights[(row, column)];
        near + (heights[(row, column + 1)] - near) * part_x
    };
    let near = side(row);
    near + (side(row + 1) - near) * part_z
}
