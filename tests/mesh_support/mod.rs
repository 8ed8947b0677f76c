//! Readers of the mesh files that `tessera mesh` writes, and the twin's own mesh to compare with.

use bevy_tessera::lattice::{Lattice, ResidencyField, ViewLod};
use bevy_tessera::mesh_export::MeshSettings;
use bevy_tessera::terrain::{GroundQuery, TerrainManifest};
use bevy_tessera::tessellate::{FactorView, Pages, TerrainMesh, ViewMesh};
use bevy_tessera::tile::TerrainTile;
use glam::{DVec2, DVec3, IVec2, Vec3};
use serde_json::Value;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// What a file holds.
pub struct Parsed {
    /// In metres from the terrain's origin.
    pub positions: Vec<DVec3>,
    pub normals: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
}

pub fn obj(path: &Path) -> Parsed {
    let text = std::fs::read_to_string(path).expect("an OBJ file is text");
    let mut parsed = Parsed {
        positions: Vec::new(),
        normals: Vec::new(),
        triangles: Vec::new(),
    };
    for line in text.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        let numbers = || -> DVec3 {
            let axes: Vec<f64> = words[1..]
                .iter()
                .map(|word| word.parse().unwrap_or_else(|_| panic!("{line:?}")))
                .collect();
            DVec3::from_slice(axes[..].try_into().map(|axes: &[f64; 3]| axes).expect(line))
        };
        match words[0] {
            "#" | "o" => {}
            "v" => parsed.positions.push(numbers()),
            "vn" => parsed.normals.push(numbers().as_vec3()),
            "f" => {
                let corners: Vec<u32> = words[1..]
                    .iter()
                    .map(|word| {
                        let (vertex, normal) = word.split_once("//").expect(line);
                        assert_eq!(vertex, normal, "{line}");
                        vertex.parse::<u32>().expect(line) - 1
                    })
                    .collect();
                parsed.triangles.push(corners.try_into().expect(line));
            }
            _ => panic!("{line:?} is nothing that was expected"),
        }
    }
    parsed
}

/// Reads a binary glTF file, and checks what the format asks for.
pub fn glb(path: &Path) -> Parsed {
    let bytes = std::fs::read(path).expect("readable");
    let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("4"));
    assert_eq!(&bytes[..4], b"glTF");
    assert_eq!((number(4), number(8) as usize), (2, bytes.len()));
    let text = number(12) as usize;
    assert_eq!(&bytes[16..20], b"JSON");
    assert_eq!(text % 4, 0);
    let json: Value = serde_json::from_slice(&bytes[20..20 + text]).expect("JSON");
    let after = 20 + text;
    assert_eq!(&bytes[after + 4..after + 8], b"BIN\0");
    let binary = &bytes[after + 8..];
    assert_eq!(number(after) as usize, binary.len());
    assert_eq!(json["buffers"][0]["byteLength"], binary.len());
    assert_eq!(binary.len() % 4, 0);

    assert_eq!(json["asset"]["version"], "2.0");
    assert!(!json.to_string().contains("extras"));
    let node = &json["nodes"][json["scenes"][json["scene"].as_u64().expect("0") as usize]["nodes"]
        [0]
    .as_u64()
    .expect("0") as usize];
    let translation = vector(&node["translation"]);
    let mesh = &json["meshes"][node["mesh"].as_u64().expect("a mesh") as usize];
    let primitive = &mesh["primitives"][0];
    assert_eq!(mesh["primitives"].as_array().expect("a list").len(), 1);
    let read = |accessor: &Value, kind: &str, component: u32, target: u32| -> Vec<[u8; 4]> {
        let accessor = &json["accessors"][accessor.as_u64().expect("a number") as usize];
        assert_eq!(accessor["type"], kind);
        assert_eq!(accessor["componentType"], component);
        let view = &json["bufferViews"][accessor["bufferView"].as_u64().expect("one") as usize];
        assert_eq!(view["target"], target);
        let at = |name: &str| view[name].as_u64().expect("a number") as usize;
        let (first, length) = (at("byteOffset"), at("byteLength"));
        let axes = if kind == "VEC3" { 3 } else { 1 };
        assert_eq!(
            accessor["count"].as_u64().expect("a number") as usize * axes * 4,
            length
        );
        assert_eq!(first % 4, 0);
        let (words, _) = binary[first..first + length].as_chunks::<4>();
        words.to_vec()
    };
    let vectors = |words: Vec<[u8; 4]>| -> Vec<Vec3> {
        let (vectors, rest) = words.as_chunks::<3>();
        assert!(rest.is_empty());
        vectors
            .iter()
            .map(|axes| Vec3::from_array(axes.map(f32::from_le_bytes)))
            .collect()
    };
    let attributes = &primitive["attributes"];
    let positions = vectors(read(&attributes["POSITION"], "VEC3", 5126, 34962));
    let low = positions.iter().copied().reduce(Vec3::min).expect("some");
    let high = positions.iter().copied().reduce(Vec3::max).expect("some");
    let accessor = &json["accessors"][attributes["POSITION"].as_u64().expect("one") as usize];
    // serde_json may be off by the last bit of an `f64`.
    assert_eq!(vector(&accessor["min"]).as_vec3(), low);
    assert_eq!(vector(&accessor["max"]).as_vec3(), high);
    let corners: Vec<u32> = read(&primitive["indices"], "SCALAR", 5125, 34963)
        .into_iter()
        .map(u32::from_le_bytes)
        .collect();
    let (triangles, rest) = corners.as_chunks::<3>();
    assert!(rest.is_empty());
    Parsed {
        positions: positions
            .iter()
            .map(|position| position.as_dvec3() + translation)
            .collect(),
        normals: vectors(read(&attributes["NORMAL"], "VEC3", 5126, 34962)),
        triangles: triangles.to_vec(),
    }
}

