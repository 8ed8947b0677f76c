//! Which nodes a frame draws: selection, and culling against everything that looks at them.

use crate::lattice::{Lattice, Node, NodeBounds, ViewLod};
use crate::stream::TerrainState;
use crate::terrain::Terrain;
use crate::tile::{TILE_SAMPLES, TileAddress, TileRange};
use crate::view::TerrainViews;
use bevy::camera::primitives::{CascadesFrusta, CubemapFrusta, Frustum};
use bevy::ecs::entity::EntityHashMap;
use bevy::math::primitives::ViewFrustum;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;

/// The nodes that a camera draws of each terrain in this frame.
///
/// Written in [`TerrainRenderSystems::Cull`](super::TerrainRenderSystems::Cull).
#[derive(Component, Clone, Debug, Default)]
pub struct TerrainNodes {
    /// By terrain. A terrain that is hidden, or not there any more, has none.
    pub nodes: EntityHashMap<Vec<Node>>,
}

/// A convex volume in a terrain's own space, in metres: everything on the inner side of all
/// planes.
#[derive(Clone, Copy, Debug, Default)]
pub struct LocalVolume {
    planes: [Vec4; 6],
    count: usize,
}

impl LocalVolume {
    /// The frustum in the space that `world_from_local` leads out of, without the plane `ignored`
    /// (an index into its half spaces).
    #[must_use]
    pub fn new(frustum: &Frustum, world_from_local: &DAffine3, ignored: Option<usize>) -> Self {
        let mut volume = Self::default();
        for (index, half_space) in frustum.half_spaces.iter().enumerate() {
            let plane = half_space.normal_d().as_dvec4();
            // A plane at infinity culls nothing.
            if Some(index) == ignored || !plane.is_finite() {
                continue;
            }
            let normal = world_from_local.matrix3.transpose() * plane.truncate();
            let distance = plane.truncate().dot(world_from_local.translation) + plane.w;
            volume.planes[volume.count] = normal.extend(distance).as_vec4();
            volume.count += 1;
        }
        volume
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

/// The box, in metres, that holds every point that can be drawn of a node.
pub struct NodeBox<'a> {
    state: &'a TerrainState,
    lattice: &'a Lattice,
    unit_m: f64,
    /// Heights may be read at this level and the next wherever the node is.
    coarsest_read: i32,
}

impl<'a> NodeBox<'a> {
    /// Boxes of the terrain whose state this is, in this frame.
    #[must_use]
    pub fn new(state: &'a TerrainState) -> Self {
        let lattice = state.lattice();
        let file = &state.manifest().file;
        let most = state.field().corners.iter().copied().max().unwrap_or(0);
        Self {
            state,
            lattice,
            unit_m: lattice.unit_m(file.spacing_m),
            coarsest_read: i32::from(most.div_ceil(256)) - 1,
        }
    }

