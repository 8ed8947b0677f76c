//! What overlays have on the GPU: nothing while none is on.

use super::super::extract::ExtractedTerrains;
use super::super::gpu_types::GpuTerrainView;
use super::super::pages::GpuTerrainPages;
use super::super::pipelines::TerrainPipelines;
use super::super::prepare::buffer;
use super::legend::STOPS;
use super::{TerrainOverlay, TerrainOverlays};
use crate::tessellate::{FacePart, TriangleFace};
use bevy::prelude::*;
use bevy::render::render_resource::{
    BindGroup, Buffer, BufferUsages, CachedComputePipelineId, ComputePipelineDescriptor,
    PipelineCache, TexelCopyBufferInfo, TexelCopyBufferLayout,
};
use bevy::render::renderer::{RenderContext, RenderDevice, RenderQueue};
use bytemuck::{Pod, Zeroable};

/// The longest edge of a triangle, in lengths of a segment: the diagonal of a square.
const STRETCH: f32 = std::f32::consts::SQRT_2;

const COUNT: usize = TerrainOverlay::ALL.len();

/// What overlays a camera's draws of the ground show; WGSL `TerrainOverlays`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuTerrainOverlays {
    /// How much each overlay covers, by its number.
    pub opacities: [f32; COUNT],
    /// The longest edge of a triangle that the camera asks for, pixels.
    pub target_px: f32,
    /// The error that the camera allows, pixels.
    pub max_error_px: f32,
    /// 1 where colours are to come out as in the legend.
    pub unlit: u32,
    /// Padding.
    pub unused: u32,
    /// Linear colours and the values that they stand for, eight an overlay; legends with fewer repeat
    /// their last.
    pub legend: [[[f32; 4]; STOPS]; COUNT],
}

impl GpuTerrainOverlays {
    /// Overlays of a camera whose view, before any budget widened its triangles, is `view`.
    #[must_use]
    pub fn new(overlays: &TerrainOverlays, view: &GpuTerrainView) -> Self {
        // Segments of triangles as wide as asked for, at a metre's distance or by the metre.
        let (pixels, segments) = if view.focal_px > 0.0 {
            (view.focal_px, view.segments_per_radian)
        } else {
            (view.px_per_m, view.segments_per_m)
        };
        Self {
            opacities: TerrainOverlay::ALL.map(|overlay| overlays.opacity(overlay)),
            target_px: STRETCH * pixels / segments,
            max_error_px: if view.max_error_px > 0.0 {
                view.max_error_px
            } else {
                1.0
            },
            unlit: u32::from(!overlays.lit),
            unused: 0,
            legend: TerrainOverlay::ALL.map(|overlay| {
                let stops = overlay.legend();
                std::array::from_fn(|at| {
                    let stop = stops[at.min(stops.len() - 1)];
                    [
                        stop.color.red,
                        stop.color.green,
                        stop.color.blue,
                        stop.value,
                    ]
                })
            }),
        }
    }

    const fn shows(&self, overlay: TerrainOverlay) -> bool {
        self.opacities[overlay as usize] > 0.0
    }
}

/// What a triangle belongs to, as the pass of faces writes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuTriangleFace {
    /// Factor less one unit in 16 bits, part of the face in three, level counted from -8.
    pub packed: u32,
    /// The face, counted node by node.
    pub face: u32,
}

impl From<GpuTriangleFace> for TriangleFace {
    fn from(triangle: GpuTriangleFace) -> Self {
        let GpuTriangleFace { packed, face } = triangle;
        let part = (packed >> 16 & 7) as usize;
        Self {
            face,
            level: (packed >> 19).cast_signed() - 8,
            part: FacePart::ALL[part.min(FacePart::ALL.len() - 1)],
            factor: (packed & 0xffff) + 1,
        }
    }
}

/// A camera's overlays in this frame.
pub(in crate::render) type ExtractedOverlays = GpuTerrainOverlays;

