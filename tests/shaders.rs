//! Every shader, in every combination of definitions, is composed and validated without a GPU;
//! and each struct that Rust shares with WGSL has the layout that both believe in.

mod common;

use bevy::prelude::*;
use bevy::shader::{Shader, ShaderDefVal, Source};
use bevy_tessera::edit::mask::{
    MASK_LAYER_SHIFT, MASK_MIPS, MASK_PAGE_BYTES, MASK_PAGE_TEXELS, MASK_SLOT_WORDS,
};
use bevy_tessera::render::{
    DEFAULT_MATERIAL_WGSL, GpuComparison, GpuDensityJob, GpuDensityKernel, GpuDensityLevel,
    GpuTerrainCounters, GpuTerrainDraw, GpuTerrainDrawArgs, GpuTerrainNode, GpuTerrainOverlays,
    GpuTerrainVertex, GpuTerrainView, MASK_HEADER_WORDS, TerrainOverlay, compose_material,
};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga_oil::compose::{
    ComposableModuleDescriptor, Composer, NagaModuleDescriptor, ShaderDefValue,
};
use std::collections::{HashMap, HashSet};
use std::mem::offset_of;
use std::sync::OnceLock;

/// The WGSL of all importable modules, Bevy's and ours, and of ours that have entry points.
///
/// And the definitions that Bevy gives to modules of its own.
type Sources = (
    Vec<(String, String)>,
    HashMap<String, String>,
    HashMap<String, ShaderDefValue>,
);

fn sources() -> &'static Sources {
    static SOURCES: OnceLock<Sources> = OnceLock::new();
    SOURCES.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let mut app = common::app::app(folder.path(), false);
        common::app::finish(&mut app);
        for _ in 0..20 {
            app.update();
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        let shaders = app.world().resource::<Assets<Shader>>();
        let mut modules = Vec::new();
        let mut entries = HashMap::new();
        let mut defs = HashMap::new();
        for (_, shader) in shaders.iter() {
            let Source::Wgsl(wgsl) = &shader.source else {
                continue;
            };
            defs.extend(shader.shader_defs.iter().map(|def| match def {
                ShaderDefVal::Bool(name, value) => (name.clone(), ShaderDefValue::Bool(*value)),
                ShaderDefVal::Int(name, value) => (name.clone(), ShaderDefValue::Int(*value)),
                ShaderDefVal::UInt(name, value) => (name.clone(), ShaderDefValue::UInt(*value)),
            }));
            if wgsl.contains("#define_import_path") {
                modules.push((shader.path.clone(), wgsl.to_string()));
            } else if shader.path.contains("bevy_tessera") {
                entries.insert(shader.path.clone(), wgsl.to_string());
            }
        }
        (modules, entries, defs)
    })
}

fn composer() -> Composer {
    let mut composer = Composer::non_validating();
    let mut waiting: Vec<_> = sources().0.iter().collect();
    // Modules in an order that their imports allow: whatever can be added is, until nothing can.
    loop {
        let before = waiting.len();
        waiting.retain(|(path, source)| {
            let (name, imports, _) = naga_oil::compose::get_preprocessor_data(source);
            let missing = imports.iter().any(|import| {
                !composer.contains_module(&import.import)
                    && name.as_deref() != Some(&import.import)
                    && sources().0.iter().any(|(_, other)| {
                        other.contains(&format!("#define_import_path {}\n", import.import))
                    })
            });
            if missing {
                return true;
            }
            composer
                .add_composable_module(ComposableModuleDescriptor {
                    source,
                    file_path: path,
                    ..Default::default()
                })
                .is_err()
        });
        if waiting.len() == before {
            break;
        }
    }
    composer
}

fn validate(
    composer: &mut Composer,
    path: &str,
    source: &str,
    defs: &[&str],
) -> Result<(), String> {
    let mut shader_defs: HashMap<String, ShaderDefValue> = defs
        .iter()
        .map(|def| ((*def).to_owned(), ShaderDefValue::Bool(true)))
        .collect();
    for (name, value) in [
        ("MATERIAL_BIND_GROUP", 3),
        ("AVAILABLE_STORAGE_BUFFER_BINDINGS", 8),
        ("TONEMAPPING_LUT_TEXTURE_BINDING_INDEX", 18),
        ("TONEMAPPING_LUT_SAMPLER_BINDING_INDEX", 19),
    ] {
        shader_defs.insert(name.to_owned(), ShaderDefValue::UInt(value));
    }
    shader_defs.extend(sources().2.clone());
    shader_defs.insert(
        "SCREEN_SPACE_SPECULAR_TRANSMISSION_BLUR_TAPS".into(),
        ShaderDefValue::Int(8),
    );
    let module = composer
        .make_naga_module(NagaModuleDescriptor {
            source,
            file_path: path,
            shader_defs: shader_defs.into_iter().collect(),
            ..Default::default()
        })
        .map_err(|error| format!("{path} with {defs:?}: {}", error.emit_to_string(composer)))?;
    // Nothing beyond WebGPU's defaults may be needed.
    let capabilities = Capabilities::empty()
        | Capabilities::CUBE_ARRAY_TEXTURES
        | Capabilities::MULTISAMPLED_SHADING;
    Validator::new(ValidationFlags::all(), capabilities)
        .validate(&module)
        .map_err(|error| format!("{path} with {defs:?}: {error:?}"))?;
    Ok(())
}

