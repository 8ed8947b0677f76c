//! Games ask terrains in the world's space, one by one and in batches, on servers too, and are told
//! which level answers; pointers find the ground.

mod streaming_support;

use bevy::ecs::system::SystemState;
use bevy::math::DVec2;
use bevy::prelude::*;
use bevy_tessera::query::{TerrainHit, TerrainQuery};
use bevy_tessera::stream::{TerrainPin, TerrainRegion};
use streaming_support::World3;

const SIZE: [u32; 2] = [1500, 1100];

/// A server's terrain with a region pinned at level 0, and others coarser.
fn world(placed: Transform) -> (World3, Entity) {
    let mut world = World3::new(SIZE);
    let terrain = world.spawn(placed);
    pin(&mut world, terrain);
    (world, terrain)
}

fn pin(world: &mut World3, terrain: Entity) {
    world.app.world_mut().spawn(TerrainPin {
        terrain,
        region: TerrainRegion::around(Vec2::new(1300.0, 900.0), 200.0),
        finest_level: 0,
    });
    world.settle(terrain);
}

fn ask<T>(world: &mut World3, question: impl FnOnce(&TerrainQuery) -> T) -> T {
    let mut state = SystemState::<TerrainQuery>::new(world.app.world_mut());
    question(&state.get(world.app.world()).expect("valid"))
}

struct Random(u32);

impl Random {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / (1 << 24) as f32
    }

    /// A place on the terrain, in its own metres.
    fn place(&mut self) -> Vec3 {
        Vec3::new(self.unit() * 2998.0, 0.0, self.unit() * 2198.0)
    }
}

/// From above the terrain to below it, in its own space.
fn random_ray(random: &mut Random) -> (Vec3, Vec3) {
    let (from, to) = (random.place(), random.place());
    let up = 200.0 + 400.0 * random.unit();
    (from.with_y(up), to.with_y(-150.0))
}

fn ray(from: Vec3, to: Vec3) -> (Ray3d, f32) {
    let (towards, distance) = Dir3::new_and_length(to - from).expect("two places");
    (Ray3d::new(from, towards), distance)
}

#[test]
fn a_terrain_may_be_moved_turned_and_grown_and_still_answers() {
    let placed = Transform::from_xyz(-400.0, 30.0, 700.0)
        .with_rotation(Quat::from_euler(EulerRot::YXZ, 2.0, 0.4, -0.3))
        .with_scale(Vec3::splat(2.5));
    let (mut world, terrain) = world(placed);
    let mut random = Random(5);
    ask(&mut world, |query| {
        for _ in 0..2000 {
            let (from, to) = random_ray(&mut random);
            let [from, to] = [from, to].map(|at| placed.transform_point(at));
            let (there, far) = ray(from, to);
            let hit = query.ray(there, far).expect("from above to below");
            assert_eq!(hit.terrain, terrain);
            assert!(!hit.is_from_below);
            assert!((there.get_point(hit.distance) - hit.point).length() < 0.01);
            assert_eq!(query.ray_on(terrain, there, far), Some(hit));
            // The place is on the ground, and its normal that of the ground, turned.
            let local = placed
                .compute_affine()
                .inverse()
                .transform_point3(hit.point);
            let ground = query.ground(terrain, local.xz().as_dvec2());
            let ground = ground.expect("on the terrain");
            let gap = f64::from(local.y) - ground.height_m;
            // Steep where two levels meet: there the hit may be on the wall between them.
            let is_at_border = (local.xz() / 256.0).fract().min_element() < 1e-3
                || (local.xz() / 256.0).fract().max_element() > 0.999;
            assert!(gap.abs() < 0.01 || is_at_border, "{hit:?} {gap}");
            assert!((hit.normal.length() - 1.0).abs() < 1e-5);
            let under = query.under(hit.point).expect("on the terrain");
            assert!(is_at_border || (under.point - hit.point).length() < 0.03);
            let normal = placed.rotation * ground.normal().as_vec3();
            let turned = normal.angle_between(hit.normal);
            let cell = (local.xz() / 2.0).fract();
            let is_inside = cell.min_element() > 0.01 && cell.max_element() < 0.99;
            assert!(turned < 0.02 || !is_inside, "{turned} {hit:?}");
            // And from the other side.
            let (back, far) = ray(to, from);
            let hit = query.ray(back, far).expect("from below to above");
            assert!(hit.is_from_below);
        }
    });
}