/// The pass of faces; its pipeline is made when the first overlay is shown.
#[derive(Resource, Default)]
pub(in crate::render) struct OverlayPipelines {
    faces: Option<CachedComputePipelineId>,
    /// Whether there is a pass to find triangles' faces with; before there is, no overlay is shown.
    pub(in crate::render) is_ready: bool,
}

impl OverlayPipelines {
    /// The pass's pipeline, once it has been asked for.
    pub(in crate::render) const fn faces(&self) -> Option<CachedComputePipelineId> {
        self.faces
    }
}

/// What a view with overlays has beside its mesh.
pub(in crate::render) struct OverlayBuffers {
    uniform: Buffer,
    written: Option<GpuTerrainOverlays>,
    /// What each triangle belongs to.
    pub(in crate::render) faces: Buffer,
    /// Error bounds of the parts of each face, pixels.
    pub(in crate::render) errors: Buffer,
    triangle_room: u64,
    face_room: u64,
    /// Tells these buffers from all others of the same mesh.
    pub(in crate::render) generation: u64,
}

impl OverlayBuffers {
    pub(in crate::render) fn new(device: &RenderDevice, generation: u64) -> Self {
        let storage = |label| buffer(device, label, 16, BufferUsages::STORAGE);
        Self {
            uniform: buffer(
                device,
                "terrain_overlays",
                size_of::<GpuTerrainOverlays>() as u64,
                BufferUsages::UNIFORM,
            ),
            written: None,
            faces: storage("terrain_triangle_faces"),
            errors: storage("terrain_part_errors"),
            triangle_room: 0,
            face_room: 0,
            generation,
        }
    }

    /// Makes room for so many triangles and faces, and writes what is shown.
    pub(in crate::render) fn prepare(
        &mut self,
        device: &RenderDevice,
        queue: &RenderQueue,
        overlays: &GpuTerrainOverlays,
        [triangles, faces]: [u64; 2],
        next_generation: u64,
    ) {
        let storage = |label, bytes| {
            let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
            buffer(device, label, bytes, usage)
        };
        if self.triangle_room != triangles {
            self.triangle_room = triangles;
            let bytes = triangles * size_of::<GpuTriangleFace>() as u64;
            self.faces = storage("terrain_triangle_faces", bytes);
            self.generation = next_generation;
        }
        if self.face_room != faces {
            self.face_room = faces;
            let bytes = faces * (FacePart::ALL.len() * size_of::<f32>()) as u64;
            self.errors = storage("terrain_part_errors", bytes);
            self.generation = next_generation;
        }
        if self.written.as_ref() != Some(overlays) {
            self.written = Some(*overlays);
            queue.write_buffer(&self.uniform, 0, bytemuck::bytes_of(overlays));
        }
    }

    pub(in crate::render) const fn uniform(&self) -> &Buffer {
        &self.uniform
    }

    /// Bytes of GPU memory that they take.
    pub(in crate::render) fn bytes(&self) -> u64 {
        self.uniform.size() + self.faces.size() + self.errors.size()
    }
}

/// Bind groups of a view with overlays.
pub(in crate::render) struct OverlayGroups {
    pub(in crate::render) faces: BindGroup,
    pub(in crate::render) draw: BindGroup,
    /// The same with the preview of densities, while there is one.
    pub(in crate::render) preview_draw: Option<BindGroup>,
}

/// The atlas of stored densities where fragment shaders have no texture left to read it from.
#[derive(Resource, Default)]
pub(in crate::render) struct StoredDensities {
    buffer: Option<Buffer>,
    /// The atlas that the buffer has the size of, and how often it had been written when it was copied.
    built_for: u64,
    copied: Option<u64>,
    wanted: bool,
    /// Rises with every buffer.
    pub(in crate::render) generation: u64,
}

