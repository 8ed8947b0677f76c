//! `tessera mesh` and `export_mesh`: what is written is what a camera sees, whole and watertight.

mod bake_support;
mod mesh_support;

use bake_support::{entries, landscape, manifest};
use bevy_tessera::bake::{BakeSettings, MemorySource, bake};
use bevy_tessera::lattice::LodSettings;
use bevy_tessera::mesh_export::{MeshError, MeshEye, MeshReport, MeshSettings, export_mesh};
use bevy_tessera::tessellate::Partitioning;
use bevy_tessera::tile::{TileAddress, tile_path};
use glam::{DVec2, DVec3, Vec3};
use mesh_support::{Corner, Parsed, count, glb, lattice, obj, rim_edges, twin};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const SIZE: [u32; 2] = [420, 330];
const SPACING_M: f64 = 1.5;

/// A folder with a terrain in it.
struct Stage {
    folder: tempfile::TempDir,
}

impl Stage {
    fn new(size: [u32; 2], heights: Vec<f32>) -> Self {
        let stage = Self {
            folder: tempfile::tempdir().expect("a temporary folder"),
        };
        let mut source = MemorySource::new(size, heights)
            .expect("as many as the size says")
            .with_spacing_m(SPACING_M);
        bake(&mut source, &stage.terrain(), &BakeSettings::default(), &()).expect("baked");
        stage
    }

    fn rough() -> Self {
        Self::new(SIZE, landscape(SIZE, 5))
    }

    fn terrain(&self) -> PathBuf {
        self.folder.path().join("terrain")
    }