/// All subsets of `names`.
fn subsets<'a>(names: &[&'a str]) -> Vec<Vec<&'a str>> {
    (0..1_usize << names.len())
        .map(|bits| {
            (0..names.len())
                .filter(|bit| bits >> bit & 1 == 1)
                .map(|bit| names[bit])
                .collect()
        })
        .collect()
}

fn check_all(combinations: impl IntoIterator<Item = (String, String, Vec<&'static str>)>) {
    let mut composer = composer();
    let mut failures = Vec::new();
    let mut count = 0;
    for (path, source, defs) in combinations {
        count += 1;
        if let Err(error) = validate(&mut composer, &path, &source, &defs) {
            failures.push(error);
        }
    }
    assert!(count > 0, "no shader was found");
    let shown: Vec<_> = failures.iter().take(3).collect();
    assert!(
        failures.is_empty(),
        "{} of {count} failed: {shown:#?}",
        failures.len()
    );
}

#[test]
fn every_pass_composes_and_validates() {
    let passes: HashSet<_> = [
        "classify",
        "setup",
        "vertices",
        "indices",
        "measure",
        "density",
        "faces",
        "comparison",
    ]
    .into();
    let found: Vec<_> = sources()
        .1
        .iter()
        .filter(|(path, _)| {
            passes
                .iter()
                .any(|pass| path.ends_with(&format!("{pass}.wgsl")))
        })
        .map(|(path, source)| (path.clone(), source.clone(), Vec::new()))
        .collect();
    assert_eq!(found.len(), passes.len());
    check_all(found);
}

#[test]
fn the_prepass_composes_and_validates_in_every_combination() {
    let material = compose_material(DEFAULT_MATERIAL_WGSL);
    let vertex = sources()
        .1
        .iter()
        .find(|(path, _)| path.ends_with("vertex.wgsl"))
        .unwrap();
    let mut combinations = Vec::new();
    let names = [
        "DEPTH_PREPASS",
        "NORMAL_PREPASS",
        "MOTION_VECTOR_PREPASS",
        "DEFERRED_PREPASS",
        "UNCLIPPED_DEPTH_ORTHO_EMULATION",
        "TERRAIN_SHADOW",
        "TERRAIN_DENSITY_PREVIEW",
        "TERRAIN_OVERLAY",
        "VIEW_PROJECTION_ORTHOGRAPHIC",
    ];
    for mut defs in subsets(&names) {
        defs.push("PREPASS_PIPELINE");
        if defs.contains(&"NORMAL_PREPASS") || defs.contains(&"DEFERRED_PREPASS") {
            defs.extend([
                "TERRAIN_READS_MATERIAL",
                "NORMAL_PREPASS_OR_DEFERRED_PREPASS",
            ]);
        }
        combinations.push((vertex.0.clone(), vertex.1.clone(), defs.clone()));
        let needs_fragment = ["NORMAL", "MOTION_VECTOR", "DEFERRED"]
            .iter()
            .any(|name| defs.contains(&format!("{name}_PREPASS").as_str()))
            || defs.contains(&"UNCLIPPED_DEPTH_ORTHO_EMULATION");
        if needs_fragment {
            defs.push("PREPASS_FRAGMENT");
            combinations.push(("material".into(), material.clone(), defs));
        }
    }
    check_all(combinations);
}

#[test]
fn the_main_pass_composes_and_validates_in_every_combination() {
    let material = compose_material(DEFAULT_MATERIAL_WGSL);
    let names = [
        "DEPTH_PREPASS",
        "NORMAL_PREPASS",
        "MOTION_VECTOR_PREPASS",
        "MULTISAMPLED",
        "SCREEN_SPACE_AMBIENT_OCCLUSION",
        "DISTANCE_FOG",
        "ATMOSPHERE",
        "ENVIRONMENT_MAP",
        "TERRAIN_DENSITY_PREVIEW",
        "TERRAIN_OVERLAY",
    ];
    let tails: [&[&str]; 3] = [
        &["SHADOW_FILTER_METHOD_GAUSSIAN"],
        &["SHADOW_FILTER_METHOD_TEMPORAL", "TEMPORAL_JITTER"],
        &[
            "SHADOW_FILTER_METHOD_HARDWARE_2X2",
            "TONEMAP_IN_SHADER",
            "TONEMAP_METHOD_ACES_FITTED",
            "DEBAND_DITHER",
        ],
    ];
    let mut combinations = Vec::new();
    let vertex = sources()
        .1
        .iter()
        .find(|(path, _)| path.ends_with("vertex.wgsl"))
        .unwrap();
    for overlay in [&[][..], &["TERRAIN_OVERLAY"]] {
        let mut defs = vec!["MESH_PIPELINE", "VIEW_PROJECTION_PERSPECTIVE"];
        defs.extend(overlay);
        combinations.push((vertex.0.clone(), vertex.1.clone(), defs));
    }
    for defs in subsets(&names) {
        // Bevy draws occlusion without multisampling only.
        if defs.contains(&"MULTISAMPLED") && defs.contains(&"SCREEN_SPACE_AMBIENT_OCCLUSION") {
            continue;
        }
        for tail in tails {
            let mut defs = defs.clone();
            defs.extend([
                "MESH_PIPELINE",
                "VERTEX_OUTPUT_INSTANCE_INDEX",
                "VIEW_PROJECTION_PERSPECTIVE",
            ]);
            defs.extend(tail);
            combinations.push(("material".into(), material.clone(), defs));
        }
    }
    check_all(combinations);
}

/// Offsets of a struct's members and its size, as WGSL lays them out.
fn wgsl_layout(name: &str) -> (Vec<(String, u32)>, u32) {
    let (_, types) = sources()
        .0
        .iter()
        .find(|(path, _)| path.ends_with("types.wgsl") && path.contains("bevy_tessera"))
        .unwrap();
    let plain = types.replace("#define_import_path bevy_tessera::types", "");
    let module = naga::front::wgsl::parse_str(&plain).unwrap();
    for (_, ty) in module.types.iter() {
        if ty.name.as_deref() == Some(name)
            && let naga::TypeInner::Struct { members, span } = &ty.inner
        {
            let members = members
                .iter()
                .map(|member| (member.name.clone().unwrap(), member.offset))
                .collect();
            return (members, *span);
        }
    }
    panic!("types.wgsl has no struct {name}");
}

macro_rules! layout_test {
    ($test:ident, $rust:ty, $wgsl:literal, [$($field:ident $(as $name:ident)?),* $(,)?]) => {
        #[test]
        fn $test() {
            let (members, size) = wgsl_layout($wgsl);
            assert_eq!(size as usize, size_of::<$rust>(), "size");
            let rust: Vec<(String, u32)> = vec![
                $((stringify!($field).to_owned(), std::mem::offset_of!($rust, $field) as u32)),*
            ];
            assert_eq!(members, rust);
        }
    };
}

layout_test!(
    the_view_has_one_layout,
    GpuTerrainView,
    "TerrainView",
    [
        eye,
        extent,
        eye_fraction,
        eye_height_m,
        unit_m,
        distance_floor,
        planar,
        unit_shift,
        faces_shift,
        leaf_level,
        root_level,
        partitioning,
        node_count,
        segments_per_radian,
        segments_per_m,
        min_triangle_m,
        max_factor,
        height_min_m,
        height_step_m,
        field_cell_shift,
        max_vertices,
        field_cells,
        max_triangles,
        density_strength,
        volume_count,
        focal_px,
        px_per_m,
        max_error_px,
        error_units_per_m,
        unused_a,
        unused_b,
        counts_plain,
        geometry,
        tiles,
        volumes,
    ]
);
layout_test!(
    the_draw_has_one_layout,
    GpuTerrainDraw,
    "TerrainDraw",
    [
        world_from_eye,
        previous_world_from_eye,
        eye_point,
        eye_fraction,
        eye_sample,
        eye_sample_fraction,
        eye_local_m,
        eye_height_m,
        unit_m,
        spacing_m,
        root_level,
        density_opacity,
        mask_first,
        tiles,
    ]
);
layout_test!(
    overlays_have_one_layout,
    GpuTerrainOverlays,
    "TerrainOverlays",
    [opacities, target_px, max_error_px, unlit, unused, legend]
);
layout_test!(
    a_node_has_one_layout,
    GpuTerrainNode,
    "TerrainNode",
    [origin, level, lowest_m, highest_m, unused]
);
layout_test!(
    a_vertex_has_one_layout,
    GpuTerrainVertex,
    "TerrainVertex",
    [point, height_m, lambda]
);
layout_test!(
    the_arguments_have_one_layout,
    GpuTerrainDrawArgs,
    "TerrainDrawArgs",
    [
        index_count,
        instance_count,
        first_index,
        base_vertex,
        first_instance,
        scale,
        vertices,
        triangles,
        wanted_vertices,
        wanted_triangles,
        unused,
    ]
);
layout_test!(
    the_density_kernel_has_one_layout,
    GpuDensityKernel,
    "DensityKernel",
    [density_filter, factor, exponent, unused, levels]
);
layout_test!(
    a_density_level_has_one_layout,
    GpuDensityLevel,
    "DensityLevel",
    [step, noise, samples, texels, unused]
);
layout_test!(
    a_density_job_has_one_layout,
    GpuDensityJob,
    "DensityJob",
    [page, level, tile]
);

/// The comparison's shader has its struct beside it.
#[test]
fn the_comparison_has_one_layout() {
    let mut composer = composer();
    let source = include_str!("../src/render/shaders/comparison.wgsl");
    let module = composer
        .make_naga_module(NagaModuleDescriptor {
            source,
            file_path: "comparison.wgsl",
            ..Default::default()
        })
        .unwrap();
    let wgsl = module.types.iter().find_map(|(_, ty)| match &ty.inner {
        naga::TypeInner::Struct { members, span } if ty.name.as_deref() == Some("Comparison") => {
            Some((members, *span))
        }
        _ => None,
    });
    let (members, size) = wgsl.unwrap();
    assert_eq!(size as usize, size_of::<GpuComparison>());
    let members: Vec<_> = members
        .iter()
        .map(|member| (member.name.as_deref().unwrap(), member.offset as usize))
        .collect();
    let expected = [
        ("low", offset_of!(GpuComparison, low)),
        ("high", offset_of!(GpuComparison, high)),
        ("line", offset_of!(GpuComparison, line)),
        ("gain", offset_of!(GpuComparison, gain)),
        ("mode", offset_of!(GpuComparison, mode)),
        ("space", offset_of!(GpuComparison, space)),
        ("unused_a", offset_of!(GpuComparison, unused_a)),
        ("unused_b", offset_of!(GpuComparison, unused_b)),
        ("unused_c", offset_of!(GpuComparison, unused_c)),
    ];
    assert_eq!(members, expected);
}

/// The value of a constant of `types.wgsl`.
fn wgsl_constant(name: &str) -> usize {
    let (_, types) = sources()
        .0
        .iter()
        .find(|(_, source)| source.contains("#define_import_path bevy_tessera::types"))
        .unwrap();
    let line = types
        .lines()
        .find(|line| line.starts_with(&format!("const {name}: u32 = ")))
        .unwrap_or_else(|| panic!("{name}"));
    let number = line.split(" = ").nth(1).unwrap().trim_end_matches("u;");
    number.parse().unwrap()
}

/// The mask is an array of words in WGSL; its constants say what stands where.
#[test]
fn the_mask_has_one_layout() {
    for (name, value) in [
        ("MASK_HEADER_WORDS", MASK_HEADER_WORDS as usize),
        ("MASK_SLOT_WORDS", MASK_SLOT_WORDS),
        ("MASK_PAGE_WORDS", MASK_PAGE_BYTES / 4),
        ("MASK_LAYER_SHIFT", MASK_LAYER_SHIFT as usize),
        ("MASK_PAGE_SHIFT", MASK_PAGE_TEXELS.ilog2() as usize),
        ("MASK_MIPS", MASK_MIPS),
    ] {
        assert_eq!(wgsl_constant(name), value, "{name}");
    }
}

/// Overlays have one number in Rust and in WGSL.
#[test]
fn overlays_have_one_number() {
    for overlay in TerrainOverlay::ALL {
        let name = overlay.name().to_uppercase().replace(' ', "_");
        assert_eq!(wgsl_constant(&format!("OVERLAY_{name}")), overlay as usize);
    }
    assert_eq!(wgsl_constant("OVERLAYS"), TerrainOverlay::ALL.len());
}

/// The counters are an array in WGSL; its constants say what stands where.
#[test]
fn the_counters_have_one_layout() {
    for (name, offset) in [
        ("COUNTER_FACES", offset_of!(GpuTerrainCounters, faces)),
        (
            "COUNTER_CULLED",
            offset_of!(GpuTerrainCounters, culled_faces),
        ),
        ("COUNTER_EDGES", offset_of!(GpuTerrainCounters, edges)),
        (
            "COUNTER_CLAMPED",
            offset_of!(GpuTerrainCounters, clamped_edges),
        ),
        ("COUNTER_FACTORS", offset_of!(GpuTerrainCounters, factors)),
        (
            "COUNTER_SIZES",
            offset_of!(GpuTerrainCounters, triangle_sizes),
        ),
        ("COUNTERS", size_of::<GpuTerrainCounters>()),
    ] {
        assert_eq!(4 * wgsl_constant(name), offset, "{name}");
    }
}