impl StoredDensities {
    /// The copy, while any camera has overlays on.
    pub(in crate::render) const fn buffer(&self) -> Option<&Buffer> {
        self.buffer.as_ref()
    }

    /// Bytes of GPU memory that it takes.
    pub(in crate::render) fn bytes(&self) -> u64 {
        self.buffer.as_ref().map_or(0, |buffer| buffer.size())
    }
}

/// Makes what overlays need in this frame, and lets go of what they don't any more.
pub(in crate::render) fn prepare_overlays(
    extracted: Res<ExtractedTerrains>,
    pages: Res<GpuTerrainPages>,
    device: Res<RenderDevice>,
    cache: Res<PipelineCache>,
    layouts: Res<TerrainPipelines>,
    mut pipelines: ResMut<OverlayPipelines>,
    mut densities: ResMut<StoredDensities>,
) {
    let overlays = || {
        extracted
            .views
            .iter()
            .filter_map(|view| view.overlays.as_ref())
    };
    let densities = &mut *densities;
    densities.wanted = overlays().any(|overlays| overlays.shows(TerrainOverlay::Density));
    if overlays().next().is_none() {
        densities.buffer = None;
        return;
    }
    let pipelines = &mut *pipelines;
    let faces = *pipelines.faces.get_or_insert_with(|| {
        cache.queue_compute_pipeline(ComputePipelineDescriptor {
            label: Some("terrain_faces_pipeline".into()),
            layout: vec![layouts.inputs_layout.clone(), layouts.faces_layout.clone()],
            shader: layouts.faces_shader.clone(),
            entry_point: Some("faces".into()),
            ..default()
        })
    });
    pipelines.is_ready = cache.get_compute_pipeline(faces).is_some();
    if densities.buffer.is_none() || densities.built_for != pages.generation {
        let size = pages.densities.texture().size();
        let texels = u64::from(size.width * size.height) * u64::from(size.depth_or_array_layers);
        densities.buffer = Some(buffer(
            &device,
            "terrain_stored_densities",
            texels,
            BufferUsages::STORAGE,
        ));
        densities.built_for = pages.generation;
        densities.copied = None;
        densities.generation += 1;
    }
}

/// Copies the densities that are stored, where they are shown and have changed.
pub(in crate::render) fn copy_densities(
    pages: Res<GpuTerrainPages>,
    mut densities: ResMut<StoredDensities>,
    mut context: RenderContext,
) {
    if !densities.wanted || densities.copied == Some(pages.writes) {
        return;
    }
    let Some(buffer) = &densities.buffer else {
        return;
    };
    let texture = pages.densities.texture();
    let size = texture.size();
    let _span = bevy::log::debug_span!("terrain_copy_densities").entered();
    let encoder = context.command_encoder();
    encoder.push_debug_group("terrain_copy_densities");
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        TexelCopyBufferInfo {
            buffer,
            layout: TexelCopyBufferLayout {
                offset: 0,
                // A row of pages of 32 texels of a byte is as long as copies' rows must be at the least.
                bytes_per_row: Some(size.width),
                rows_per_image: Some(size.height),
            },
        },
        size,
    );
    encoder.pop_debug_group();
    densities.copied = Some(pages.writes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tessellate::FACTOR_ONE;

    #[test]
    fn a_triangles_word_holds_what_it_belongs_to() {
        for level in [-8, 0, 23] {
            for part in FacePart::ALL {
                for factor in [FACTOR_ONE, 3 * FACTOR_ONE + 1, 64 * FACTOR_ONE] {
                    let packed =
                        (level + 8_i32).cast_unsigned() << 19 | part.number() << 16 | (factor - 1);
                    let triangle = TriangleFace::from(GpuTriangleFace { packed, face: 7 });
                    let wanted = TriangleFace {
                        face: 7,
                        level,
                        part,
                        factor,
                    };
                    assert_eq!(triangle, wanted);
                }
            }
        }
    }
}
