//! `terrain.set`: what may be set, what is refused, and in which words.

use super::{ask, set};
use crate::streaming_support::World3;
use bevy::prelude::*;
use bevy::remote::RemotePlugin;
use bevy_tessera::detail::{DetailRule, TerrainDetail};
use bevy_tessera::edit::mask::MaskSettings;
use bevy_tessera::gizmos::TerrainGizmos;
use bevy_tessera::physics::TerrainPhysics;
use bevy_tessera::remote::{TERRAIN_STATS_METHOD, TerrainRemotePlugin, TerrainStats};
use bevy_tessera::render::{
    ComparisonCamera, TerrainComparison, TerrainDensityPreview, TerrainMaterial, TerrainOverlays,
};
use bevy_tessera::stream::TerrainStreaming;
use bevy_tessera::terrain::{TerrainCamera, TerrainSettings, TessellationPolicy};
use bevy_tessera::tessellate::Partitioning;
use bevy_tessera::view::TerrainEye;
use proptest::prelude::*;
use serde_json::{Value, json};

/// An app with one of each component and resource that may be set, not running.
struct Settable {
    app: App,
    terrain: Entity,
    camera: Entity,
    dir: World3,
}

/// What all of them hold.
type Held = (
    (
        TerrainCamera,
        TerrainOverlays,
        TerrainComparison,
        TerrainEye,
    ),
    (
        TerrainSettings,
        TerrainDetail,
        TerrainMaterial,
        TerrainDensityPreview,
        MaskSettings,
    ),
    (TerrainStreaming, TerrainPhysics, TerrainGizmos),
);

impl Settable {
    fn new() -> Self {
        let mut dir = World3::in_app([300, 260], false, |app, _| {
            app.add_plugins((RemotePlugin::default(), TerrainRemotePlugin))
                .init_resource::<TerrainPhysics>();
        });
        let mut store = GizmoConfigStore::default();
        store.insert(GizmoConfig::default(), TerrainGizmos::default());
        dir.app.insert_resource(store);
        let settings = (
            TerrainDetail::default(),
            TerrainMaterial::default(),
            TerrainDensityPreview::default(),
            MaskSettings::default(),
        );
        let terrain = dir.spawn(settings);
        let camera = (
            TerrainCamera::default(),
            TerrainOverlays::default(),
            TerrainComparison::default(),
            TerrainEye::default(),
        );
        let camera = dir.app.world_mut().spawn(camera).id();
        dir.settle(terrain);
        let app = std::mem::take(&mut dir.app);
        Self {
            app,
            terrain,
            camera,
            dir,
        }
    }

    fn held(&self) -> Held {
        let world = self.app.world();
        fn of<T: Component + Clone>(world: &bevy::ecs::world::World, entity: Entity) -> T {
            world.get::<T>(entity).unwrap().clone()
        }
        let (terrain, camera) = (self.terrain, self.camera);
        let store = world.resource::<GizmoConfigStore>();
        (
            (
                of(world, camera),
                of(world, camera),
                of(world, camera),
                of(world, camera),
            ),
            (
                of(world, terrain),
                of(world, terrain),
                of(world, terrain),
                of(world, terrain),
                of(world, terrain),
            ),
            (
                world.resource::<TerrainStreaming>().clone(),
                world.resource::<TerrainPhysics>().clone(),
                store.config::<TerrainGizmos>().1.clone(),
            ),
        )
    }

    /// Sets one thing; `change` does the same to what is held.
    fn sets(&mut self, component: &str, path: &str, value: Value, change: impl FnOnce(&mut Held)) {
        let mut expected = self.held();
        let parameters = json!({"component": component, "path": path, "value": value});
        let setting = set(self.app.world_mut(), parameters)
            .unwrap_or_else(|error| panic!("{component}::{path}: {}", error.message));
        change(&mut expected);
        assert_eq!(self.held(), expected, "{component}::{path}");
        assert_eq!(setting.component, component);
        assert_eq!(setting.path, path);
        assert_ne!(setting.old, setting.new, "{component}::{path}");
        // What was set is what is told of it, and what it was brings everything back.
        let parameters = json!({"component": component, "path": path, "value": setting.old});
        let back = set(self.app.world_mut(), parameters).unwrap();
        assert_eq!(back.old, setting.new);
        assert_eq!(back.new, setting.old);
    }
}