    fn out(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn export(&self, name: &str, settings: &MeshSettings) -> Result<MeshReport, MeshError> {
        export_mesh(&self.terrain(), &self.out(name), settings, &|_, _| {})
    }

    /// Writes and reads both formats.
    fn both(&self, settings: &MeshSettings) -> (MeshReport, Parsed, Parsed) {
        let report = self.export("mesh.obj", settings).expect("written");
        let same = self.export("mesh.glb", settings).expect("written");
        assert_eq!(report.triangles, same.triangles);
        for (name, report) in [("mesh.obj", &report), ("mesh.glb", &same)] {
            let length = fs::metadata(self.out(name)).expect("there").len();
            assert_eq!(report.bytes, length);
        }
        (
            report,
            obj(&self.out("mesh.obj")),
            glb(&self.out("mesh.glb")),
        )
    }

    fn extent_m(&self) -> DVec2 {
        DVec2::new(f64::from(SIZE[0] - 1), f64::from(SIZE[1] - 1)) * SPACING_M
    }

    fn tile(&self, address: TileAddress) -> PathBuf {
        self.terrain().join(tile_path(address))
    }
}

fn at(x: f64, y: f64, z: f64) -> MeshSettings {
    MeshSettings::new(MeshEye::At(DVec3::new(x, y, z)))
}

fn above(x: f64, z: f64, above_m: f64) -> MeshSettings {
    MeshSettings::new(MeshEye::AboveGround {
        place_m: DVec2::new(x, z),
        above_m,
    })
}

/// Views that differ in everything.
fn views() -> Vec<MeshSettings> {
    let mut views: Vec<MeshSettings> = Partitioning::ALL
        .into_iter()
        .map(|partitioning| MeshSettings {
            partitioning,
            triangle_width_px: 15.0,
            ..above(300.0, 410.0, 2.0)
        })
        .collect();
    // Three levels of detail in view.
    views.push(MeshSettings {
        lod: LodSettings {
            reach: 2.125,
            morph: 0.0625,
        },
        leaf_level: -2,
        triangle_width_px: 20.0,
        ..above(300.0, 410.0, 2.0)
    });
    views.push(MeshSettings {
        leaf_level: -2,
        faces_per_side: 4,
        triangle_width_px: 20.0,
        min_triangle_m: Some(0.3),
        density: 0.0,
        ..above(571.3, 96.1, 0.4)
    });
    views.push(at(-900.0, 400.0, 2000.0));
    views.push(MeshSettings {
        max_triangles: 20_000,
        ..at(500.0, 60.0, 300.0)
    });
    views.push(at(100.0, 5000.0, 100.0));
    views
}

/// The lattice point and the height of every corner.
fn corners(stage: &Stage, settings: &MeshSettings, parsed: &Parsed) -> Vec<Corner> {
    let manifest = manifest(&stage.terrain());
    let unit_m = lattice(&manifest, settings).unit_m(SPACING_M);
    let corner = |position: &DVec3| {
        let point = DVec2::new(position.x, position.z) / unit_m;
        assert!((point - point.round()).abs().max_element() < 0.4, "{point}");
        (
            point.round().as_ivec2(),
            (position.y as f32 + 0.0).to_bits(),
        )
    };
    parsed.positions.iter().map(corner).collect()
}

#[test]
fn the_file_holds_the_triangles_that_the_twin_draws() {
    let stage = Stage::rough();
    for settings in views() {
        let (report, obj, glb) = stage.both(&settings);
        let mesh = twin(&stage.terrain(), &settings, report.eye_m);
        assert_eq!(report.scale, mesh.scale);
        let corners = corners(&stage, &settings, &obj);
        let found = count(
            obj.triangles
                .iter()
                .map(|triangle| triangle.map(|vertex| corners[vertex as usize])),
        );
        let of = |vertex: u32| {
            let vertex = &mesh.vertices[vertex as usize];
            (vertex.point, (vertex.height_m + 0.0).to_bits())
        };
        let wanted = count(mesh.triangles.iter().map(|triangle| triangle.map(of)));
        assert_eq!(found.len(), wanted.len(), "{settings:?}");
        assert!(found == wanted, "{settings:?}");
        assert!(found.len() > 500, "{} triangles", found.len());

        // Both formats: the same in the same order.
        assert_eq!(obj.triangles, glb.triangles);
        assert_eq!(obj.positions.len(), glb.positions.len());
        for (a, b) in obj.positions.iter().zip(&glb.positions) {
            assert!((*a - *b).abs().max_element() < 1e-3, "{a} {b}");
        }
        for (a, b) in obj.normals.iter().zip(&glb.normals) {
            assert!((*a - *b).abs().max_element() < 1e-4, "{a} {b}");
        }
        assert_eq!(report.vertices as usize, obj.positions.len());
        assert_eq!(report.triangles as usize, obj.triangles.len());
    }
}

#[test]
fn the_file_is_watertight_and_no_vertex_is_there_twice() {
    let stage = Stage::rough();
    for settings in views() {
        let (_, obj, glb) = stage.both(&settings);
        let rim = rim_edges(&obj, stage.extent_m());
        assert!(rim > 20, "{rim} edges on the rim");
        assert_eq!(rim_edges(&glb, stage.extent_m()), rim);
        let mut corners = corners(&stage, &settings, &obj);
        let all = corners.len();
        corners.sort_by_key(|corner| (corner.0.x, corner.0.y, corner.1));
        corners.dedup();
        assert_eq!(corners.len(), all);
    }
}

#[test]
fn triangles_are_counter_clockwise_from_above_and_normals_point_away_from_the_ground() {
    // Rising by a third of a metre a metre in x, and falling in z.
    let heights = (0..SIZE[0] * SIZE[1])
        .map(|at| (at % SIZE[0]) as f32 * 0.5 - (at / SIZE[0]) as f32 * 0.25)
        .collect();
    let plane = Stage::new(SIZE, heights);
    let (_, _, parsed) = plane.both(&above(300.0, 410.0, 2.0));
    let slope = Vec3::new(-0.5 / SPACING_M as f32, 1.0, 0.25 / SPACING_M as f32).normalize();
    for normal in &parsed.normals {
        assert!(normal.distance(slope) < 0.02, "{normal} for {slope}");
    }
    let (_, _, parsed) = Stage::rough().both(&above(300.0, 410.0, 2.0));
    for normal in &parsed.normals {
        assert!(
            (normal.length() - 1.0).abs() < 1e-4 && normal.y > 0.0,
            "{normal}"
        );
    }
    let mut area = 0.0;
    for triangle in &parsed.triangles {
        let [a, b, c] = triangle.map(|vertex| parsed.positions[vertex as usize]);
        let up = (b - a).cross(c - a).y;
        assert!(up > -0.01, "a triangle is turned over");
        area += 0.5 * up;
    }
    let extent_m = plane.extent_m();
    assert!(
        (area / (extent_m.x * extent_m.y) - 1.0).abs() < 1e-6,
        "{area}"
    );
}

#[test]
fn above_puts_the_eye_over_the_ground_that_is_there() {
    let stage = Stage::new(SIZE, vec![17.5; (SIZE[0] * SIZE[1]) as usize]);
    let report = stage
        .export("mesh.obj", &above(300.0, 400.0, 3.0))
        .expect("written");
    assert!(
        report.eye_m.distance(DVec3::new(300.0, 20.5, 400.0)) < 0.01,
        "{}",
        report.eye_m
    );
    let report = stage
        .export("mesh.obj", &above(-50.0, 9e3, 3.0))
        .expect("written");
    assert!(
        report.eye_m.distance(DVec3::new(-50.0, 20.5, 9e3)) < 0.01,
        "{}",
        report.eye_m
    );
}

#[test]
fn only_the_tiles_that_the_view_needs_are_read() {
    let size = [2100, 300];
    let stage = Stage::new(size, landscape(size, 2));
    let settings = at(10.0, 60.0, 200.0);
    let whole = stage.export("whole.obj", &settings).expect("written");
    assert!(whole.tiles_read * 4 < whole.tiles * 3, "{whole:?}");
    fs::remove_file(stage.tile(TileAddress::new(0, 16, 1))).expect("it was there");
    let report = stage.export("mesh.obj", &settings).expect("written");
    assert_eq!(
        (report.tiles_read, report.warnings),
        (whole.tiles_read, vec![])
    );
    assert!(
        fs::read(stage.out("whole.obj")).expect("there")
            == fs::read(stage.out("mesh.obj")).expect("there")
    );
}

#[test]
fn ground_that_cannot_be_read_has_its_parents_shape_and_is_told_of() {
    let stage = Stage::rough();
    let settings = above(300.0, 410.0, 2.0);
    stage.export("good.obj", &settings).expect("written");
    let bad = stage.tile(TileAddress::new(0, 1, 2));
    fs::write(&bad, "damaged").expect("written");
    let (report, parsed, _) = stage.both(&settings);
    assert_eq!(report.warnings.len(), 1);
    let warning = &report.warnings[0];
    assert!(warning.starts_with(&bad.display().to_string()), "{warning}");
    assert!(warning.ends_with("its parent's shape is used"), "{warning}");
    rim_edges(&parsed, stage.extent_m());
    assert!(
        fs::read(stage.out("good.obj")).expect("there")
            != fs::read(stage.out("mesh.obj")).expect("there")
    );

    let root = TileAddress::new(manifest(&stage.terrain()).file.levels - 1, 0, 0);
    fs::remove_file(stage.tile(root)).expect("it was there");
    let far = at(100.0, 5000.0, 100.0);
    let error = stage
        .export("none.obj", &far)
        .expect_err("refused")
        .to_string();
    assert!(
        error.contains("coarsest tile is not there; bake it again: "),
        "{error}"
    );
    assert!(!stage.out("none.obj").exists());
}

#[test]
fn progress_counts_every_face_twice() {
    let stage = Stage::rough();
    let done = std::sync::atomic::AtomicU64::new(0);
    let all = std::sync::atomic::AtomicU64::new(0);
    let order = std::sync::atomic::Ordering::Relaxed;
    export_mesh(
        &stage.terrain(),
        &stage.out("mesh.obj"),
        &above(300.0, 410.0, 2.0),
        &|faces, of| {
            done.fetch_add(faces, order);
            all.store(of, order);
        },
    )
    .expect("written");
    assert_eq!(done.load(order), all.load(order));
    assert!(done.load(order) > 100);
}

#[test]
fn settings_out_of_range_are_refused_with_the_range() {
    let stage = Stage::new([5, 3], vec![1.0; 15]);
    let plain = || at(1.0, 2.0, 3.0);
    let bad = [
        (
            MeshSettings {
                density: 1.5,
                ..plain()
            },
            "density is 1.5: use a number from 0 to 1",
        ),
        (
            MeshSettings {
                triangle_width_px: 0.0,
                ..plain()
            },
            "triangle width in pixels is 0: use a number from 1 to 256",
        ),
        (
            MeshSettings {
                height_px: f64::NAN,
                ..plain()
            },
            "viewport's height in pixels is NaN",
        ),
        (
            MeshSettings {
                fov_deg: 180.0,
                ..plain()
            },
            "from 1 to 179",
        ),
        (
            MeshSettings {
                max_factor: 65.0,
                ..plain()
            },
            "from 1 to 64",
        ),
        (
            MeshSettings {
                min_triangle_m: Some(0.0),
                ..plain()
            },
            "least triangle in metres is 0",
        ),
        (
            MeshSettings {
                max_vertices: 5,
                ..plain()
            },
            "from 1024 to 16777216",
        ),
        (
            MeshSettings {
                max_triangles: 5,
                ..plain()
            },
            "from 1024 to 33554432",
        ),
        (
            MeshSettings {
                faces_per_side: 3,
                ..plain()
            },
            "faces_per_side is 3: use a power of two",
        ),
        (
            MeshSettings {
                leaf_level: 1,
                ..plain()
            },
            "leaf_level is 1: use 0",
        ),
        (at(f64::INFINITY, 0.0, 0.0), "eye's x is inf"),
        (above(0.0, f64::NAN, 0.0), "eye's z is NaN"),
    ];
    for (settings, words) in bad {
        let error = stage
            .export("mesh.obj", &settings)
            .expect_err("refused")
            .to_string();
        assert!(error.contains(words), "{error}");
    }
    let mut short = plain();
    short.lod.reach = 3.0;
    let error = stage
        .export("mesh.obj", &short)
        .expect_err("refused")
        .to_string();
    assert!(error.contains("raise reach to at least 4"), "{error}");
    assert_eq!(entries(stage.folder.path()), ["terrain"]);
}

#[test]
fn only_meshes_and_empty_files_are_replaced_unless_forced() {
    let stage = Stage::new([5, 3], vec![1.0; 15]);
    let settings = at(1.0, 2.0, 3.0);
    for name in ["mesh.obj", "mesh.glb"] {
        let out = stage.out(name);
        fs::write(&out, "").expect("written");
        stage
            .export(name, &settings)
            .expect("empty files are replaced");
        let written = fs::read(&out).expect("there");
        stage.export(name, &settings).expect("meshes are replaced");
        for foreign in [&b"# my model\nv 0 0 0\n"[..], b"glTF\x02\0\0\0", &[0]] {
            fs::write(&out, foreign).expect("written");
            let error = stage.export(name, &settings).expect_err("refused");
            assert!(matches!(error, MeshError::OutputExists { .. }));
            let text = error.to_string();
            assert!(
                text.ends_with("exists and is no mesh that tessera wrote, so it isn't replaced; choose another --out, or --force"),
                "{text}"
            );
            assert_eq!(fs::read(&out).expect("still there"), foreign);
            let force = MeshSettings {
                force: true,
                ..settings.clone()
            };
            stage.export(name, &force).expect("forced");
            assert!(fs::read(&out).expect("there") == written);
        }
    }
    assert_eq!(
        entries(stage.folder.path()),
        ["mesh.glb", "mesh.obj", "terrain"]
    );
}

#[test]
fn a_failed_export_leaves_what_was_there() {
    let stage = Stage::new([5, 3], vec![1.0; 15]);
    let settings = MeshSettings {
        force: true,
        ..at(1.0, 2.0, 3.0)
    };
    stage.export("mesh.obj", &settings).expect("written");
    let refused = |name: &str, words: &str| {
        let error = stage
            .export(name, &settings)
            .expect_err("refused")
            .to_string();
        assert!(error.contains(words), "{error}");
        assert_eq!(entries(stage.folder.path()), ["mesh.obj", "terrain"]);
    };
    refused("mesh.stl", "ends in .obj (Wavefront) or .glb (binary glTF)");
    refused("mesh", "ends in .obj");
    refused(".obj", "ends in .obj");
    refused("terrain", "is a folder");
    refused("terrain/terrain.ron", "a part of a terrain");
    refused("terrain/tiles.index", "a part of a terrain");
    refused(
        "missing/mesh.obj",
        "missing; make it, or choose another --out",
    );
    refused(&("n".repeat(300) + ".glb"), "; choose another --out");
    let nowhere = export_mesh(
        Path::new("/nowhere"),
        &stage.out("mesh.obj"),
        &settings,
        &|_, _| {},
    );
    let text = nowhere.expect_err("refused").to_string();
    assert!(
        text.starts_with("/nowhere is no terrain that can be used"),
        "{text}"
    );
    assert!(stage.out("mesh.obj").exists());
}

fn tessera(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tessera"))
        .args(arguments)
        .output()
        .expect("tessera runs")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn the_tool_writes_what_the_library_writes_for_every_option() {
    let stage = Stage::rough();
    let settings = MeshSettings {
        triangle_width_px: 9.0,
        height_px: 720.0,
        fov_deg: 45.0,
        density: 0.5,
        partitioning: Partitioning::FractionalEven,
        max_factor: 32.0,
        min_triangle_m: Some(0.75),
        leaf_level: -1,
        faces_per_side: 4,
        max_vertices: 100_000,
        max_triangles: 150_000,
        lod: LodSettings {
            reach: 5.0,
            morph: 0.5,
        },
        ..above(300.0, 410.0, 2.0)
    };
    stage.export("wanted.glb", &settings).expect("written");
    let [dir, out] =
        [stage.terrain(), stage.out("mesh.glb")].map(|path| path.display().to_string());
    let line = format!(
        "mesh {dir} --out {out} --eye 300,410 --above 2 --triangle-width-px 9 --height-px 720 --fov-deg 45 \
         --density 0.5 --partitioning fractional-even --max-factor 32 --min-triangle-m 0.75 --leaf-level -1 \
         --faces-per-side 4 --max-vertices 100000 --max-triangles 150000 --reach 5 --morph 0.5"
    );
    let output = tessera(&line.split_whitespace().collect::<Vec<_>>());
    assert!(output.status.success(), "{}", text(&output.stderr));
    let printed = text(&output.stdout);
    assert!(
        printed.contains("triangles") && printed.contains("tiles were read"),
        "{printed}"
    );
    assert!(fs::read(&out).expect("there") == fs::read(stage.out("wanted.glb")).expect("there"));
}

#[test]
fn the_tool_says_what_is_wrong_in_a_sentence_and_names_every_partitioning() {
    let stage = Stage::new([5, 3], vec![1.0; 15]);
    let [dir, out] =
        [stage.terrain(), stage.out("mesh.obj")].map(|path| path.display().to_string());
    let refused = |more: &[&str], words: &str| {
        let output = tessera(&[&["mesh", &dir, "--out", &out], more].concat());
        let message = text(&output.stderr);
        assert!(!output.status.success() && output.stdout.is_empty());
        assert!(
            message.contains(words) && !message.contains("internal"),
            "{message}"
        );
        assert_eq!(entries(stage.folder.path()), ["terrain"]);
    };
    refused(
        &["--eye", "1,2"],
        "--eye is written X,Y,Z, as in 1200,350,800, and has 2 numbers",
    );
    refused(
        &["--eye", "1,2,3", "--above", "2"],
        "two, or leave --above out",
    );
    refused(&["--eye", "1,x,3"], "invalid value 'x'");
    refused(
        &["--eye", "1,2,3", "--density", "-1"],
        "density is -1: use a number from 0 to 1",
    );
    refused(
        &["--eye", "1,2,3", "--max-triangles", "7"],
        "7 is no whole number in 1024..=33554432",
    );
    refused(
        &["--eye", "1,2,3", "--partitioning", "odd"],
        "fractional-odd",
    );
    refused(&[], "--eye");
    let help = text(&tessera(&["mesh", "--help"]).stdout);
    for name in [
        "fractional-odd",
        "fractional-even",
        "integer",
        "power-of-two",
    ] {
        assert!(help.contains(name), "{help}");
        let ok = tessera(&[
            "mesh",
            &dir,
            "--out",
            &out,
            "--eye",
            "-1,2,3",
            "--partitioning",
            name,
        ]);
        assert!(ok.status.success(), "{}", text(&ok.stderr));
        fs::remove_file(&out).expect("it was written");
    }
}

/// A file may not grow past 4 KiB: what a full disk is to a program.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_named_and_leaves_nothing_behind() {
    let stage = Stage::rough();
    for name in ["mesh.obj", "mesh.glb"] {
        let output = Command::new("bash")
            .args(["-c", "trap '' XFSZ; ulimit -f 4; exec \"$@\"", "bash"])
            .args([
                env!("CARGO_BIN_EXE_tessera"),
                "mesh",
                "--eye",
                "300,410",
                "--above",
                "2",
                "--out",
            ])
            .args([stage.out(name), stage.terrain()])
            .output()
            .expect("bash runs");
        let message = text(&output.stderr);
        assert!(!output.status.success(), "{message}");
        assert!(
            message.contains(&format!("{name} can't be written: File too large"))
                && message.contains("choose another --out"),
            "{message}"
        );
        assert_eq!(entries(stage.folder.path()), ["terrain"]);
    }
}
