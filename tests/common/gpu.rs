//! The real kernels over a real terrain, read back.

use super::app;
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::render::render_resource::{
    Buffer, BufferDescriptor, BufferUsages, CommandEncoderDescriptor, MapMode, PollType,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy_tessera::bake::import::{self, ImportSettings};
use bevy_tessera::bake::{BakeSettings, bake};
use bevy_tessera::detail::DetailKernel;
use bevy_tessera::lattice::{Lattice, Node, ResidencyField, ViewLod};
use bevy_tessera::render::{
    GpuFaceFactors, GpuTerrainDrawArgs, GpuTerrainMeshes, GpuTerrainVertex, GpuTriangleFace,
    TerrainNodes, TerrainRenderSystems, factor_view,
};
use bevy_tessera::stream::{TerrainState, TerrainTiles};
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainSettings};
use bevy_tessera::tessellate::{
    FaceFactors, FacePart, FactorView, Pages, TerrainVertex, TriangleFace, ViewMesh,
};
use bevy_tessera::tile::TileAddress;
use bevy_tessera::view::TerrainViews;
use std::path::Path;
use std::sync::{Arc, OnceLock};

/// The bundled elevation model, baked once a test binary.
pub fn bundled() -> &'static Path {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    FOLDER
        .get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            let source =
                Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/elevation/jacksboro_u16.png");
            let import_settings = ImportSettings {
                scale: Some(0.02),
                offset: Some(200.0),
                ..Default::default()
            };
            let settings = BakeSettings {
                spacing_m: Some(30.0),
                ..Default::default()
            };
            let mut source = import::open(&source, &import_settings).unwrap();
            bake(
                &mut *source,
                &folder.path().join("jacksboro"),
                &settings,
                &(),
            )
            .unwrap();
            folder
        })
        .path()
}

/// A running app with one terrain and one camera whose pictures nobody looks at.
pub struct Kernels {
    pub app: App,
    pub terrain: Entity,
    pub camera: Entity,
}

/// What the passes wrote in a frame, and what the twin needs to write it again.
pub struct ReadBack {
    pub args: GpuTerrainDrawArgs,
    pub vertices: Vec<TerrainVertex>,
    pub triangles: Vec<[u32; 3]>,
    pub factors: Vec<FaceFactors>,
    pub nodes: Vec<Node>,
    pub lattice: Lattice,
    pub lod: ViewLod,
    pub field: ResidencyField,
    pub factor_view: FactorView,
    pub pages: Pages,
    pub settings: TerrainCamera,
    pub detail: DetailKernel,
    /// The room that there was in this frame.
    pub max_vertices: u32,
    pub height_min_m: f32,
    pub height_step_m: f32,
    /// What each triangle belongs to, and the error bounds of faces' parts, while overlays are on.
    pub triangle_faces: Vec<TriangleFace>,
    pub part_errors: Vec<f32>,
}

/// While it is there, only what is seen is drawn.
#[derive(Resource)]
pub struct Culled;

/// Every node, seen or not: culling is tested by itself.
fn draw_everything(
    mut cameras: Query<(&TerrainViews, &mut TerrainNodes)>,
    terrains: Query<&TerrainState>,
) {
    for (views, mut drawn) in &mut cameras {
        for view in &views.views {
            let state = terrains.get(view.terrain).unwrap();
            drawn.culling.remove(&view.terrain);
            let nodes = drawn.nodes.entry(view.terrain).or_default();
            nodes.clear();
            if state.is_ready() {
                view.lod
                    .select(state.lattice(), &mut |_, _| true, &mut |node| {
                        nodes.push(node)
                    });
            }
        }
    }
}

impl Kernels {
    /// Starts with the terrain's root resident and nothing more.
    pub fn start(settings: TerrainSettings, size: UVec2) -> Self {
        Self::start_on(bundled(), settings, size)
    }

    /// The same on the terrain `jacksboro` in the folder `assets`.
    pub fn start_on(assets: &Path, settings: TerrainSettings, size: UVec2) -> Self {
        let app = app::app(assets, false);
        Self::start_in(app, "jacksboro/terrain.ron", settings, size)
    }