#[test]
fn every_kind_of_setting_can_be_set_and_set_back() {
    let mut all = Settable::new();
    let before = all.held();
    all.sets("TerrainCamera", "density", json!(0.25), |held| {
        held.0.0.density = 0.25;
    });
    all.sets("TerrainCamera", "lod", json!({"reach": 6.5}), |held| {
        held.0.0.lod.reach = 6.5;
    });
    all.sets("TerrainCamera", "lod.morph", json!(0.5), |held| {
        held.0.0.lod.morph = 0.5;
    });
    all.sets("TerrainCamera", "min_triangle_m", json!(0.5), |held| {
        held.0.0.min_triangle_m = Some(0.5);
    });
    let policy = json!({"ScreenError": {"max_px": 2.0}});
    all.sets("TerrainCamera", "policy", policy, |held| {
        held.0.0.policy = TessellationPolicy::ScreenError { max_px: 2.0 };
    });
    all.sets("TerrainCamera", "partitioning", json!("Integer"), |held| {
        held.0.0.partitioning = Partitioning::Integer;
    });
    all.sets("TerrainCamera", "max_vertices", json!(5000), |held| {
        held.0.0.max_vertices = 5000;
    });
    let some = json!({"density": 0.5, "faces_per_side": 8});
    all.sets("TerrainCamera", "", some, |held| {
        held.0.0.density = 0.5;
        held.0.0.faces_per_side = 8;
    });
    all.sets("TerrainOverlays", "opacities[11]", json!(1.0), |held| {
        held.0.1.opacities[11] = 1.0;
    });
    all.sets("TerrainOverlays", "lit", json!(false), |held| {
        held.0.1.lit = false;
    });
    all.sets("TerrainComparison", "other.density", json!(0.5), |held| {
        held.0.2.other.density = 0.5;
    });
    all.sets("TerrainEye", "", json!("EyeOnly"), |held| {
        held.0.3 = TerrainEye::EyeOnly;
    });
    all.sets("TerrainSettings", "root_levels", json!(1), |held| {
        held.1.0.root_levels = 1;
    });
    all.sets("TerrainDetail", "amplitude_m", json!(1.5), |held| {
        held.1.1.amplitude_m = 1.5;
    });
    all.sets("TerrainDetail", "rule.from_deg", json!(20), |held| {
        held.1.1.rule = DetailRule::Slope {
            from_deg: 20.0,
            to_deg: 40.0,
        };
    });
    all.sets("TerrainDetail", "rule", json!("Everywhere"), |held| {
        held.1.1.rule = DetailRule::Everywhere;
    });
    all.sets("TerrainMaterial", "parameters[0].y", json!(0.5), |held| {
        held.1.2.parameters[0].y = 0.5;
    });
    let red = json!([1.0, 0.0, 0.0, 1.0]);
    all.sets("TerrainMaterial", "parameters[1]", red, |held| {
        held.1.2.parameters[1] = Vec4::new(1.0, 0.0, 0.0, 1.0);
    });
    all.sets("TerrainDensityPreview", "settings.gain", json!(2), |held| {
        held.1.3.settings.gain = 2.0;
    });
    all.sets("MaskSettings", "texels_per_m", json!(2), |held| {
        held.1.4.texels_per_m = 2.0;
    });
    let bytes = json!(256 << 20);
    all.sets("TerrainStreaming", "page_bytes", bytes, |held| {
        held.2.0.page_bytes = 256 << 20;
    });
    all.sets("TerrainPhysics", "chunk_cells", json!(32), |held| {
        held.2.1.chunk_cells = 32;
    });
    all.sets("TerrainGizmos", "tiles", json!(true), |held| {
        held.2.2.tiles = true;
    });
    all.sets("TerrainGizmos", "tiles_within_m", json!(500), |held| {
        held.2.2.tiles_within_m = 500.0;
    });
    all.sets("TerrainGizmos", "held_eye_reach_m", json!(50), |held| {
        held.2.2.held_eye_reach_m = 50.0;
    });
    let red = json!({"Srgba": {"red": 1.0, "green": 0.0, "blue": 0.0, "alpha": 1.0}});
    all.sets("TerrainGizmos", "edit_color", red, |held| {
        held.2.2.edit_color = Color::srgb(1.0, 0.0, 0.0);
    });
    assert_eq!(all.held(), before);
}

/// A request, and words that its refusal must hold.
type Refusal = (Value, &'static [&'static str]);

