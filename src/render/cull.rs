//! Which nodes a frame draws: selection, and culling against everything that looks at them.

use crate::lattice::{Lattice, Node, NodeBounds, ViewLod};
use crate::stream::TerrainState;
use crate::terrain::{Terrain, TerrainCpuStage, TerrainCpuTimes, TerrainManifest};
use crate::tessellate::LocalVolume;
use crate::tile::{TileAddress, TileRange};
use crate::view::{HeldLod, HeldTerrainEye, TerrainViews};
use bevy::camera::primitives::{CascadesFrusta, CubemapFrusta, Frustum};
use bevy::ecs::entity::EntityHashMap;
use bevy::ecs::system::SystemParam;
use bevy::math::DAffine3;
use bevy::math::primitives::ViewFrustum;
use bevy::prelude::*;

/// The nodes that a camera draws of each terrain in this frame.
///
/// Written in [`TerrainRenderSystems::Cull`](super::TerrainRenderSystems::Cull).
#[derive(Component, Clone, Debug, Default)]
pub struct TerrainNodes {
    /// By terrain. A terrain that is hidden, or not there any more, has none.
    pub nodes: EntityHashMap<Vec<Node>>,
    /// What the faces of those nodes are culled by, by terrain. Without, all are drawn.
    pub culling: EntityHashMap<NodeCulling>,
}

/// What the faces of a view's nodes are culled by.
#[derive(Clone, Debug, Default)]
pub struct NodeCulling {
    /// Of each node, in order, the lowest and the highest height that it may be drawn with, metres.
    pub heights_m: Vec<[f32; 2]>,
    /// Everything that looks at the nodes: the camera and its lights. A face that none may see is
    /// left out.
    pub volumes: Vec<LocalVolume>,
}

impl LocalVolume {
    /// The frustum in the space that `world_from_local` leads out of, without the plane `ignored`
    /// (an index into its half spaces).
    #[must_use]
    pub fn new(frustum: &Frustum, world_from_local: &DAffine3, ignored: Option<usize>) -> Self {
        let planes = frustum.half_spaces.iter().enumerate();
        Self::from_planes(planes.filter_map(|(index, half_space)| {
            let plane = half_space.normal_d().as_dvec4();
            // A plane at infinity culls nothing.
            if Some(index) == ignored || !plane.is_finite() {
                return None;
            }
            let normal = world_from_local.matrix3.transpose() * plane.truncate();
            let distance = plane.truncate().dot(world_from_local.translation) + plane.w;
            Some(normal.extend(distance).as_vec4())
        }))
    }
}

/// For every tile the metres of height that anything drawn on its square may have.
///
/// A height read at level `l` is a mean of samples less than two of that level's spacings away;
/// the tiles around a tile of level `l` or `l - 1` hold them all. Eight bytes a tile, worked out
/// once a terrain.
#[derive(Clone, Debug)]
pub struct TileHeightBounds {
    levels: Vec<LevelBounds>,
}

#[derive(Clone, Debug)]
struct LevelBounds {
    tiles: [u32; 2],
    /// Lowest and highest height, row by row.
    heights_m: Vec<[f32; 2]>,
}

impl TileHeightBounds {
    /// The bounds of all tiles of a terrain.
    #[must_use]
    pub fn new(manifest: &TerrainManifest) -> Self {
        let file = &manifest.file;
        let levels = (0..file.levels)
            .map(|level| {
                let [across, down] = file.tiles(level);
                let heights_m = (0..down)
                    .flat_map(|z| (0..across).map(move |x| TileAddress::new(level, x, z)))
                    .map(|address| heights_around(manifest, address))
                    .collect();
                LevelBounds {
                    tiles: [across, down],
                    heights_m,
                }
            })
            .collect();
        Self { levels }
    }

