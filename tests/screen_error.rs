//! Under the screen-error policy no height that is drawn lies further beside that of the levels in
//! view than the policy allows, at any of their samples, unless the largest factor stopped it.

mod common;

use bevy_tessera::bake::{BakeSettings, MemorySource, bake};
use bevy_tessera::lattice::{Lattice, LodSettings, Node, ResidencyField, ViewLod};
use bevy_tessera::terrain::{GroundQuery, TerrainManifest};
use bevy_tessera::tessellate::{
    FACTOR_ONE, Face, FaceFactors, FactorView, Pages, Partitioning, TerrainVertex, ViewMesh,
};
use bevy_tessera::tile::TerrainTile;
use common::random::Random;
use glam::{DVec2, IVec2};
use std::sync::Arc;

const SIZE: u32 = 450;
const SPACING_M: f64 = 2.0;
const FOCAL_PX: f64 = 935.0;
const MAX_FACTOR: f32 = 64.0;

struct Ground {
    manifest: TerrainManifest,
    pages: Pages,
    field: ResidencyField,
    lattice: Lattice,
}

/// Ground with gentle and rough parts, ridges, and spikes of a single sample.
fn ground() -> Ground {
    let heights = (0..SIZE * SIZE)
        .map(|at| {
            let (x, z) = (f64::from(at % SIZE), f64::from(at / SIZE));
            let rough = ((x / 90.0).sin() * (z / 70.0).cos()).max(0.0);
            let mut hash = (at ^ 0x9e37).wrapping_mul(0x85eb_ca6b);
            hash ^= hash >> 13;
            hash = hash.wrapping_mul(0xc2b2_ae35);
            let noise = f64::from(hash >> 8) / f64::from(1 << 24) - 0.5;
            let ridge = 20.0 * (1.0 - ((x + 2.0 * z) / 60.0).sin().abs());
            let spike = if hash.is_multiple_of(5003) { 15.0 } else { 0.0 };
            (60.0 * (x / 150.0).sin() + 3.0 * rough * noise + ridge + spike + 100.0) as f32
        })
        .collect();
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("ground");
    let settings = BakeSettings {
        spacing_m: Some(SPACING_M),
        ..Default::default()
    };
    let mut source = MemorySource::new([SIZE, SIZE], heights).unwrap();
    bake(&mut source, &dir, &settings, &()).unwrap();
    let manifest = TerrainManifest::read(&dir).unwrap();
    let mut pages = Pages::default();
    for (address, _) in manifest.index.iter() {
        let bytes = std::fs::read(dir.join(TerrainTile::path(address))).unwrap();
        let tile = TerrainTile::decode(&bytes, address).unwrap();
        pages.tiles.insert(address, Arc::new(tile));
    }
    let lattice = Lattice::new(manifest.file.size, manifest.file.levels, -3, 8).unwrap();
    let field = ResidencyField::new(&lattice, 0);
    Ground {
        manifest,
        pages,
        field,
        lattice,
    }
}

/// What was found at samples: how many, how far the worst is beside what is allowed, and how many
/// were excused.
#[derive(Debug, Default)]
struct Found {
    samples: u64,
    worst: f64,
    excused: u64,
}

/// Compares a triangle with the heights at the samples of the levels that are drawn there.
fn compare(
    mesh: &ViewMesh<Pages>,
    corners: [TerrainVertex; 3],
    node: &Node,
    clamped: bool,
    max_px: f64,
    found: &mut Found,
) {
    let [a, b, c] = corners.map(|vertex| vertex.point.as_dvec2());
    let area = (b - a).perp_dot(c - a);
    if area == 0.0 {
        return;
    }
    let lattice = mesh.lattice;
    let lambda = corners.iter().map(|vertex| vertex.lambda).min().unwrap();
    let view = mesh.factor_view;
    let log2 = (lattice.unit_log2 as i32 + (lambda >> 16)) as u32;
    let low = corners.iter().fold(IVec2::MAX, |low, v| low.min(v.point));
    let high = corners.iter().fold(IVec2::MIN, |high, v| high.max(v.point));
    let first = (low + ((1 << log2) - 1)) >> IVec2::splat(log2 as i32);
    let last = high >> IVec2::splat(log2 as i32);
    let eye = view.eye.as_dvec2() + view.eye_fraction.as_dvec2();
    for z in first.y..=last.y {
        for x in first.x..=last.x {
            let sample = IVec2::new(x, z) << IVec2::splat(log2 as i32);
            let p = sample.as_dvec2();
            let weights = [(b - p).perp_dot(c - p), (c - p).perp_dot(a - p)].map(|w| w / area);
            let weights = [weights[0], weights[1], 1.0 - weights[0] - weights[1]];
            if weights.iter().any(|&weight| weight < -1e-9) {
                continue;
            }
            let drawn: f64 = (0..3)
                .map(|k| weights[k] * f64::from(corners[k].height_m))
                .sum();
            let height = f64::from(mesh.displaced(sample, node.level).0);
            let plane: DVec2 = (p - eye) * f64::from(view.unit_m);
            let distance = plane.length().hypot(height - f64::from(view.eye_height_m));
            let error_px = (drawn - height).abs() * FOCAL_PX / distance.max(0.01);
            found.samples += 1;
            if clamped {
                found.excused += u64::from(error_px > max_px);
            } else {
                found.worst = found.worst.max(error_px / max_px);
            }
        }
    }
}