fn refusals(all: &Settable) -> Vec<Refusal> {
    let (terrain, camera) = (all.terrain.to_bits(), all.camera.to_bits());
    let of = |component: &str, path: &str, value: Value| -> Value {
        json!({"component": component, "path": path, "value": value})
    };
    vec![
        (Value::Null, &["parameters", "`component`"]),
        (json!([1, 2]), &["parameters", "`component`"]),
        (
            json!({"component": "TerrainCamera", "path": "density"}),
            &["missing field `value`", "give"],
        ),
        (
            json!({"component": "TerrainCamera", "path": "density", "value": 1, "entitiy": 1}),
            &["entitiy", "`entity`"],
        ),
        (
            json!({"component": "TerrainCamera", "path": 3, "value": 1}),
            &["expected a string"],
        ),
        (
            of("Transform", "translation.x", json!(1)),
            &["`Transform`", "TerrainCamera, TerrainSettings"],
        ),
        (
            of("TerrainCamera", "colour", json!(1)),
            &["`colour`", "triangle_width_px"],
        ),
        (
            of("TerrainCamera", "policy.max_px", json!(1)),
            &["policy.max_px", "policy"],
        ),
        (of("TerrainCamera", "lod[", json!(1)), &["`lod[`"]),
        (
            of("TerrainMaterial", "parameters[8].x", json!(1)),
            &["parameters[8]"],
        ),
        (
            of("TerrainCamera", "density", json!("much")),
            &["TerrainCamera::density", "\"much\"", "give a number"],
        ),
        (
            of("TerrainCamera", "max_vertices", json!(-1)),
            &["max_vertices", "-1", "give a whole number"],
        ),
        (
            of("TerrainCamera", "max_vertices", json!(1.5)),
            &["max_vertices", "1.5", "give a whole number"],
        ),
        (
            of("TerrainCamera", "partitioning", json!("Odd")),
            &["Odd", "\"FractionalEven\""],
        ),
        (
            of("TerrainCamera", "policy", json!({"ScreenError": {}})),
            &["policy", "max_px"],
        ),
        (
            of("TerrainCamera", "min_triangle_m", json!("tiny")),
            &["min_triangle_m", "null or a number"],
        ),
        (
            of("TerrainOverlays", "opacities", json!([1.0, 0.0])),
            &["opacities", "give a list of 12"],
        ),
        (
            of("TerrainOverlays", "lit", json!(1)),
            &["lit", "give true or false"],
        ),
        (
            of("TerrainMaterial", "shader", json!("a.wgsl")),
            &["TerrainMaterial::shader"],
        ),
        (
            of("TerrainCamera", "density", json!(1.5)),
            &["TerrainCamera::density is 1.5", "from 0 to 1"],
        ),
        (
            of("TerrainCamera", "triangle_width_px", json!(1e39)),
            &["triangle_width_px is inf", "1 to 256"],
        ),
        (
            of("TerrainCamera", "lod.reach", json!(3)),
            &["reach 3", "at least 4"],
        ),
        (
            of("TerrainCamera", "faces_per_side", json!(7)),
            &["faces_per_side is 7", "power of two"],
        ),
        (
            of("TerrainSettings", "root_levels", json!(0)),
            &["root_levels is 0", "1 to 8"],
        ),
        (
            of("TerrainSettings", "leaf_level", json!(-9)),
            &["leaf_level is -9", "-8"],
        ),
        (
            of("TerrainSettings", "leaf_level", json!(-1)),
            &["leaf_level is read once", "where the terrain is spawned"],
        ),
        (
            of("TerrainDetail", "octaves", json!(9)),
            &["octaves is 9", "1 to 8"],
        ),
        (
            of("TerrainDetail", "rule.to_deg", json!(15)),
            &["rule goes from 15 to 15"],
        ),
        (
            of("TerrainStreaming", "page_bytes", json!(0)),
            &["page_bytes is 0"],
        ),
        (
            of("TerrainPhysics", "chunk_cells", json!(48)),
            &["chunk_cells is 48"],
        ),
        (
            of("TerrainOverlays", "opacities[0]", json!(-0.5)),
            &["opacities[0] is -0.5", "0 to 1"],
        ),
        (
            of(
                "TerrainComparison",
                "view",
                json!({"Difference": {"gain": 65}}),
            ),
            &["view.gain is 65", "1 to 64"],
        ),
        (
            of("TerrainComparison", "view.divider", json!(2)),
            &["view.divider is 2", "0 to 1"],
        ),
        (
            of("TerrainComparison", "other.density", json!(2)),
            &["TerrainComparison::other", "density is 2"],
        ),
        (
            of("TerrainDensityPreview", "settings.gain", json!(0)),
            &["gain is 0"],
        ),
        (
            of("TerrainDensityPreview", "opacity", json!(2)),
            &["opacity is 2"],
        ),
        (
            of("TerrainMaterial", "parameters[0].x", json!(1e300)),
            &["parameters[0]", "finite"],
        ),
        (
            of("MaskSettings", "texels_per_m", json!(0)),
            &["texels_per_m is 0"],
        ),
        (
            of("TerrainSettings", "fade_px_per_s", json!(1e39)),
            &["fade_px_per_s is inf"],
        ),
        (
            of("TerrainGizmos", "tiles_within_m", json!(-1)),
            &["tiles_within_m is -1: use a number from 0"],
        ),
        (
            of("TerrainGizmos", "held_eye_reach_m", json!(0)),
            &["held_eye_reach_m is 0"],
        ),
        // What has a form of its own in JSON is shown in it.
        (
            of("TerrainMaterial", "parameters[0]", json!("red")),
            &["give a value like [0."],
        ),
        (
            of("TerrainGizmos", "edit_color", json!("red")),
            &["give a value like {\"Srgba\":{"],
        ),
        (
            json!([camera, "TerrainCamera", "density", 0.5]),
            &["a list", "an object with `component`"],
        ),
        (
            json!({"entity": camera, "component": "TerrainStreaming", "path": "retry_s", "value": 1}),
            &["TerrainStreaming", "leave `entity` out"],
        ),
        (
            json!({"entity": 0, "component": "TerrainCamera", "path": "density", "value": 1}),
            &["no entity 0:", "terrain.stats"],
        ),
        (
            json!({"entity": 123_456, "component": "TerrainCamera", "path": "density", "value": 1}),
            &["no entity 123456", "terrain.stats"],
        ),
        (
            json!({"entity": terrain, "component": "TerrainCamera", "path": "density", "value": 1}),
            &["has no `TerrainCamera`", "name one of"],
        ),
    ]
}