    /// The box of the part `bounds` of `node`.
    ///
    /// A height read at level `l` is a mean of samples less than two of that level's spacings
    /// away; the level's tiles around the node's hold them all.
    #[must_use]
    pub fn of(&self, node: &Node, bounds: &NodeBounds) -> (Vec3, Vec3) {
        let manifest = self.state.manifest();
        let root = self.lattice.root_level;
        let level = node.level.max(self.coarsest_read).clamp(0, root);
        let log2 = self.lattice.node_log2(level);
        let tile = bounds.low >> IVec2::splat(log2.cast_signed());
        let mut range: Option<TileRange> = None;
        for dz in -1..=1 {
            for dx in -1..=1 {
                let place = tile + IVec2::new(dx, dz);
                if place.cmplt(IVec2::ZERO).any() {
                    continue;
                }
                let mut address = TileAddress::new(
                    level.unsigned_abs() as u8,
                    place.x.cast_unsigned(),
                    place.y.cast_unsigned(),
                );
                let tiles = manifest.file.tiles(address.level);
                if address.x >= tiles[0] || address.z >= tiles[1] {
                    continue;
                }
                // What isn't stored is drawn from its ancestor.
                let found = loop {
                    if let Some(found) = manifest.index.get(address) {
                        break Some(found);
                    }
                    if i32::from(address.level) >= root {
                        break None;
                    }
                    address = address.parent();
                };
                if let Some(found) = found {
                    let wide = range.get_or_insert(found);
                    wide.min = wide.min.min(found.min);
                    wide.max = wide.max.max(found.max);
                }
            }
        }
        let range = range.unwrap_or(TileRange {
            min: 0,
            max: u16::MAX,
        });
        let corner = |point: IVec2, height: u16| {
            let plane = point.as_dvec2() * self.unit_m;
            DVec3::new(plane.x, manifest.file.height_m(height), plane.y).as_vec3()
        };
        (
            corner(bounds.low, range.min),
            corner(bounds.high, range.max),
        )
    }
}

/// Nodes of `lod` that at least one of `volumes` may see, appended to `nodes`.
pub fn select_seen(
    state: &TerrainState,
    lod: &ViewLod,
    volumes: &[LocalVolume],
    nodes: &mut Vec<Node>,
) {
    let boxes = NodeBox::new(state);
    lod.select(
        state.lattice(),
        &mut |node, bounds| {
            let (low, high) = boxes.of(node, bounds);
            volumes.iter().any(|volume| volume.may_hold(low, high))
        },
        &mut |node| nodes.push(node),
    );
}

/// Fills [`TerrainNodes`] for every camera.
#[expect(clippy::type_complexity, reason = "queries of a Bevy system")]
pub(super) fn cull_nodes(
    mut cameras: Query<(Entity, &TerrainViews, &Frustum, &mut TerrainNodes)>,
    terrains: Query<(&TerrainState, Option<&InheritedVisibility>), With<Terrain>>,
    directional: Query<(&DirectionalLight, &CascadesFrusta)>,
    points: Query<(&PointLight, &CubemapFrusta)>,
    spots: Query<(&SpotLight, &Frustum), Without<TerrainViews>>,
    mut volumes: Local<Vec<LocalVolume>>,
) {
    for (camera, views, frustum, mut drawn) in &mut cameras {
        drawn
            .nodes
            .retain(|terrain, _| views.of(*terrain).is_some());
        for view in &views.views {
            let nodes = drawn.nodes.entry(view.terrain).or_default();
            nodes.clear();
            let Ok((state, visibility)) = terrains.get(view.terrain) else {
                continue;
            };
            // Nothing can be drawn before the root is there; a residency field without it
            // promises nothing.
            if !state.is_ready() || visibility.is_some_and(|visibility| !visibility.get()) {
                continue;
            }
            let mut push = |frustum: &Frustum, ignored: Option<usize>| {
                volumes.push(LocalVolume::new(frustum, &view.world_from_local, ignored));
            };
            // Bevy's perspective draws to infinity; its far plane is a culling distance of meshes.
            push(frustum, Some(ViewFrustum::FAR_PLANE_IDX));
            for (light, cascades) in &directional {
                if light.shadow_maps_enabled
                    && let Some(frusta) = cascades.frusta.get(&camera)
                {
                    // A caster may stand before the near plane of its light.
                    let near = Some(ViewFrustum::NEAR_PLANE_IDX);
                    frusta.iter().for_each(|frustum| push(frustum, near));
                }
            }
            for (light, frusta) in &points {
                if light.shadow_maps_enabled {
                    frusta.iter().for_each(|frustum| push(frustum, None));
                }
            }
            for (light, frustum) in &spots {
                if light.shadow_maps_enabled {
                    push(frustum, None);
                }
            }
            select_seen(state, &view.lod, &volumes, nodes);
            volumes.clear();
        }
    }
}

/// Lattice units a tile of level 0 is long; nodes and tiles of a level are the same square.
const _: () = assert!(TILE_SAMPLES.is_power_of_two());