    /// The same in an app that has not been finished yet, on the terrain of this manifest.
    pub fn start_in(
        mut app: App,
        manifest: &'static str,
        settings: TerrainSettings,
        size: UVec2,
    ) -> Self {
        app.add_systems(
            PostUpdate,
            draw_everything
                .after(TerrainRenderSystems::Cull)
                .run_if(not(resource_exists::<Culled>)),
        );
        app::finish(&mut app);
        let target = app::target(&mut app, size.x, size.y);
        let manifest = app.world().resource::<AssetServer>().load(manifest);
        let terrain = app
            .world_mut()
            .spawn((Terrain::new(manifest), settings))
            .id();
        let camera = app
            .world_mut()
            .spawn((
                Camera3d::default(),
                Msaa::Off,
                TerrainCamera::default(),
                app::into_image(&target),
                Transform::from_xyz(15e3, 900.0, 15e3),
            ))
            .id();
        for _ in 0..400 {
            app.update();
            let state = app.world().get::<TerrainState>(terrain);
            if state.is_some_and(TerrainState::is_ready) {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        Self {
            app,
            terrain,
            camera,
        }
    }

    pub fn state(&self) -> &TerrainState {
        self.app.world().get(self.terrain).unwrap()
    }

    pub fn set_camera(&mut self, transform: Transform, settings: TerrainCamera) {
        self.app
            .world_mut()
            .entity_mut(self.camera)
            .insert((transform, settings));
    }

    /// Draws a frame and reads what the passes wrote in it.
    pub fn frame(&mut self) -> ReadBack {
        self.app.update();
        let world = self.app.world();
        let state = self.state();
        let settings = world.get::<TerrainCamera>(self.camera).unwrap().clone();
        let view = *world
            .get::<TerrainViews>(self.camera)
            .unwrap()
            .of(self.terrain)
            .expect("the camera sees the terrain");
        let camera = world.get::<Camera>(self.camera).unwrap();
        let file = &state.manifest().file;
        let mut pages = Pages::default();
        for tile in world.get::<TerrainTiles>(self.terrain).unwrap().iter() {
            let address = *world.get::<TileAddress>(tile).unwrap();
            // With its edits, unlike the asset.
            let data = state.tile_data(address).unwrap();
            pages.tiles.insert(address, Arc::new(data.clone()));
        }
        let nodes = world.get::<TerrainNodes>(self.camera).unwrap().nodes[&self.terrain].clone();

        let render = self.app.sub_app(RenderApp).world();
        let mesh = render
            .resource::<GpuTerrainMeshes>()
            .get(self.camera, self.terrain)
            .expect("the terrain was drawn");
        let args: GpuTerrainDrawArgs = read(render, mesh.args(), 1)[0];
        let vertices = read::<GpuTerrainVertex>(render, mesh.vertices(), args.vertices as usize)
            .into_iter()
            .map(|vertex| TerrainVertex {
                point: vertex.point.into(),
                height_m: vertex.height_m,
                lambda: vertex.lambda,
            })
            .collect();
        let faces = nodes.len() << (2 * view.lattice.faces_log2);
        ReadBack {
            args,
            vertices,
            triangles: read(render, mesh.indices(), args.triangles as usize),
            factors: read::<GpuFaceFactors>(render, mesh.factors(), faces)
                .into_iter()
                .map(FaceFactors::from)
                .collect(),
            nodes,
            lattice: view.lattice,
            lod: view.lod,
            field: state.field().clone(),
            factor_view: FactorView {
                segments_per_radian: mesh.uniform().segments_per_radian,
                segments_per_m: mesh.uniform().segments_per_m,
                max_error_px: mesh.uniform().max_error_px,
                ..factor_view(camera, &settings, &view, state).unwrap()
            },
            max_vertices: mesh.uniform().max_vertices,
            detail: *state.detail(),
            pages,
            settings,
            height_min_m: file.height_min_m as f32,
            height_step_m: file.height_step_m as f32,
            triangle_faces: mesh.triangle_faces().map_or_else(Vec::new, |buffer| {
                read::<GpuTriangleFace>(render, buffer, args.triangles as usize)
                    .into_iter()
                    .map(TriangleFace::from)
                    .collect()
            }),
            part_errors: mesh.part_errors().map_or_else(Vec::new, |buffer| {
                read(render, buffer, FacePart::ALL.len() * faces)
            }),
        }
    }
}

impl ReadBack {
    /// The twin of the view that was drawn.
    pub fn twin(&self) -> ViewMesh<'_, Pages> {
        ViewMesh {
            lattice: &self.lattice,
            lod: &self.lod,
            field: &self.field,
            factor_view: &self.factor_view,
            partitioning: self.settings.partitioning,
            pages: &self.pages,
            height_min_m: self.height_min_m,
            height_step_m: self.height_step_m,
            max_vertices: self.max_vertices,
            max_triangles: 2 * self.max_vertices,
            culling: None,
            detail: (self.detail.octave_count > 0).then_some(&self.detail),
        }
    }

    pub fn levels(&self) -> usize {
        let mut levels: Vec<i32> = self.nodes.iter().map(|node| node.level).collect();
        levels.sort_unstable();
        levels.dedup();
        levels.len()
    }
}

fn read<T: bytemuck::AnyBitPattern>(render: &World, buffer: &Buffer, count: usize) -> Vec<T> {
    let device = render.resource::<RenderDevice>();
    let queue = render.resource::<RenderQueue>();
    let bytes = (count * size_of::<T>()) as u64;
    if bytes == 0 {
        return Vec::new();
    }
    let staging = device.create_buffer(&BufferDescriptor {
        label: Some("read_back"),
        size: bytes,
        usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, bytes);
    queue.submit([encoder.finish()]);
    let slice = staging.slice(..);
    slice.map_async(MapMode::Read, |result| result.unwrap());
    device.poll(PollType::wait_indefinitely()).unwrap();
    let mapped = slice.get_mapped_range();
    mapped
        .chunks_exact(size_of::<T>())
        .map(bytemuck::pod_read_unaligned)
        .collect()
}
