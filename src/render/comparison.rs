//! Two settings of one camera side by side, and the difference between their pictures.

mod camera;
mod pass;

pub use camera::{ComparedComponents, ComparisonCamera};
pub use pass::GpuComparison;

use crate::terrain::TerrainCamera;
use bevy::asset::{embedded_asset, load_embedded_asset};
use bevy::core_pipeline::{Core3d, Core3dSystems};
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::shader::Shader;

/// Shows what a [`TerrainCamera`] sees beside what it would see with other settings, while it is on
/// the camera's entity.
///
/// A second camera, marked with [`ComparisonCamera`], draws the other picture into an image of its
/// own; it follows the first one, its projection, its post-processing, its overlays and its
/// [`TerrainEye`](crate::view::TerrainEye). The two pictures are put together at the end of the first
/// camera's post-processing, below its user interface. So
/// - a frame costs twice as much, shadows of directional lights included, and the second picture takes as
///   much memory again;
/// - both cameras ask for the tiles that they need; in
///   [`TerrainDiagnostics`](super::TerrainDiagnostics) the second one counts in memory alone, and its own
///   figures are in its [`TerrainStatistics`](super::TerrainStatistics);
/// - it begins one frame after the component has come, and ends in the frame in which it goes, and
///   nothing of it is left then;
/// - what earlier cameras have drawn below the first one (`ClearColorConfig::None`) is not in the
///   other picture;
/// - shadows of point and spot lights, for which all cameras share one mesh, are the same in both: those
///   of the camera's own picture, or of that of another camera that isn't the second of any
///   comparison.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_tessera::render::{ComparisonCamera, ComparisonView, TerrainComparison};
/// # use bevy_tessera::terrain::TerrainCamera;
/// /// What the density map leaves out, eight times as strong.
/// fn compare(
///     mut commands: Commands,
///     camera: Single<(Entity, &TerrainCamera), Without<ComparisonCamera>>,
/// ) {
///     let (entity, settings) = *camera;
///     commands.entity(entity).insert(TerrainComparison {
///         other: TerrainCamera {
///             density: 0.0,
///             ..settings.clone()
///         },
///         view: ComparisonView::Difference { gain: 8.0 },
///     });
/// }
/// ```
#[derive(Component, Clone, Debug, PartialEq, Reflect)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct TerrainComparison {
    /// The other settings. The default is the camera's default without its density map.
    pub other: TerrainCamera,
    /// How the two pictures become one.
    pub view: ComparisonView,
}

impl Default for TerrainComparison {
    fn default() -> Self {
        Self {
            other: TerrainCamera {
                density: 0.0,
                ..default()
            },
            view: ComparisonView::default(),
        }
    }
}

/// How two pictures become one.
#[derive(Clone, Copy, Debug, PartialEq, Reflect)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub enum ComparisonView {
    /// The camera's own picture to the left of a line, the other to the right. The line is two
    /// logical pixels wide, black and white, so that it shows on any ground; there is none at 0 and
    /// at 1.
    Split {
        /// Where the line is, 0 (the left edge) to 1 (the right one). What lies beyond is taken for the
        /// nearest of these, what isn't a number for ½.
        divider: f32,
    },
    /// The difference of the two, grey where they are equal (Cervin 2012, figures 4.1 to 4.3): each of
    /// red, green and blue is `128/255 + gain · (own − other)`, kept within 0 and 1, with all of them
    /// encoded as in an 8-bit sRGB picture. So it is lighter where the camera's own picture is.
    Difference {
        /// What differences are multiplied by, 1 to 64. What lies beyond is taken for the nearest of these,
        /// what isn't a number for 1.
        gain: f32,
    },
}

impl Default for ComparisonView {
    fn default() -> Self {
        Self::Split { divider: 0.5 }
    }
}

/// Comparisons. Part of [`TerrainRenderPlugin`](super::TerrainRenderPlugin).
pub(super) struct ComparisonPlugin;

impl Plugin for ComparisonPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<TerrainComparison>()
            .register_type::<ComparisonCamera>();
        camera::build(app);
        embedded_asset!(app, "shaders/comparison.wgsl");
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
            return;
        };
        pass::build(render_app);
    }

    // When the other plugins have added theirs.
    fn finish(&self, app: &mut App) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
            return;
        };
        render_app.edit_schedule(Core3d, |schedule| {
            let effects = pass::effects(schedule.graph());
            schedule.add_systems(
                pass::compare
                    .in_set(Comparing)
                    .in_set(Core3dSystems::PostProcess),
            );
            for effect in effects {
                schedule.configure_sets(Comparing.after(effect));
            }
        });
    }
}

/// Paths of embedded files are relative to the one that names them, and lead no folder up.
fn shader(assets: &AssetServer) -> Handle<Shader> {
    load_embedded_asset!(assets, "shaders/comparison.wgsl")
}

/// The pass that makes one picture of two.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Comparing;