#[test]
fn batches_answer_as_single_questions_do() {
    let (mut world, terrain) = world(Transform::from_xyz(10.0, -3.0, 5.0));
    let other = world.spawn(Transform::from_xyz(1000.0, 60.0, 300.0));
    world.settle(other);
    let mut random = Random(9);
    let mut rays: Vec<_> = (0..3000)
        .map(|_| {
            let (from, to) = random_ray(&mut random);
            ray(from, to)
        })
        .collect();
    rays[7].1 = 0.5;
    rays[8].0.origin.x = f32::NAN;
    rays[9].1 = f32::NAN;
    let mut places: Vec<_> = (0..20_000).map(|_| random.place() * 1.2).collect();
    places[3].x = f32::NAN;
    places[4].z = f32::INFINITY;
    let flat: Vec<_> = places.iter().map(|at| at.xz().as_dvec2()).collect();
    ask(&mut world, |query| {
        let hits = query.rays(&rays);
        assert_eq!(hits.len(), rays.len());
        let mut of_other = 0;
        for (&(ray, far), hit) in rays.iter().zip(&hits) {
            assert_eq!(query.ray(ray, far), *hit);
            let nearer = |a: Option<TerrainHit>, b: Option<TerrainHit>| match (a, b) {
                (Some(a), Some(b)) => Some(if b.distance < a.distance { b } else { a }),
                (a, b) => a.or(b),
            };
            let both = [terrain, other].map(|terrain| query.ray_on(terrain, ray, far));
            assert_eq!(nearer(both[0], both[1]), *hit);
            of_other += u32::from(hit.is_some_and(|hit| hit.terrain == other));
        }
        assert!((100..2900).contains(&of_other), "{of_other}");
        assert_eq!(hits[7..10], [None; 3]);

        let heights = query.heights(terrain, &flat);
        let unders = query.under_all(&places);
        for (n, (&at, &place)) in flat.iter().zip(&places).enumerate() {
            assert_eq!(query.height(terrain, at), heights[n]);
            assert_eq!(query.under(place), unders[n]);
        }
        assert!(heights.iter().flatten().count() > 10_000);
        assert!(heights.iter().any(Option::is_none));
        assert_eq!(query.rays(&[]), []);
        assert_eq!(query.heights(Entity::PLACEHOLDER, &flat[..2]), [None; 2]);
        assert_eq!(query.ray_on(Entity::PLACEHOLDER, rays[0].0, 9e9), None);
    });
}

#[test]
fn answers_say_their_level_where_finer_tiles_are_not_resident() {
    let (mut world, terrain) = world(Transform::default());
    let mut levels = [0; 8];
    let mut random = Random(31);
    let answers: Vec<_> = ask(&mut world, |query| {
        let mut ask = |_| {
            let at = random.place();
            let flat = at.xz().as_dvec2();
            let level = query.level(terrain, flat).expect("on the terrain");
            levels[usize::from(level)] += 1;
            assert_eq!(query.height(terrain, flat).map(|at| at.level), Some(level));
            assert_eq!(query.ground(terrain, flat).map(|at| at.level), Some(level));
            assert_eq!(query.under(at).map(|at| at.level), Some(level));
            let hit = query.ray(Ray3d::new(at.with_y(900.0), Dir3::NEG_Y), 2000.0);
            let hit = hit.expect("on the terrain");
            assert_eq!(hit.level, level);
            let ground = query.ground(terrain, flat).expect("on the terrain");
            assert!((f64::from(hit.point.y) - ground.height_m).abs() < 1e-3);
            assert_eq!(query.normal(terrain, flat), Some(ground.normal()));
            assert_eq!(query.slope(terrain, flat), Some(ground.slope()));
            (flat, level)
        };
        (0..3000).map(&mut ask).collect()
    });
    assert!(levels[0] > 50 && levels[2] > 500, "{levels:?}");
    let state = world.state(terrain);
    for (at, level) in answers {
        let tile = |level: u8| {
            let tile = (at / (256.0 * f64::from(1 << level))).floor().as_uvec2();
            bevy_tessera::tile::TileAddress::new(level, tile.x, tile.y)
        };
        assert!(state.pages().get(tile(level)).is_some());
        assert!(level == 0 || state.pages().get(tile(level - 1)).is_none());
    }
}