#[test]
fn what_is_refused_changes_nothing_and_says_why() {
    let mut all = Settable::new();
    let before = all.held();
    for (parameters, words) in refusals(&all) {
        let error = set(all.app.world_mut(), parameters.clone()).expect_err("refused");
        for word in words {
            assert!(
                error.message.contains(word),
                "{parameters}: {} doesn't say {word}",
                error.message
            );
        }
        assert!(!error.message.contains('\n'), "{}", error.message);
        assert!(all.held() == before, "{parameters}");
    }
    let stats = ask(all.app.world_mut(), TERRAIN_STATS_METHOD, json!({"all": 1}));
    assert!(stats.unwrap_err().message.contains("give none"));
    drop(all.dir);
}

#[test]
fn an_entity_is_named_where_there_are_several() {
    let mut all = Settable::new();
    let density = json!({"component": "TerrainDetail", "path": "gain", "value": 0.25});
    let world = all.app.world_mut();
    let other = world
        .spawn((TerrainDetail::default(), Name::new("sea floor")))
        .id();
    let error = set(world, density.clone()).unwrap_err();
    assert!(
        error
            .message
            .starts_with("2 entities have a `TerrainDetail`"),
        "{}",
        error.message
    );
    let named = format!("{} (sea floor)", other.to_bits());
    assert!(error.message.contains(&named), "{}", error.message);
    assert_eq!(world.get(other), Some(&TerrainDetail::default()));
    let mut one = density.clone();
    one["entity"] = json!(other.to_bits());
    let setting = set(world, one).unwrap();
    assert_eq!(setting.entity, Some(other));
    assert_eq!(world.get::<TerrainDetail>(other).unwrap().gain, 0.25);
    let first = world.get::<TerrainDetail>(all.terrain).unwrap();
    assert_eq!(first.gain, 0.5);
    // And where there is none, that is said.
    world.despawn(other);
    world.entity_mut(all.terrain).remove::<TerrainDetail>();
    let error = set(world, density).unwrap_err();
    assert!(error.message.contains("no entity has"), "{}", error.message);
    assert!(error.message.contains("insert one"), "{}", error.message);
    world.remove_resource::<TerrainPhysics>();
    let physics = json!({"component": "TerrainPhysics", "path": "margin_m", "value": 1});
    let error = set(world, physics).unwrap_err();
    assert!(error.message.contains("plugin"), "{}", error.message);
}

