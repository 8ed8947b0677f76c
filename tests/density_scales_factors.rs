//! Edge factors follow the density map: none is larger than without it, plain ground gets the least,
//! the roughest all; an edge reads both faces beside it; a crater in a face's middle is seen; and
//! nothing jumps while the eye moves.

mod common;

use bevy_tessera::lattice::{Lattice, LodSettings, Node, ResidencyField, ViewLod};
use bevy_tessera::tessellate::{
    DENSITY_ONE, DensityReader, FACTOR_ONE, FactorView, PageSource, Partitioning, ViewMesh,
};
use bevy_tessera::tile::TileAddress;
use common::random::Random;
use glam::{IVec2, Vec2};

/// Rolling heights, and densities that a function of level and texel gives; every tile is there.
struct Ground<F>(F);

impl<F: Fn(u8, i32, i32) -> u8> PageSource for Ground<F> {
    fn errors(&self, _: TileAddress, _: i32, _: i32) -> Option<[u8; 8]> {
        None
    }

    fn height(&self, tile: TileAddress, x: i32, z: i32) -> Option<u16> {
        let (x, z) = (
            (tile.x as i32 * 128 + x) << tile.level,
            (tile.z as i32 * 128 + z) << tile.level,
        );
        let height = (x as f32 * 0.01).sin() * 2000.0 + (z as f32 * 0.013).cos() * 1500.0;
        Some((height + 20_000.0) as u16)
    }

    fn density(&self, tile: TileAddress, x: i32, z: i32) -> Option<u8> {
        let texel = |tile: u32, local: i32| tile as i32 * 32 + local;
        Some((self.0)(tile.level, texel(tile.x, x), texel(tile.z, z)))
    }
}

fn lattice(faces_per_side: u32) -> Lattice {
    Lattice::new([2049, 2049], 5, 0, faces_per_side).unwrap()
}

fn lod(lattice: &Lattice, eye: IVec2) -> ViewLod {
    ViewLod::new(lattice, &LodSettings::default(), eye, 0, true).unwrap()
}

fn nodes(lattice: &Lattice, lod: &ViewLod) -> Vec<Node> {
    let mut nodes = Vec::new();
    lod.select(lattice, &mut |_, _| true, &mut |node| nodes.push(node));
    nodes
}

fn view(lattice: &Lattice, eye: IVec2, density_strength: f32) -> FactorView {
    FactorView {
        eye,
        eye_fraction: Vec2::ZERO,
        eye_height_m: 250.0,
        unit_m: lattice.unit_m(1.0) as f32,
        segments_per_radian: 120.0,
        segments_per_m: 0.0,
        min_triangle_m: 0.5,
        max_factor: 64.0,
        density_strength,
        focal_px: 900.0,
        px_per_m: 0.0,
        max_error_px: 0.0,
        error_units_per_m: 6400.0,
    }
}

/// Calls `check` with the factors of every face, without the map and with it.
fn compare(
    density: impl Fn(u8, i32, i32) -> u8,
    strength: f32,
    mut check: impl FnMut([u32; 6], [u32; 6]),
) {
    let lattice = lattice(8);
    let eye = IVec2::new(700 << lattice.unit_log2, 900 << lattice.unit_log2);
    let lod = lod(&lattice, eye);
    let field = ResidencyField::new(&lattice, 0);
    let ground = Ground(density);
    let (plain, scaled) = (view(&lattice, eye, 0.0), view(&lattice, eye, strength));
    let mesh = |factor_view| ViewMesh {
        lattice: &lattice,
        lod: &lod,
        field: &field,
        factor_view,
        partitioning: Partitioning::FractionalOdd,
        pages: &ground,
        height_min_m: 0.0,
        height_step_m: 0.01,
        max_vertices: u32::MAX,
        max_triangles: u32::MAX,
        culling: None,
        detail: None,
    };
    let (plain, scaled) = (mesh(&plain), mesh(&scaled));
    for node in nodes(&lattice, &lod) {
        for face in 0..64 {
            let all = |mesh: &ViewMesh<'_, _>| {
                let factors = mesh.classify(&node, face);
                let [a, b, c, d] = factors.edges;
                [a, b, c, d, factors.inside[0], factors.inside[1]]
            };
            check(all(&plain), all(&scaled));
        }
    }
}