#[test]
fn odd_numbers_and_transforms_are_on_no_terrain() {
    let (mut world, terrain) = world(Transform::default());
    let odd = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        -0.0,
        1e-45,
        300.0,
    ];
    let query_all = |query: &TerrainQuery| {
        for x in odd {
            for y in odd {
                for z in odd {
                    let at = Vec3::new(x, y, z);
                    let is_on = x >= 0.0 && z >= 0.0 && x.max(z) < 1000.0 && y.is_finite();
                    let under = query.under(at);
                    assert!(under.is_none() || is_on, "{at}");
                    for far in odd {
                        for way in [Vec3::X, Vec3::NEG_Y, Vec3::splat(0.577_350_3), at] {
                            let ray = Ray3d {
                                origin: at,
                                direction: Dir3::new_unchecked(Vec3::Y),
                            };
                            let _ = query.ray(ray, far);
                            // As a broken game might make it.
                            if let Ok(direction) = Dir3::new(way) {
                                let _ = query.ray(Ray3d { direction, ..ray }, far);
                            }
                        }
                    }
                    let at = DVec2::new(f64::from(x), f64::from(z));
                    let _ = query.ground(terrain, at);
                }
            }
        }
    };
    ask(&mut world, query_all);
    for scale in [0.0, f32::NAN, f32::INFINITY, 1e-40] {
        let mut entity = world.app.world_mut().entity_mut(terrain);
        let transform = Transform::from_scale(Vec3::splat(scale));
        entity.insert(GlobalTransform::from(transform));
        ask(&mut world, |query| {
            let ray = Ray3d::new(Vec3::new(5.0, 500.0, 5.0), Dir3::NEG_Y);
            let hit = query.ray(ray, f32::INFINITY);
            assert!(
                hit.is_none_or(|hit| hit.point.is_finite()),
                "{scale}: {hit:?}"
            );
            let under = query.under(Vec3::new(5.0, 500.0, 5.0));
            assert!(under.is_none_or(|under| under.point.is_finite()));
        });
    }
}

/// Bevy's picking in an app without a window's system or a renderer.
#[cfg(all(feature = "picking", feature = "render"))]
mod picking {
    use super::*;
    use bevy::camera::visibility::RenderLayers;
    use bevy::camera::{ComputedCameraValues, NormalizedRenderTarget, RenderTargetInfo};
    use bevy::picking::pointer::{Location, PointerAction, PointerInput};
    use bevy::picking::{InteractionPlugin, PickingPlugin};
    use bevy::window::{PrimaryWindow, WindowRef};
    use bevy_tessera::query::TerrainPickingPlugin;

    const SCREEN: Vec2 = Vec2::new(800.0, 600.0);