    /// Follows the change of a tile's range: of the tile itself, of those around it, and of those
    /// below that aren't stored.
    pub fn update(&mut self, manifest: &TerrainManifest, address: TileAddress) {
        let mut changed = Some((address, address));
        while let Some((low, high)) = changed.take() {
            let level = low.level;
            let Some(bounds) = self.levels.get_mut(usize::from(level)) else {
                return;
            };
            let [across, down] = bounds.tiles;
            for z in low.z.saturating_sub(1)..(high.z + 2).min(down) {
                for x in low.x.saturating_sub(1)..(high.x + 2).min(across) {
                    let heights_m = heights_around(manifest, TileAddress::new(level, x, z));
                    bounds.heights_m[(z * across + x) as usize] = heights_m;
                }
            }
            let Some(finer) = level.checked_sub(1) else {
                return;
            };
            let [across, down] = self.levels[usize::from(finer)].tiles;
            let low = TileAddress::new(finer, 2 * low.x, 2 * low.z);
            let high = TileAddress::new(
                finer,
                (2 * high.x + 1).min(across - 1),
                (2 * high.z + 1).min(down - 1),
            );
            let all_stored = (low.z..=high.z)
                .flat_map(|z| (low.x..=high.x).map(move |x| TileAddress::new(finer, x, z)))
                .all(|tile| manifest.index.get(tile).is_some());
            changed = (!all_stored).then_some((low, high));
        }
    }

    fn get(&self, level: usize, tile: IVec2) -> [f32; 2] {
        let level = &self.levels[level];
        let [across, down] = level.tiles;
        let x = tile.x.cast_unsigned().min(across - 1);
        let z = tile.y.cast_unsigned().min(down - 1);
        level.heights_m[(z * across + x) as usize]
    }
}

/// The range of a tile and those around it, in metres.
fn heights_around(manifest: &TerrainManifest, address: TileAddress) -> [f32; 2] {
    let file = &manifest.file;
    let root = file.levels.saturating_sub(1);
    let own = |mut address: TileAddress| loop {
        // What isn't stored is drawn from its ancestor.
        if let Some(range) = manifest.index.get(address) {
            return range;
        }
        if address.level >= root {
            return TileRange {
                min: 0,
                max: u16::MAX,
            };
        }
        address = address.parent();
    };
    let [across, down] = file.tiles(address.level);
    let around = |place: u32, count: u32| place.saturating_sub(1)..(place + 2).min(count);
    let mut range = own(address);
    for z in around(address.z, down) {
        for x in around(address.x, across) {
            range = range.union(own(TileAddress::new(address.level, x, z)));
        }
    }
    [range.min, range.max].map(|height| file.height_m(height) as f32)
}

/// The box, in metres, that holds every point that can be drawn of a node in this frame.
pub struct NodeBox<'a> {
    bounds: &'a TileHeightBounds,
    lattice: &'a Lattice,
    unit_m: f32,
    /// How far detail raises or lowers the ground at most.
    detail_m: f32,
    /// Heights may be read at this level and the next wherever the node is.
    coarsest_read: i32,
}

impl<'a> NodeBox<'a> {
    /// Boxes of the terrain whose state this is, in this frame.
    #[must_use]
    pub fn new(state: &'a TerrainState, bounds: &'a TileHeightBounds) -> Self {
        let lattice = state.lattice();
        let most = state.field().corners.iter().copied().max().unwrap_or(0);
        Self {
            bounds,
            lattice,
            unit_m: lattice.unit_m(state.manifest().file.spacing_m) as f32,
            detail_m: state.detail().bound_m(),
            coarsest_read: i32::from(most.div_ceil(256)) - 1,
        }
    }

    /// The lowest and the highest height, in metres, that `node` may be drawn with.
    #[must_use]
    pub fn heights_m(&self, node: &Node) -> [f32; 2] {
        let level = node.level.max(self.coarsest_read);
        let level = level.clamp(0, self.lattice.root_level);
        let log2 = self.lattice.node_log2(level);
        let tile = node.origin >> IVec2::splat(log2.cast_signed());
        let [lowest, highest] = self.bounds.get(level.unsigned_abs() as usize, tile);
        [lowest - self.detail_m, highest + self.detail_m]
    }

    /// The box of the part `bounds` of `node`.
    #[must_use]
    pub fn of(&self, node: &Node, bounds: &NodeBounds) -> (Vec3, Vec3) {
        let [lowest, highest] = self.heights_m(node);
        let low = bounds.low.as_vec2() * self.unit_m;
        let high = bounds.high.as_vec2() * self.unit_m;
        (
            Vec3::new(low.x, lowest, low.y),
            Vec3::new(high.x, highest, high.y),
        )
    }
}