#[test]
fn plain_ground_gets_the_least_and_the_roughest_gets_all() {
    let mut tessellated = 0;
    compare(
        |_, _, _| 0,
        1.0,
        |without, with| {
            assert_eq!(with, [FACTOR_ONE; 6]);
            tessellated += usize::from(without.iter().any(|&factor| factor > 3 * FACTOR_ONE));
        },
    );
    assert!(
        tessellated > 500,
        "only {tessellated} faces had something to lose"
    );
    compare(
        |_, _, _| 255,
        1.0,
        |without, with| assert_eq!(with, without),
    );
}

#[test]
fn the_map_never_raises_a_factor_and_its_strength_blends() {
    let hash = |level: u8, x: i32, z: i32| {
        let hash = (x.wrapping_mul(73) ^ z.wrapping_mul(179)) + 7 * i32::from(level);
        (hash.wrapping_mul(0x2545_f491) >> 11) as u8
    };
    let mut lowered = 0;
    compare(hash, 1.0, |without, with| {
        for (without, with) in without.into_iter().zip(with) {
            assert!(with <= without);
            lowered += usize::from(with < without);
        }
    });
    assert!(lowered > 1000);
    // With half the strength, half-way between.
    let half = |_: u8, _: i32, _: i32| 51;
    compare(half, 0.5, |without, with| {
        for (without, with) in without.into_iter().zip(with) {
            let wanted = (f64::from(without) * 0.6).max(f64::from(FACTOR_ONE));
            // Edges at their length's or the view's limit start from more than they show.
            let limited = without == 64 * FACTOR_ONE || f64::from(with) > wanted;
            assert!(
                limited || (f64::from(with) - wanted).abs() <= 2.0,
                "{without}: {with}"
            );
        }
    });
}

/// A crater around a face's middle touches no edge, and yet all of them are cut finer.
#[test]
fn a_crater_in_the_middle_of_a_face_raises_all_its_factors() {
    for faces_per_side in [2, 4, 8, 16, 32] {
        let lattice = lattice(faces_per_side);
        let eye = IVec2::splat(1024 << lattice.unit_log2);
        let lod = lod(&lattice, eye);
        let field = ResidencyField::new(&lattice, 0);
        let mut seen = 0;
        for node in nodes(&lattice, &lod) {
            let step = lattice.face_size(node.level);
            // A face in the node's middle, and what lies in its middle.
            let ij = IVec2::splat(faces_per_side as i32 / 2);
            let middle = node.origin + ij * step + step / 2;
            let place = |offset: IVec2| lattice.clamp(middle + offset * step);
            let corners = [
                -IVec2::ONE,
                IVec2::new(1, -1),
                IVec2::ONE,
                IVec2::new(-1, 1),
            ];
            let still = |offset| lod.morph(&lattice, place(offset), node.level) == 0;
            if middle.cmpge(lattice.extent).any() || !corners.into_iter().all(still) {
                continue;
            }
            seen += 1;
            // The map's levels are maxima of the finest, so a crater shows in all of them.
            let crater = Ground(|level: u8, x: i32, z: i32| {
                let log2 = lattice.unit_log2 + 2 + u32::from(level);
                let texel = |at: IVec2| at >> IVec2::splat(log2 as i32);
                let (low, high) = (texel(middle - 1), texel(middle));
                let at = IVec2::new(x, z);
                let hit = at.cmpge(low).all() && at.cmple(high).all();
                if hit { 255 } else { 0 }
            });
            let reader = DensityReader {
                lattice: &lattice,
                lod: &lod,
                field: &field,
                source: &crater,
            };
            let corners = [IVec2::ZERO, IVec2::X, IVec2::ONE, IVec2::Y];
            for e in 0..4 {
                let (a, b) = (ij + corners[e], ij + corners[(e + 1) % 4]);
                let density = reader.edge_density(node.level, node.origin, a, b);
                assert_eq!(
                    density, DENSITY_ONE,
                    "edge {e} of a face of level {}",
                    node.level
                );
            }
            let inside = reader.face_density(node.level, node.origin, ij);
            assert_eq!(
                inside, DENSITY_ONE,
                "the inside of a face of level {}",
                node.level
            );
            // Two faces away nothing of it is left, where texels are as fine as faces.
            if faces_per_side <= 8 && node.level < lattice.root_level - 2 {
                let far = ij - IVec2::new(3.min(ij.x), 0);
                let density = reader.face_density(node.level, node.origin, far);
                assert!(
                    ij.x < 3 || density < DENSITY_ONE,
                    "a crater three faces away"
                );
            }
        }
        assert!(
            seen > 3,
            "only {seen} nodes of {faces_per_side} faces a side stood still"
        );
    }
}