fn look(
    ground: &Ground,
    eye_m: DVec2,
    above_m: f64,
    faces: u32,
    kind: Partitioning,
    max_px: f64,
) -> Found {
    let file = &ground.manifest.file;
    let lattice = ground.lattice.with_faces_per_side(faces).unwrap();
    let (eye, eye_fraction) = lattice.lattice_from_local(eye_m, file.spacing_m);
    let query = GroundQuery {
        lattice: &lattice,
        manifest: &ground.manifest,
    };
    let sample = (eye >> IVec2::splat(lattice.unit_log2 as i32))
        .clamp(IVec2::ZERO, IVec2::splat(SIZE as i32 - 1));
    let tile = &ground.pages.tiles
        [&bevy_tessera::tile::TileAddress::new(0, sample.x as u32 / 128, sample.y as u32 / 128)];
    let ground_m = file.height_m(tile.heights.get(sample.x % 128, sample.y % 128));
    let eye_height_m = ground_m + above_m;
    let floor = query.distance(eye, eye_height_m);
    let lod = ViewLod::new(&lattice, &LodSettings::default(), eye, floor, true).unwrap();
    let view = FactorView {
        eye,
        eye_fraction,
        eye_height_m: eye_height_m as f32,
        unit_m: lattice.unit_m(file.spacing_m) as f32,
        segments_per_radian: (FOCAL_PX / 8.0) as f32,
        segments_per_m: 0.0,
        min_triangle_m: f32::MIN_POSITIVE,
        max_factor: MAX_FACTOR,
        density_strength: 1.0,
        focal_px: FOCAL_PX as f32,
        px_per_m: 0.0,
        max_error_px: max_px as f32,
        error_units_per_m: file.error_units_per_m() as f32,
    };
    let mesh = ViewMesh {
        lattice: &lattice,
        lod: &lod,
        field: &ground.field,
        factor_view: &view,
        partitioning: kind,
        pages: &ground.pages,
        height_min_m: file.height_min_m as f32,
        height_step_m: file.height_step_m as f32,
        max_vertices: u32::MAX,
        max_triangles: u32::MAX,
        culling: None,
        detail: None,
    };
    let mut nodes = Vec::new();
    lod.select(&lattice, &mut |_, _| true, &mut |node| nodes.push(node));
    let mut found = Found::default();
    for node in &nodes {
        for number in 0..faces * faces {
            let factors: FaceFactors = mesh.classify(node, number);
            let limit = (MAX_FACTOR as u32) * FACTOR_ONE;
            let clamped = factors
                .edges
                .iter()
                .chain(&factors.inside)
                .any(|&f| f >= limit);
            let face = Face {
                corners: mesh.corners(node, number),
                factors,
                partitioning: kind,
            };
            let counts = face.counts();
            let vertices: Vec<TerrainVertex> = (0..counts.vertices())
                .map(|index| mesh.vertex(&face.vertex(&counts, index), node.level))
                .collect();
            for index in 0..counts.triangles() {
                let corners = face
                    .triangle(&counts, index)
                    .map(|vertex| vertices[vertex as usize]);
                compare(&mesh, corners, node, clamped, max_px, &mut found);
            }
        }
    }
    found
}

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes with overflow checks; release has it"
)]
fn no_sample_is_further_beside_than_allowed_from_fifty_eyes() {
    let ground = ground();
    let mut random = Random(41);
    let extent = f64::from(SIZE - 1) * SPACING_M;
    let mut worst = 0.0_f64;
    for n in 0..50 {
        let place = DVec2::new(random.unit().into(), random.unit().into()) * extent;
        let above_m = [1.7, 6.0, 40.0, 300.0][n % 4];
        let kind = Partitioning::ALL[n % Partitioning::ALL.len()];
        let max_px = [1.0, 2.0, 4.0, 8.0][(n / 4) % 4];
        let faces = [4, 8, 16][n % 3];
        let found = look(&ground, place, above_m, faces, kind, max_px);
        assert!(found.samples > 50_000);
        assert!(
            found.worst <= 1.0,
            "eye {n}, {kind:?}: {} times what is allowed",
            found.worst
        );
        worst = worst.max(found.worst);
        // Finer nodes exist so that the largest factor needn't stop anything.
        assert!(
            max_px < 2.0 || found.excused * 1000 <= found.samples,
            "eye {n}: {} of {} samples are excused",
            found.excused,
            found.samples
        );
    }
    // The bounds are no empty promise: what they allow is used.
    assert!(worst > 0.3, "{worst}");
}
