//! The mesh is watertight: two triangles that meet anywhere meet in the same integers.

mod common;

use bevy_tessera::lattice::{Lattice, LodSettings, Node, ResidencyField, ViewLod};
use bevy_tessera::tessellate::{FactorView, HeightSource, Partitioning, ViewMesh};
use bevy_tessera::tile::TileAddress;
use common::manifold;
use glam::{IVec2, UVec2, Vec2};

/// Heights that differ between levels at every point, so that reading the wrong one shows.
struct Noise;

impl HeightSource for Noise {
    fn sample(&self, tile: TileAddress, x: i32, z: i32) -> Option<u16> {
        let x = i64::from(tile.x) * 128 + i64::from(x);
        let z = i64::from(tile.z) * 128 + i64::from(z);
        let hash = (x * 73 + z * 179 + i64::from(tile.level) * 977).wrapping_mul(2_654_435_761);
        Some(20_000 + ((hash >> 7) & 0xfff) as u16)
    }
}

/// A small deterministic random number generator; tests must not depend on a crate's sequence.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, bound: i32) -> i32 {
        (self.next() % bound.unsigned_abs() as u64) as i32
    }
}

struct Case {
    lattice: Lattice,
    settings: LodSettings,
}

fn cases() -> Vec<Case> {
    let case = |size, levels, leaf_level, faces, reach, morph| Case {
        lattice: Lattice::new(size, levels, leaf_level, faces).unwrap(),
        settings: LodSettings { reach, morph },
    };
    vec![
        case([4097, 4097], 6, 0, 4, 4.0, 1.0),
        case([3000, 2100], 6, 0, 4, 4.0, 1.0),
        case([1055, 995], 5, -2, 8, 3.0, 0.5),
        case([130, 700], 4, -3, 2, 5.5, 1.0),
    ]
}

/// A field in which every corner asks for a level of its own.
fn ragged_field(lattice: &Lattice, random: &mut Random) -> ResidencyField {
    let mut field = ResidencyField::new(lattice, 0);
    for corner in &mut field.corners {
        *corner = random.below((lattice.root_level + 1) << 8) as u16;
    }
    field
}

fn build(
    case: &Case,
    random: &mut Random,
    eye: IVec2,
    floor: i32,
    partitioning: Partitioning,
) -> Result<usize, String> {
    let Case { lattice, settings } = case;
    let lod = ViewLod::new(lattice, settings, eye, floor, true).unwrap();
    let mut nodes = Vec::new();
    lod.select(lattice, &mut |_, _| true, &mut |node: Node| nodes.push(node));
    let mut levels: Vec<i32> = nodes.iter().map(|node| node.level).collect();
    levels.sort_unstable();
    levels.dedup();
    let field = ragged_field(lattice, random);
    let view = FactorView {
        eye,
        eye_fraction: Vec2::new(0.25, 0.75),
        eye_height_m: 60.0,
        unit_m: lattice.unit_m(1.0) as f32,
        segments_per_radian: [12.0, 40.0, 90.0][random.below(3) as usize],
        segments_per_m: 0.0,
        min_triangle_m: 0.1,
        max_factor: 64.0,
    };
    let mesh = ViewMesh {
        lattice,
        lod: &lod,
        field: &field,
        factor_view: &view,
        partitioning,
        heights: &Noise,
        height_min_m: -100.0,
        height_step_m: 0.01,
        max_vertices: u32::MAX,
        max_triangles: u32::MAX,
    }
    .build(&nodes);
    manifold::check(lattice, &mesh.vertices, &mesh.triangles)?;
    Ok(levels.len())
}

#[test]
fn the_twin_is_watertight_from_everywhere() {
    let mut random = Random(7);
    let mut deep = 0;
    for case in cases() {
        for n in 0..12 {
            let extent = case.lattice.extent;
            let eye = IVec2::new(random.below(extent.x + extent.x / 2), random.below(extent.y));
            let leaf = case.lattice.node_size(case.lattice.leaf_level);
            let floor = [0, leaf / 3, 2 * leaf][random.below(3) as usize];
            let partitioning = [
                Partitioning::FractionalOdd,
                Partitioning::Integer,
                Partitioning::PowerOfTwo,
            ][n % 3];
            match build(&case, &mut random, eye, floor, partitioning) {
                Ok(levels) => deep += usize::from(levels >= 3),
                Err(wrong) => panic!("eye {eye}, floor {floor}, {partitioning:?}: {wrong}"),
            }
        }
    }
    assert!(deep >= 24, "only {deep} views of 48 had three levels in view");
}

#[test]
fn a_reach_without_room_for_the_morph_is_refused_because_it_tears() {
    let lattice = Lattice::new([4097, 4097], 6, 0, 4).unwrap();
    let settings = LodSettings {
        reach: 2.5,
        morph: 1.0,
    };
    let refused = ViewLod::new(&lattice, &settings, IVec2::ZERO, 0, true).unwrap_err();
    assert!(refused.to_string().contains("raise reach to at least 4"));
}

#[test]
fn the_last_point_of_a_terrain_lies_on_its_rim() {
    for case in cases() {
        let last = case.lattice.extent;
        let field = ResidencyField::new(&case.lattice, 2);
        assert_eq!(field.at(last), 2 << 8);
        assert!(field.cells.cmpge(UVec2::ONE).all());
    }
}