#[test]
fn what_was_wrong_before_is_not_the_new_values_fault() {
    let mut all = Settable::new();
    let world = all.app.world_mut();
    let mut camera = world.get_mut::<TerrainCamera>(all.camera).unwrap();
    camera.max_factor = 99.0;
    let width = json!({"component": "TerrainCamera", "path": "triangle_width_px", "value": 9});
    assert_eq!(set(world, width).unwrap().new, json!(9.0));
    let factor = json!({"component": "TerrainCamera", "path": "max_factor", "value": 98});
    assert!(set(world, factor).is_err());
    let factor = json!({"component": "TerrainCamera", "path": "max_factor", "value": 32});
    assert_eq!(set(world, factor).unwrap().old, json!(99.0));
}

#[test]
fn one_fault_hides_no_other() {
    let mut all = Settable::new();
    let world = all.app.world_mut();
    let mut preview = world.get_mut::<TerrainDensityPreview>(all.terrain).unwrap();
    preview.settings.gain = 0.0;
    let mut detail = world.get_mut::<TerrainDetail>(all.terrain).unwrap();
    detail.rule = DetailRule::Slope {
        from_deg: -5.0,
        to_deg: 40.0,
    };
    let mut camera = world.get_mut::<TerrainCamera>(all.camera).unwrap();
    camera.lod.morph = 0.3;
    let before = all.held();
    for (component, path, value) in [
        ("TerrainDensityPreview", "settings.exponent", -5.0),
        ("TerrainDetail", "rule.to_deg", 400.0),
        ("TerrainCamera", "lod.reach", 1000.0),
    ] {
        let parameters = json!({"component": component, "path": path, "value": value});
        assert!(set(all.app.world_mut(), parameters).is_err(), "{path}");
    }
    assert!(all.held() == before);
}

#[test]
fn the_second_camera_of_a_comparison_is_neither_told_of_nor_set() {
    let mut all = Settable::new();
    let camera = all.camera;
    let world = all.app.world_mut();
    let second = (TerrainCamera::default(), ComparisonCamera(camera));
    let second = world.spawn(second).id();
    all.app.update();
    let world = all.app.world_mut();
    let stats = ask(world, TERRAIN_STATS_METHOD, Value::Null).unwrap();
    let stats: TerrainStats = serde_json::from_value(stats).unwrap();
    let told: Vec<_> = stats.cameras.iter().map(|told| told.entity).collect();
    assert_eq!(told, [camera]);
    let mut density = json!({"component": "TerrainCamera", "path": "density", "value": 0.25});
    assert_eq!(set(world, density.clone()).unwrap().entity, Some(camera));
    density["entity"] = json!(second.to_bits());
    assert!(set(world, density).is_err());
    assert_eq!(world.get::<TerrainCamera>(second).unwrap().density, 1.0);
}

/// JSON of all shapes, not deep.
fn any_json() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<i64>().prop_map(Value::from),
        any::<u64>().prop_map(Value::from),
        any::<f64>().prop_map(Value::from),
        (-100..100_i64).prop_map(Value::from),
        (0.0..2.0_f64).prop_map(Value::from),
        "[a-zA-Z.\\[\\]#0-9é]{0,12}".prop_map(Value::from),
        Just(json!("ScreenError")),
        Just(json!("Integer")),
    ];
    leaf.prop_recursive(3, 24, 6, |inner| {
        let key = prop_oneof![
            "[a-z_]{0,6}",
            Just("ScreenError".to_owned()),
            Just("max_px".to_owned()),
            Just("density".to_owned()),
            Just("reach".to_owned()),
        ];
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..13).prop_map(Value::from),
            prop::collection::vec((key, inner), 0..4)
                .prop_map(|fields| Value::Object(fields.into_iter().collect())),
        ]
    })
}