fn vector(value: &Value) -> DVec3 {
    let axes = value.as_array().expect("a list");
    assert_eq!(axes.len(), 3);
    DVec3::from_array(std::array::from_fn(|axis| {
        axes[axis].as_f64().expect("a number")
    }))
}

pub fn lattice(manifest: &TerrainManifest, settings: &MeshSettings) -> Lattice {
    let file = &manifest.file;
    Lattice::new(
        file.size,
        file.levels,
        settings.leaf_level,
        settings.faces_per_side,
    )
    .expect("it fits")
}

/// The mesh that the twin builds with all tiles of the terrain resident.
pub fn twin(dir: &Path, settings: &MeshSettings, eye_m: DVec3) -> TerrainMesh {
    let manifest = TerrainManifest::read(dir).expect("a terrain");
    let file = &manifest.file;
    let lattice = lattice(&manifest, settings);
    let mut pages = Pages::default();
    for (address, _) in manifest.index.iter() {
        let bytes = std::fs::read(dir.join(TerrainTile::path(address))).expect("readable");
        let tile = TerrainTile::decode(&bytes, address).expect("good");
        pages.tiles.insert(address, Arc::new(tile));
    }
    let (eye, eye_fraction) =
        lattice.lattice_from_local(DVec2::new(eye_m.x, eye_m.z), file.spacing_m);
    let ground = GroundQuery {
        lattice: &lattice,
        manifest: &manifest,
    };
    let floor = ground.distance(eye, eye_m.y);
    let lod = ViewLod::new(&lattice, &settings.lod, eye, floor, true).expect("valid");
    let field = ResidencyField::new(&lattice, 0);
    let focal_px = 0.5 * settings.height_px / (0.5 * settings.fov_deg).to_radians().tan();
    let view = FactorView {
        eye,
        eye_fraction,
        eye_height_m: eye_m.y as f32,
        unit_m: lattice.unit_m(file.spacing_m) as f32,
        segments_per_radian: (focal_px / settings.triangle_width_px) as f32,
        segments_per_m: 0.0,
        min_triangle_m: settings.least_triangle_m(file.spacing_m) as f32,
        max_factor: settings.max_factor as f32,
        density_strength: settings.density as f32,
        focal_px: focal_px as f32,
        px_per_m: 0.0,
        max_error_px: settings.max_error_px.unwrap_or(0.0) as f32,
        error_units_per_m: (64.0 / file.height_step_m) as f32,
    };
    let mut nodes = Vec::new();
    lod.select(&lattice, &mut |_, _| true, &mut |node| nodes.push(node));
    ViewMesh {
        lattice: &lattice,
        lod: &lod,
        field: &field,
        factor_view: &view,
        partitioning: settings.partitioning,
        pages: &pages,
        height_min_m: file.height_min_m as f32,
        height_step_m: file.height_step_m as f32,
        max_vertices: settings.max_vertices,
        max_triangles: settings.max_triangles,
        culling: None,
        detail: None,
    }
    .build(&nodes)
}

/// A corner, by what tells it from others.
pub type Corner = (IVec2, u32);

/// How often each triangle is there that has an area seen from above.
pub fn count(triangles: impl IntoIterator<Item = [Corner; 3]>) -> HashMap<[Corner; 3], i32> {
    let mut counts = HashMap::new();
    let order = |corner: &Corner| (corner.0.x, corner.0.y, corner.1);
    for mut triangle in triangles {
        let [a, b, c] = triangle.map(|corner| corner.0);
        let [u, v] = [b - a, c - a].map(|d| (i64::from(d.x), i64::from(d.y)));
        if u.0 * v.1 == u.1 * v.0 {
            continue;
        }
        // The same triangle, whichever corner comes first.
        let first = (0..3).min_by_key(|&k| order(&triangle[k])).expect("three");
        triangle.rotate_left(first);
        *counts.entry(triangle).or_insert(0) += 1;
    }
    counts
}

/// Checks that every edge belongs to two triangles, once in each direction, but for those on the
/// terrain's rim, which belong to one. Returns how many lie there.
pub fn rim_edges(parsed: &Parsed, extent_m: DVec2) -> usize {
    let mut edges = HashMap::new();
    for triangle in &parsed.triangles {
        for k in 0..3 {
            let edge = (triangle[k], triangle[(k + 1) % 3]);
            assert!(edges.insert(edge, ()).is_none(), "{edge:?} is there twice");
        }
    }
    let mut rim = 0;
    for &(a, b) in edges.keys() {
        if edges.contains_key(&(b, a)) {
            continue;
        }
        let [a, b] = [a, b].map(|vertex| parsed.positions[vertex as usize]);
        let on_rim = |a: f64, b: f64, last: f64| {
            [0.0, last]
                .iter()
                .any(|rim| (a - rim).abs() < 1e-3 && (b - rim).abs() < 1e-3)
        };
        assert!(
            on_rim(a.x, b.x, extent_m.x) || on_rim(a.z, b.z, extent_m.y),
            "the edge from {a} to {b} belongs to one triangle"
        );
        rim += 1;
    }
    rim
}