    /// What kind of event, on which entity, where, the normal there, and the depth.
    type Told = (&'static str, Entity, Option<Vec3>, Option<Vec3>, f32);

    #[derive(Resource, Default)]
    struct Heard(Vec<Told>);

    /// What Bevy's `VisibilityPlugin` does, without its meshes.
    fn see(mut seen: Query<(&Visibility, &mut InheritedVisibility)>) {
        for (visibility, mut inherited) in &mut seen {
            let now = if *visibility == Visibility::Hidden {
                InheritedVisibility::HIDDEN
            } else {
                InheritedVisibility::VISIBLE
            };
            inherited.set_if_neq(now);
        }
    }

    struct Stage {
        world: World3,
        terrain: Entity,
        camera: Entity,
        window: Entity,
    }

    impl Stage {
        fn new() -> Self {
            let mut world = World3::in_app(SIZE, false, |app, _| {
                app.add_plugins((PickingPlugin, InteractionPlugin, TerrainPickingPlugin))
                    .add_systems(PostUpdate, see)
                    .init_resource::<Heard>();
            });
            let terrain = world.spawn(());
            pin(&mut world, terrain);
            let at = world.app.world_mut();
            let window = at.spawn((Window::default(), PrimaryWindow)).id();
            let camera = at.spawn(Self::camera(0)).id();
            at.spawn(bevy::picking::pointer::PointerId::Mouse);
            at.entity_mut(terrain)
                .observe(|over: On<Pointer<Over>>, mut heard: ResMut<Heard>| {
                    let hit = &over.hit;
                    let told = ("over", over.entity, hit.position, hit.normal, hit.depth);
                    heard.0.push(told);
                })
                .observe(|click: On<Pointer<Click>>, mut heard: ResMut<Heard>| {
                    let hit = &click.hit;
                    let told = ("click", click.entity, hit.position, hit.normal, hit.depth);
                    heard.0.push(told);
                });
            world.frame();
            Self {
                world,
                terrain,
                camera,
                window,
            }
        }

        /// A camera as its systems would leave it, looking down aslant.
        fn camera(order: isize) -> impl Bundle {
            let projection = PerspectiveProjection {
                aspect_ratio: SCREEN.x / SCREEN.y,
                ..default()
            };
            let clip_from_view = bevy::camera::CameraProjection::get_clip_from_view(&projection);
            let camera = Camera {
                order,
                computed: ComputedCameraValues {
                    clip_from_view,
                    target_info: Some(RenderTargetInfo {
                        physical_size: SCREEN.as_uvec2(),
                        scale_factor: 1.0,
                    }),
                    ..default()
                },
                ..default()
            };
            let eye = Transform::from_xyz(1250.0, 400.0, 1150.0);
            let eye = eye.looking_at(Vec3::new(1300.0, 90.0, 900.0), Vec3::Y);
            (
                Camera3d::default(),
                camera,
                Projection::Perspective(projection),
                eye,
            )
        }

        fn input(&mut self, at: Vec2, action: PointerAction) {
            let window = WindowRef::Primary.normalize(Some(self.window));
            let location = Location {
                target: NormalizedRenderTarget::Window(window.expect("there is one")),
                position: at,
            };
            let id = bevy::picking::pointer::PointerId::Mouse;
            let input = PointerInput::new(id, location, action);
            self.world.app.world_mut().write_message(input);
            self.world.frame();
        }

        fn click(&mut self, at: Vec2) -> Vec<Told> {
            self.world.app.world_mut().resource_mut::<Heard>().0.clear();
            self.input(at, PointerAction::Move { delta: Vec2::ONE });
            self.world.frame();
            self.input(at, PointerAction::Press(PointerButton::Primary));
            self.input(at, PointerAction::Release(PointerButton::Primary));
            std::mem::take(&mut self.world.app.world_mut().resource_mut::<Heard>().0)
        }

        fn clicks(&mut self, at: Vec2) -> usize {
            let heard = self.click(at);
            heard.iter().filter(|heard| heard.0 == "click").count()
        }

        fn insert(&mut self, entity: Entity, bundle: impl Bundle) {
            self.world.app.world_mut().entity_mut(entity).insert(bundle);
            self.world.frame();
        }
    }

    #[test]
    fn a_click_arrives_on_the_terrain_at_the_place_under_the_pointer() {
        let mut stage = Stage::new();
        let at = Vec2::new(430.0, 280.0);
        let heard = stage.click(at);
        let kinds: Vec<_> = heard.iter().map(|heard| heard.0).collect();
        assert_eq!(kinds, ["over", "click"]);
        let world = stage.world.app.world();
        let camera = world.get::<Camera>(stage.camera).expect("camera");
        let eye = world.get::<GlobalTransform>(stage.camera).expect("eye");
        let ray = camera.viewport_to_world(eye, at).expect("a ray");
        let wanted = ask(&mut stage.world, |query| query.ray(ray, f32::INFINITY));
        let wanted = wanted.expect("looks at the ground");
        for (_, entity, position, normal, depth) in heard {
            assert_eq!(entity, stage.terrain);
            assert_eq!(position, Some(wanted.point));
            assert_eq!(normal, Some(wanted.normal));
            assert_eq!(depth, wanted.distance);
        }
        assert_eq!(wanted.level, 0);
        // Into the sky.
        let eye = Transform::from_xyz(1250.0, 400.0, 1150.0);
        let eye = eye.looking_to(Vec3::new(0.3, 1.0, 0.2), Vec3::X);
        stage.insert(stage.camera, eye);
        assert_eq!(stage.clicks(at), 0);
    }

    #[test]
    fn what_is_ignored_hidden_or_on_other_layers_is_not_picked() {
        let mut stage = Stage::new();
        let at = Vec2::new(410.0, 290.0);
        let (terrain, camera) = (stage.terrain, stage.camera);
        assert_eq!(stage.clicks(at), 1);
        stage.insert(terrain, Pickable::IGNORE);
        assert_eq!(stage.clicks(at), 0);
        stage.insert(terrain, Pickable::default());
        assert_eq!(stage.clicks(at), 1);
        stage.insert(terrain, RenderLayers::layer(3));
        assert_eq!(stage.clicks(at), 0);
        stage.insert(camera, RenderLayers::from_layers(&[0, 3]));
        assert_eq!(stage.clicks(at), 1);
        stage.insert(terrain, Visibility::Hidden);
        assert_eq!(stage.clicks(at), 0);
        stage.insert(terrain, Visibility::Visible);
        assert_eq!(stage.clicks(at), 1);
    }

    #[test]
    fn the_camera_in_front_is_asked_first() {
        let mut stage = Stage::new();
        let at = Vec2::new(410.0, 290.0);
        let [_, click] = stage.click(at)[..] else {
            panic!("over and click");
        };
        // Another camera on top that looks somewhere else on the ground.
        let eye = Transform::from_xyz(1380.0, 300.0, 800.0);
        let eye = eye.looking_at(Vec3::new(1200.0, 90.0, 1000.0), Vec3::Y);
        let front = stage.world.app.world_mut().spawn(Stage::camera(1)).id();
        stage.insert(front, eye);
        let heard = stage.click(at);
        let in_front = heard.last().expect("a click");
        assert_eq!(in_front.0, "click");
        assert!((in_front.2.expect("a place") - click.2.expect("a place")).length() > 20.0);
    }
}