/// Nodes of `lod` that at least one of `volumes` may see, appended to `nodes`.
pub fn select_seen(
    state: &TerrainState,
    bounds: &TileHeightBounds,
    lod: &ViewLod,
    volumes: &[LocalVolume],
    nodes: &mut Vec<Node>,
) {
    let boxes = NodeBox::new(state, bounds);
    let seen = |low, high| volumes.iter().any(|volume| volume.may_hold(low, high));
    lod.select(
        state.lattice(),
        &mut |node, bounds| {
            let (low, high) = boxes.of(node, bounds);
            seen(low, high)
        },
        &mut |node| nodes.push(node),
    );
}

/// What a light sees, and the plane of it (an index into its half spaces) that casters may be beyond.
pub(crate) type LightVolume = (Frustum, Option<usize>);

/// What the lights see that throw shadows.
#[derive(SystemParam)]
pub(crate) struct LightVolumes<'w, 's> {
    directional: Query<'w, 's, (&'static DirectionalLight, &'static CascadesFrusta)>,
    points: Query<'w, 's, (&'static PointLight, &'static CubemapFrusta)>,
    spots: Query<'w, 's, (&'static SpotLight, &'static Frustum), Without<TerrainViews>>,
}

impl LightVolumes<'_, '_> {
    /// The volumes that count for the picture of `camera`.
    pub(crate) fn of(&self, camera: Entity) -> impl Iterator<Item = LightVolume> {
        let directional = self.directional.iter();
        let cascades = directional
            .filter(|(light, _)| light.shadow_maps_enabled)
            .filter_map(move |(_, cascades)| cascades.frusta.get(&camera))
            .flatten()
            // A caster may stand before the near plane of its light.
            .map(|frustum| (*frustum, Some(ViewFrustum::NEAR_PLANE_IDX)));
        let points = self.points.iter();
        let points = points
            .filter(|(light, _)| light.shadow_maps_enabled)
            .flat_map(|(_, frusta)| frusta.iter().map(|frustum| (*frustum, None)));
        let spots = self.spots.iter();
        let spots = spots
            .filter(|(light, _)| light.shadow_maps_enabled)
            .map(|(_, frustum)| (*frustum, None));
        cascades.chain(points).chain(spots)
    }
}

type CulledCamera = (
    Entity,
    &'static TerrainViews,
    &'static Frustum,
    Option<&'static HeldTerrainEye>,
    Option<&'static mut HeldLod>,
    &'static mut TerrainNodes,
);

