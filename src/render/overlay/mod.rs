//! What the ground is made of, in colours over it.

mod gpu;
mod legend;

pub use gpu::{GpuTerrainOverlays, GpuTriangleFace};
pub use legend::TerrainLegendStop;

pub(super) use gpu::StoredDensities;
pub(super) use gpu::{ExtractedOverlays, OverlayBuffers, OverlayGroups, OverlayPipelines};

use super::{TerrainPass, TerrainRenderSystems};
use bevy::prelude::*;
use bevy::render::renderer::RenderGraph;
use bevy::render::{GpuResourceAppExt, Render, RenderApp};

/// What an overlay shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Reflect)]
#[reflect(Debug, Clone, PartialEq, Hash)]
#[repr(usize)]
pub enum TerrainOverlay {
    /// The density map: green where the ground is plain, red where it is rough (Cervin 2012, figure
    /// 4.4).
    Density,
    /// The level of the geometry, a colour a level.
    Level,
    /// The tessellation factor of the edge, or inside, that a triangle belongs to, 1 to 64.
    EdgeFactor,
    /// The longest edge of a triangle on the screen against that of the triangles that the camera asks
    /// for, the diagonal of a square as wide as
    /// [`triangle_width_px`](crate::terrain::TerrainCamera::triangle_width_px): blue where it is
    /// shorter, red where it is longer. Says nothing under
    /// [`TessellationPolicy::ScreenError`](crate::terrain::TessellationPolicy::ScreenError), which
    /// doesn't follow that width: look at [`ErrorBound`](Self::ErrorBound) there.
    TriangleSize,
    /// How far a vertex has morphed towards the coarser level, 0 to 1.
    Morph,
    /// How many levels the tiles that are resident are coarser than the place asks for, blended from
    /// place to place like what is drawn.
    Residency,
    /// The normal that shading uses, in the world.
    Normals,
    /// How steep the ground is, in degrees, detail included.
    Slope,
    /// The error on the screen that the triangles may leave at most: what the bounds stored with the
    /// tiles say of the part of a face that a triangle belongs to and of that part's factor, as
    /// [`TessellationPolicy::ScreenError`](crate::terrain::TessellationPolicy::ScreenError) counts it,
    /// against what that policy allows, or against 1 px under the policy of triangle widths.
    ErrorBound,
    /// How scorched the ground is, 0 to 1; see [`TerrainMask`](crate::edit::mask::TerrainMask).
    Destruction,
    /// Borders of the pages that the ground is read from.
    PageBorders,
    /// Edges of the triangles, over the shading; fainter where triangles are so small on the screen
    /// that their edges would hide the ground.
    Wireframe,
}

impl TerrainOverlay {
    /// All of them, in the order in which they are laid over each other: the last is on top.
    pub const ALL: [Self; 12] = [
        Self::Density,
        Self::Level,
        Self::EdgeFactor,
        Self::TriangleSize,
        Self::Morph,
        Self::Residency,
        Self::Normals,
        Self::Slope,
        Self::ErrorBound,
        Self::Destruction,
        Self::PageBorders,
        Self::Wireframe,
    ];

    /// What a legend calls it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Density => "density",
            Self::Level => "level",
            Self::EdgeFactor => "edge factor",
            Self::TriangleSize => "triangle size",
            Self::Morph => "morph",
            Self::Residency => "residency",
            Self::Normals => "normals",
            Self::Slope => "slope",
            Self::ErrorBound => "error bound",
            Self::Destruction => "destruction",
            Self::PageBorders => "page borders",
            Self::Wireframe => "wireframe",
        }
    }
}

/// Overlays over the terrains that a camera sees, while it is on the camera's entity. Where none is
/// on, the ground is drawn with the very shaders that are used without this component.
///
/// They are laid over the ground's own colour in the order of [`TerrainOverlay::ALL`]; what their
/// colours mean says [`TerrainOverlay::legend`]. Shadows and prepasses stay as they are.
///
/// While any is on, every triangle gets three vertices of its own to shade, a compute pass
/// ([`TerrainPass::Faces`]) finds out what triangles belong to, and that takes 16 bytes of GPU memory
/// more for each vertex that the view has room for, 20 bytes a face, and 1 KiB a page for all cameras
/// together. Where a camera leaves them no buffers (on a device with WebGPU's limits, one with
/// order-independent transparency), they are not drawn, which a warning says once.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_tessera::render::{ComparisonCamera, TerrainOverlay, TerrainOverlays};
/// fn look_closer(
///     mut commands: Commands,
///     camera: Single<Entity, (With<Camera3d>, Without<ComparisonCamera>)>,
/// ) {
///     let overlays = TerrainOverlays::only(TerrainOverlay::TriangleSize);
///     commands
///         .entity(*camera)
///         .insert(overlays.with(TerrainOverlay::Wireframe, 0.5));
/// }
/// ```
#[derive(Component, Clone, Debug, PartialEq, Reflect)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct TerrainOverlays {
    /// How much of what lies below each overlay covers, 0 (off) to 1, by
    /// [`TerrainOverlay`]'s number.
    pub opacities: [f32; TerrainOverlay::ALL.len()],
    /// Whether the overlays are lit like the ground; otherwise their colours are those of the legend,
    /// whatever the camera's tone mapping. Only what is done to the picture as a whole changes them:
    /// cameras with `Hdr`, or with a `DeferredPrepass`, need `Tonemapping::None` for colours as in the
    /// legend.
    pub lit: bool,
}

impl Default for TerrainOverlays {
    fn default() -> Self {
        Self {
            opacities: [0.0; TerrainOverlay::ALL.len()],
            lit: true,
        }
    }
}

impl TerrainOverlays {
    /// One overlay, fully opaque.
    #[must_use]
    pub fn only(overlay: TerrainOverlay) -> Self {
        Self::default().with(overlay, 1.0)
    }

    /// The same with one overlay's opacity set, 0 to 1.
    #[must_use]
    pub fn with(mut self, overlay: TerrainOverlay, opacity: f32) -> Self {
        self.opacities[overlay as usize] = opacity;
        self
    }

    /// How much an overlay covers, 0 to 1; what isn't a number is 0.
    #[must_use]
    pub fn opacity(&self, overlay: TerrainOverlay) -> f32 {
        let opacity = self.opacities[overlay as usize];
        if opacity.is_nan() {
            0.0
        } else {
            opacity.clamp(0.0, 1.0)
        }
    }

    /// Whether any overlay is on.
    #[must_use]
    pub fn is_on(&self) -> bool {
        TerrainOverlay::ALL
            .into_iter()
            .any(|overlay| self.opacity(overlay) > 0.0)
    }
}

/// Overlays. Part of [`TerrainRenderPlugin`](super::TerrainRenderPlugin).
pub(super) struct OverlayPlugin;

impl Plugin for OverlayPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<TerrainOverlays>();
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
            return;
        };
        render_app
            .init_gpu_resource::<StoredDensities>()
            .init_gpu_resource::<OverlayPipelines>()
            .add_systems(
                Render,
                gpu::prepare_overlays
                    .after(super::prepare::prepare_terrains)
                    .before(super::prepare::prepare_meshes)
                    .in_set(TerrainRenderSystems::Prepare),
            )
            .add_systems(
                RenderGraph,
                (gpu::copy_densities, super::passes::faces)
                    .chain()
                    .in_set(TerrainPass::Faces),
            );
    }
}