fn any_parameters() -> impl Strategy<Value = Value> {
    let component = prop_oneof![
        8 => prop::sample::select(vec![
            "TerrainCamera", "TerrainOverlays", "TerrainComparison", "TerrainEye",
            "TerrainSettings", "TerrainDetail", "TerrainMaterial", "TerrainDensityPreview",
            "MaskSettings", "TerrainStreaming", "TerrainPhysics", "TerrainGizmos",
            "bevy_tessera::terrain::camera::TerrainCamera",
        ]).prop_map(Value::from),
        1 => any_json(),
    ];
    let path = prop_oneof![
        8 => prop::sample::select(vec![
            "", "lod", "lod.reach", "policy", "policy.max_px", "min_triangle_m", "min_triangle_m.0",
            "density", "max_vertices", "partitioning", "opacities", "opacities[3]", "lit", "other",
            "other.lod.morph", "view", "view.divider", "leaf_level", "root_levels", "rule",
            "rule.from_deg", "octaves", "shader", "parameters", "parameters[2]", "parameters[2].z",
            "settings", "settings.filter", "settings.gain", "opacity", "texels_per_m", "page_bytes",
            "retry_s", "chunk_cells", "keep_resident", "tiles", "#0", "#1", ".density", "lod#1",
        ]).prop_map(Value::from),
        2 => "[a-z_.\\[\\]#0-9é]{0,20}".prop_map(Value::from),
        1 => any_json(),
    ];
    let entity = prop_oneof![
        6 => Just(None),
        1 => any_json().prop_map(Some),
        1 => (0..40_u64).prop_map(|bits| Some(json!(bits))),
    ];
    // Some that fit together, or nothing would ever be taken.
    let fitting = prop::sample::select(vec![
        ("TerrainCamera", "density"),
        ("TerrainCamera", "triangle_width_px"),
        ("TerrainCamera", "min_triangle_m"),
        ("TerrainCamera", "lod.reach"),
        ("TerrainOverlays", "opacities[3]"),
        ("TerrainOverlays", "lit"),
        ("TerrainComparison", "view.divider"),
        ("TerrainSettings", "root_levels"),
        ("TerrainDetail", "gain"),
        ("TerrainMaterial", "parameters[2].z"),
        ("TerrainDensityPreview", "opacity"),
        ("MaskSettings", "texels_per_m"),
        ("TerrainStreaming", "retry_s"),
        ("TerrainPhysics", "margin_m"),
        ("TerrainGizmos", "tiles"),
    ]);
    let plain = prop_oneof![
        any::<bool>().prop_map(Value::from),
        (-10..100_i64).prop_map(Value::from),
        (-1.0..3.0_f64).prop_map(Value::from),
    ];
    let names = prop_oneof![
        1 => (component, path),
        1 => fitting.prop_map(|(component, path)| (json!(component), json!(path))),
    ];
    let value = prop_oneof![1 => any_json(), 1 => plain];
    (entity, names, value).prop_map(|(entity, (component, path), value)| {
        let mut parameters = json!({"component": component, "path": path, "value": value});
        if let Some(entity) = entity {
            parameters["entity"] = entity;
        }
        parameters
    })
}

#[test]
fn no_parameters_make_a_method_panic_or_leave_settings_that_cant_be_used() {
    let mut all = Settable::new();
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig {
        cases: 4000,
        failure_persistence: None,
        ..ProptestConfig::default()
    });
    let all = std::cell::RefCell::new(&mut all);
    let parameters = prop_oneof![5 => any_parameters(), 1 => any_json()];
    let (mut taken, mut refused) = (0_u32, 0_u32);
    let counts = std::cell::RefCell::new((&mut taken, &mut refused));
    runner
        .run(&parameters, |parameters| {
            let mut all = all.borrow_mut();
            let before = all.held();
            let mut counts = counts.borrow_mut();
            match set(all.app.world_mut(), parameters.clone()) {
                Ok(_) => *counts.0 += 1,
                Err(error) => {
                    *counts.1 += 1;
                    prop_assert!(all.held() == before, "{parameters}");
                    prop_assert!(error.message.len() < 2000, "{}", error.message);
                    prop_assert!(!error.message.contains('\n'), "{}", error.message);
                }
            }
            let ((camera, ..), (settings, detail, ..), (streaming, physics, _)) = all.held();
            let sound = camera.checked(|_| ()) == camera
                && settings.checked(|_| ()) == settings
                && detail.validate().is_ok()
                && streaming.checked(|_| ()) == streaming
                && physics.checked(|_| ()) == physics;
            prop_assert!(sound, "{parameters}");
            let _ = ask(all.app.world_mut(), TERRAIN_STATS_METHOD, parameters);
            Ok(())
        })
        .unwrap();
    assert!(taken > 50 && refused > 1000, "{taken}, {refused}");
    // And the app still runs with whatever has been set.
    let all = all.into_inner();
    for _ in 0..10 {
        all.app.update();
    }
}