/// Fills [`TerrainNodes`] for every camera.
pub(super) fn cull_nodes(
    mut cameras: Query<CulledCamera>,
    terrains: Query<(&TerrainState, Option<&InheritedVisibility>), With<Terrain>>,
    lights: LightVolumes,
    times: Res<TerrainCpuTimes>,
    mut bounds: Local<EntityHashMap<([u64; 2], TileHeightBounds)>>,
) {
    let _span = bevy::log::debug_span!("terrain_cull").entered();
    let _time = times.measure(TerrainCpuStage::Cull);
    bounds.retain(|terrain, _| terrains.contains(*terrain));
    for (camera, views, frustum, held, mut held_lod, mut drawn) in &mut cameras {
        // Where it is the picture that is held, it is to have no holes.
        let picture = (held.is_some() && held_lod.is_none()).then_some(*frustum);
        let frustum = held.map_or(*frustum, HeldTerrainEye::lod_frustum);
        if let Some(held) = &mut held_lod
            && held.lights.is_none()
        {
            held.lights = Some(lights.of(camera).collect());
        }
        let held_lights = held_lod.as_deref().and_then(|held| held.lights.as_deref());
        let TerrainNodes { nodes, culling } = &mut *drawn;
        nodes.retain(|terrain, _| views.of(*terrain).is_some());
        culling.retain(|terrain, _| views.of(*terrain).is_some());
        for view in &views.views {
            let nodes = nodes.entry(view.terrain).or_default();
            let NodeCulling { heights_m, volumes } = culling.entry(view.terrain).or_default();
            nodes.clear();
            heights_m.clear();
            volumes.clear();
            let Ok((state, visibility)) = terrains.get(view.terrain) else {
                continue;
            };
            // Nothing can be drawn before the root is there; a residency field without it
            // promises nothing.
            if !state.is_ready() || visibility.is_some_and(|visibility| !visibility.get()) {
                continue;
            }
            let mut push = |(frustum, ignored): &LightVolume| {
                volumes.push(LocalVolume::new(frustum, &view.world_from_local, *ignored));
            };
            // Bevy's perspective draws to infinity; its far plane is a culling distance of meshes.
            let far = Some(ViewFrustum::FAR_PLANE_IDX);
            push(&(frustum, far));
            if let Some(picture) = picture {
                push(&(picture, far));
            }
            match held_lights {
                Some(held) => held.iter().for_each(push),
                None => lights.of(camera).for_each(|volume| push(&volume)),
            }
            let manifest = state.ground_bounds();
            let wanted = [state.instance(), state.bounds_version()];
            let known = bounds.get(&view.terrain).map(|(of, _)| *of);
            let known = known.filter(|of| of[0] == wanted[0]).map_or(0, |of| of[1]);
            if known != wanted[1] {
                let changes = state.bounds_changes(known);
                let entry = bounds.get_mut(&view.terrain);
                if let (Some(changes), Some((of, tile_bounds))) = (changes, entry) {
                    let changed = changes.flatten();
                    for address in changed.filter_map(|index| state.pages().address_at(index)) {
                        tile_bounds.update(manifest, address);
                    }
                    *of = wanted;
                } else {
                    let fresh = TileHeightBounds::new(manifest);
                    bounds.insert(view.terrain, (wanted, fresh));
                }
            }
            let tile_bounds = &bounds[&view.terrain].1;
            select_seen(state, tile_bounds, &view.lod, volumes, nodes);
            let boxes = NodeBox::new(state, tile_bounds);
            heights_m.extend(nodes.iter().map(|node| boxes.heights_m(node)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::{DensitySettings, MANIFEST_MAGIC, MANIFEST_VERSION, ManifestFile};
    use crate::tile::TileIndex;
    use proptest::prelude::*;

    /// A terrain of 11 by 6 tiles, of which every tile is stored that `is_stored`, and its parent.
    fn manifest(is_stored: &dyn Fn(TileAddress) -> bool) -> TerrainManifest {
        let size = [1400, 700];
        let file = ManifestFile {
            format: MANIFEST_MAGIC.to_owned(),
            version: MANIFEST_VERSION,
            size,
            spacing_m: 1.0,
            height_min_m: -100.0,
            height_step_m: 0.01,
            levels: ManifestFile::levels_for(size),
            density: DensitySettings::default(),
            index_crc32: 0,
        };
        let mut index = TileIndex::new(&file);
        for level in (0..file.levels).rev() {
            let [across, down] = file.tiles(level);
            for (x, z) in (0..down).flat_map(|z| (0..across).map(move |x| (x, z))) {
                let address = TileAddress::new(level, x, z);
                let is_root = level + 1 == file.levels;
                let has_parent = is_root || index.get(address.parent()).is_some();
                if is_root || has_parent && is_stored(address) {
                    let min = (20_000 + 100 * x + 30 * z) as u16;
                    let max = min + 500;
                    index.set(address, Some(TileRange { min, max }));
                }
            }
        }
        TerrainManifest { file, index }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn bounds_that_follow_changes_are_those_made_anew(
            holes in prop::collection::vec((0..4_u8, 0..11_u32, 0..6_u32), 0..12),
            changes in prop::collection::vec(
                (any::<prop::sample::Index>(), any::<u16>(), any::<u16>()),
                1..40,
            ),
        ) {
            let is_stored = |address: TileAddress| {
                !holes.contains(&(address.level, address.x, address.z))
            };
            let mut manifest = manifest(&is_stored);
            let mut followed = TileHeightBounds::new(&manifest);
            let stored: Vec<_> = manifest.index.iter().map(|(address, _)| address).collect();
            for (which, a, b) in changes {
                let address = *which.get(&stored);
                let range = TileRange { min: a.min(b), max: a.max(b) };
                manifest.index.set(address, Some(range));
                followed.update(&manifest, address);
                let anew = TileHeightBounds::new(&manifest);
                for (level, (is, wanted)) in followed.levels.iter().zip(&anew.levels).enumerate() {
                    prop_assert_eq!(&is.heights_m, &wanted.heights_m, "level {}", level);
                }
            }
        }
    }
}