/// While the eye moves by small steps, densities move by small steps: by no more than the morph.
#[test]
fn densities_move_with_the_morph_and_never_jump() {
    let lattice = lattice(8);
    let hash = |level: u8, x: i32, z: i32| {
        let hash = (x.wrapping_mul(92_837) ^ z.wrapping_mul(68_917)) + 31 * i32::from(level);
        (hash.wrapping_mul(0x2545_f491) >> 13) as u8
    };
    let field = ResidencyField::new(&lattice, 0);
    let ground = Ground(hash);
    let mut random = Random(3);
    let mut moved = 0;
    for _ in 0..300 {
        let level = random.below(3);
        let side = lattice.node_size(level);
        let origin = IVec2::new(random.below(2), random.below(2)) * side;
        let a = IVec2::new(random.below(8), random.below(8));
        let b = a + [IVec2::X, IVec2::Y][random.below(2) as usize];
        let start = random.below(4 * side);
        let density = |eye: i32| {
            let lod = lod(&lattice, IVec2::new(origin.x + 3 * side + eye, origin.y));
            let reader = DensityReader {
                lattice: &lattice,
                lod: &lod,
                field: &field,
                source: &ground,
            };
            let faces = reader.face_density(level, origin, a);
            [reader.edge_density(level, origin, a, b), faces]
        };
        // A thousandth of a node, of which the morph zone is as long as one.
        let step = side / 1024;
        let (before, after) = (density(start), density(start + step));
        for (before, after) in before.into_iter().zip(after) {
            let change = before.abs_diff(after);
            assert!(change <= DENSITY_ONE / 900, "a step of {change}");
            moved += usize::from(change > 0);
        }
    }
    assert!(moved > 20, "only {moved} densities moved at all");
}

/// What isn't resident is read from what is, and the field's values decide: never a tile that the
/// field doesn't promise.
#[test]
fn densities_are_never_read_finer_than_the_field_says() {
    struct Watched {
        finest: i32,
    }
    impl PageSource for Watched {
        fn errors(&self, _: TileAddress, _: i32, _: i32) -> Option<[u8; 8]> {
            None
        }

        fn height(&self, _: TileAddress, _: i32, _: i32) -> Option<u16> {
            None
        }

        fn density(&self, tile: TileAddress, _: i32, _: i32) -> Option<u8> {
            assert!(i32::from(tile.level) >= self.finest, "tile {tile} was read");
            Some(100 + tile.level)
        }
    }
    let lattice = lattice(16);
    let lod = lod(&lattice, IVec2::ZERO);
    for eighths in 0..=4 * 8 {
        let mut field = ResidencyField::new(&lattice, 0);
        field.corners.fill(eighths * 32);
        let source = Watched {
            finest: i32::from(eighths) / 8,
        };
        let reader = DensityReader {
            lattice: &lattice,
            lod: &lod,
            field: &field,
            source: &source,
        };
        let density = reader.face_density(0, IVec2::ZERO, IVec2::new(3, 5));
        // Blended as the field says, between two levels.
        let wanted = f64::from(DENSITY_ONE) / 255.0 * (100.0 + f64::from(eighths) / 8.0);
        assert!(
            (f64::from(density) - wanted).abs() <= 256.0,
            "{density}, {wanted}"
        );
    }
}
