//! The pages of all terrains on the GPU.

use super::extract::{PageData, PageUpload};
use super::page_part::Texels;
use crate::stream::PAGE_BYTES;
use crate::tile::{DENSITY_TEXELS, HeightTile, TILE_STORED};
use bevy::prelude::*;
use bevy::render::render_resource::{
    CommandEncoderDescriptor, Extent3d, Origin3d, TexelCopyBufferLayout, TexelCopyTextureInfo,
    Texture, TextureAspect, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages,
    TextureView, TextureViewDescriptor, TextureViewDimension,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use half::f16;

/// Pages along the side of an atlas layer.
const PAGES_ACROSS: u32 = 8;
const PAGES_A_LAYER: u32 = PAGES_ACROSS * PAGES_ACROSS;

/// Textures that hold a page's share of one kind of data each, 64 pages a layer.
#[derive(Debug)]
pub(super) struct Atlas {
    texture: Texture,
    pub(super) view: TextureView,
    label: &'static str,
    /// Texels along a page's side.
    side: u32,
}

impl Atlas {
    pub(super) const fn texture(&self) -> &Texture {
        &self.texture
    }

    fn new(
        device: &RenderDevice,
        label: &'static str,
        format: TextureFormat,
        side: u32,
        layers: u32,
    ) -> Self {
        let texture = device.create_texture(&TextureDescriptor {
            label: Some(label),
            size: Extent3d {
                width: PAGES_ACROSS * side,
                height: PAGES_ACROSS * side,
                depth_or_array_layers: layers,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format,
            usage: TextureUsages::TEXTURE_BINDING
                | TextureUsages::COPY_DST
                | TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = texture.create_view(&TextureViewDescriptor {
            label: Some(label),
            dimension: Some(TextureViewDimension::D2Array),
            ..default()
        });
        Self {
            texture,
            view,
            label,
            side,
        }
    }

    /// The same with other layers, those that both have copied.
    fn resized(
        &self,
        device: &RenderDevice,
        encoder: &mut bevy::render::render_resource::CommandEncoder,
        layers: u32,
    ) -> Self {
        let new = Self::new(device, self.label, self.texture.format(), self.side, layers);
        let size = self.texture.size();
        encoder.copy_texture_to_texture(
            self.texture.as_image_copy(),
            new.texture.as_image_copy(),
            Extent3d {
                depth_or_array_layers: size.depth_or_array_layers.min(layers),
                ..size
            },
        );
        new
    }

    fn write(&self, queue: &RenderQueue, page: u32, bytes: &[u8]) {
        self.write_part(queue, page, [0; 2], [self.side; 2], bytes);
    }

    /// Writes the `size` texels of a page that begin at `first`, of which `bytes` has the rows.
    fn write_part(
        &self,
        queue: &RenderQueue,
        page: u32,
        first: [u32; 2],
        size: [u32; 2],
        bytes: &[u8],
    ) {
        if size.contains(&0) {
            return;
        }
        let place = page % PAGES_A_LAYER;
        queue.write_texture(
            TexelCopyTextureInfo {
                texture: &self.texture,
                mip_level: 0,
                origin: Origin3d {
                    x: place % PAGES_ACROSS * self.side + first[0],
                    y: place / PAGES_ACROSS * self.side + first[1],
                    z: page / PAGES_A_LAYER,
                },
                aspect: TextureAspect::All,
            },
            bytes,
            TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some((bytes.len() / size[1] as usize) as u32),
                rows_per_image: Some(size[1]),
            },
            Extent3d {
                width: size[0],
                height: size[1],
                depth_or_array_layers: 1,
            },
        );
    }
}

/// What the tiles hold that are resident, by page; shared by all terrains. In the render world.
#[derive(Resource)]
pub struct GpuTerrainPages {
    layers: u32,
    pub(super) heights: Atlas,
    pub(super) gradients: Atlas,
    pub(super) densities: Atlas,
    pub(super) errors: Atlas,
    /// Rises when the textures are replaced, so that bind groups are built anew.
    pub(super) generation: u64,
    /// How often a page has been written.
    pub(super) writes: u64,
}

impl FromWorld for GpuTerrainPages {
    fn from_world(world: &mut World) -> Self {
        let device = world.resource::<RenderDevice>();
        let atlas = |label, format, side| Atlas::new(device, label, format, side, 1);
        Self {
            layers: 1,
            heights: atlas("terrain_height_pages", TextureFormat::R16Uint, TILE_STORED),
            gradients: atlas(
                "terrain_gradient_pages",
                TextureFormat::Rg16Float,
                TILE_STORED,
            ),
            densities: atlas(
                "terrain_density_pages",
                TextureFormat::R8Uint,
                DENSITY_TEXELS,
            ),
            errors: atlas(
                "terrain_error_pages",
                TextureFormat::Rg32Uint,
                DENSITY_TEXELS,
            ),
            generation: 0,
            writes: 0,
        }
    }
}

impl GpuTerrainPages {
    /// The textures of heights, gradients, densities and error bounds; they may be others in the next
    /// frame. Page `p` lies in layer `p / 64`, as the square in column `p % 8` and row `p % 64 / 8`,
    /// whose sides are 133, 133, 32 and 32 texels.
    #[must_use]
    pub const fn textures(&self) -> [&Texture; 4] {
        let Self {
            heights,
            gradients,
            densities,
            errors,
            ..
        } = self;
        [
            &heights.texture,
            &gradients.texture,
            &densities.texture,
            &errors.texture,
        ]
    }

    /// Bytes of GPU memory that the textures take, pages that are free included.
    pub(super) fn bytes(&self) -> u64 {
        u64::from(self.layers * PAGES_A_LAYER) * PAGE_BYTES
    }

    /// Grows the textures to hold so many pages, by half of what there is at least, and lets them
    /// shrink to fit where they are more than four times too large. What they hold stays.
    pub(super) fn make_room(&mut self, pages: u32, device: &RenderDevice, queue: &RenderQueue) {
        let wanted = pages.div_ceil(PAGES_A_LAYER).max(1);
        let most = device.limits().max_texture_array_layers;
        let layers = if wanted > self.layers {
            wanted.max(self.layers + self.layers / 2).min(most)
        } else if wanted * 4 < self.layers {
            wanted
        } else {
            return;
        };
        if layers == self.layers {
            return;
        }
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor {
            label: Some("terrain_pages_copy"),
        });
        for atlas in [
            &mut self.heights,
            &mut self.gradients,
            &mut self.densities,
            &mut self.errors,
        ] {
            *atlas = atlas.resized(device, &mut encoder, layers);
        }
        queue.submit([encoder.finish()]);
        self.layers = layers;
        self.generation += 1;
    }

    /// Writes a tile's data, or what has changed of it, to its page. Pages that there are no layers
    /// for stay unwritten.
    pub(super) fn write(
        &mut self,
        queue: &RenderQueue,
        upload: &PageUpload,
        gradient_scale: f32,
        scratch: &mut Vec<[f16; 2]>,
    ) {
        let PageUpload {
            page,
            address,
            data,
        } = upload;
        if *page >= self.layers * PAGES_A_LAYER {
            return;
        }
        self.writes += 1;
        let scale = gradient_scale / (1_u32 << address.level) as f32;
        match data {
            PageData::Whole(tile) => {
                let heights = bytemuck::cast_slice(tile.heights.samples());
                self.heights.write(queue, *page, heights);
                self.densities
                    .write(queue, *page, &tile.densities.own_texels());
                let errors = bytemuck::cast_slice(tile.errors.texels().as_flattened());
                self.errors.write(queue, *page, errors);
                tile_gradients(&tile.heights, scale, scratch);
                self.gradients
                    .write(queue, *page, bytemuck::cast_slice(scratch));
            }
            PageData::Part(part) => {
                let Texels { first, size, .. } = part.heights;
                let heights = bytemuck::cast_slice(&part.heights.texels);
                self.heights.write_part(queue, *page, first, size, heights);
                let Texels { first, size, .. } = part.densities;
                let densities = &part.densities.texels;
                self.densities
                    .write_part(queue, *page, first, size, densities);
                let Texels { first, size, .. } = part.errors;
                let errors = bytemuck::cast_slice(part.errors.texels.as_flattened());
                self.errors.write_part(queue, *page, first, size, errors);
                let (first, size) = part.gradients(scale, scratch);
                let gradients = bytemuck::cast_slice(scratch);
                self.gradients
                    .write_part(queue, *page, first, size, gradients);
            }
        }
    }
}

/// Rise of the ground per metre in x and z at every stored sample, by central differences (the
/// cross filter of Andersson 2007, listing 1, before it is normalised). `scale` is metres per
/// stored unit over the distance of the two samples. The outermost samples take the difference
/// that they have; nothing inside a tile reads them.
pub fn tile_gradients(tile: &HeightTile, scale: f32, gradients: &mut Vec<[f16; 2]>) {
    let side = TILE_STORED as usize;
    let samples = tile.samples();
    gradients.clear();
    gradients.reserve(side * side);
    for z in 0..side {
        let row = &samples[z * side..][..side];
        let above = &samples[z.saturating_sub(1) * side..][..side];
        let below = &samples[(z + 1).min(side - 1) * side..][..side];
        for x in 0..side {
            let left = f32::from(row[x.saturating_sub(1)]);
            let right = f32::from(row[(x + 1).min(side - 1)]);
            gradients.push([
                f16::from_f32((right - left) * scale),
                f16::from_f32((f32::from(below[x]) - f32::from(above[x])) * scale),
            ]);
        }
    }
}
