//! The pages' textures, read back.

use super::gpu::Kernels;
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::render::render_resource::{
    BufferDescriptor, BufferUsages, CommandEncoderDescriptor, MapMode, PollType,
    TexelCopyBufferInfo, TexelCopyBufferLayout, Texture,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy_tessera::render::{GpuTerrainPages, tile_gradients};
use bevy_tessera::stream::{TerrainTiles, TilePage};
use bevy_tessera::tile::{TILE_STORED, TerrainTile, TileAddress};

const KINDS: [&str; 4] = ["heights", "gradients", "densities", "error bounds"];
/// Copies' rows begin at multiples of this.
const ROW_ALIGNMENT: u32 = 256;

/// A texture's texels.
struct Texels {
    bytes: Vec<u8>,
    texel_bytes: usize,
    /// From row to row, and from layer to layer.
    row_bytes: usize,
    layer_bytes: usize,
    /// Texels along a page's side.
    side: usize,
}

impl Texels {
    fn read(render: &World, texture: &Texture) -> Self {
        let device = render.resource::<RenderDevice>();
        let queue = render.resource::<RenderQueue>();
        let size = texture.size();
        let texel_bytes = texture.format().block_copy_size(None).unwrap();
        let row_bytes = (size.width * texel_bytes).next_multiple_of(ROW_ALIGNMENT);
        let bytes = u64::from(row_bytes * size.height) * u64::from(size.depth_or_array_layers);
        let staging = device.create_buffer(&BufferDescriptor {
            label: Some("pages_read_back"),
            size: bytes,
            usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            TexelCopyBufferInfo {
                buffer: &staging,
                layout: TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(row_bytes),
                    rows_per_image: Some(size.height),
                },
            },
            size,
        );
        queue.submit([encoder.finish()]);
        let slice = staging.slice(..);
        slice.map_async(MapMode::Read, |result| result.unwrap());
        device.poll(PollType::wait_indefinitely()).unwrap();
        Self {
            bytes: slice.get_mapped_range().to_vec(),
            texel_bytes: texel_bytes as usize,
            row_bytes: row_bytes as usize,
            layer_bytes: (row_bytes * size.height) as usize,
            side: size.width as usize / 8,
        }
    }

    /// A row of a page.
    fn row(&self, page: u32, row: usize) -> &[u8] {
        let (layer, place) = (page as usize / 64, page as usize % 64);
        let (x, z) = (place % 8 * self.side, place / 8 * self.side + row);
        let first = layer * self.layer_bytes + z * self.row_bytes + x * self.texel_bytes;
        &self.bytes[first..first + self.side * self.texel_bytes]
    }
}

/// What a tile's page is to hold, of each kind.
fn wanted(tile: &TerrainTile, gradient_scale: f32) -> [Vec<u8>; 4] {
    let mut gradients = Vec::new();
    tile_gradients(&tile.heights, gradient_scale, &mut gradients);
    [
        bytemuck::cast_slice(tile.heights.samples()).to_vec(),
        bytemuck::cast_slice(&gradients).to_vec(),
        tile.densities.own_texels().to_vec(),
        tile.errors.texels().as_flattened().to_vec(),
    ]
}

/// Checks that the pages of all resident tiles hold what the tiles do, byte by byte, as of the frame
/// that was drawn last. Returns the sentence that says what is wrong, or how many tiles there are.
pub fn check(kernels: &Kernels) -> Result<usize, String> {
    let world = kernels.app.world();
    let state = kernels.state();
    let render = kernels.app.sub_app(RenderApp).world();
    let textures = render.resource::<GpuTerrainPages>().textures();
    let textures = textures.map(|texture| Texels::read(render, texture));
    assert_eq!(textures[0].side, TILE_STORED as usize);
    let file = &state.manifest().file;
    let scale = (file.height_step_m / (2.0 * file.spacing_m)) as f32;
    let mut checked = 0;
    for tile in world.get::<TerrainTiles>(kernels.terrain).unwrap().iter() {
        let address = *world.get::<TileAddress>(tile).unwrap();
        let page = world.get::<TilePage>(tile).unwrap().0;
        let data = state.tile_data(address).unwrap();
        let wanted = wanted(data, scale / (1_u32 << address.level) as f32);
        for ((kind, texels), wanted) in KINDS.iter().zip(&textures).zip(&wanted) {
            let rows = wanted.chunks_exact(texels.side * texels.texel_bytes);
            assert_eq!(rows.len(), texels.side);
            for (z, wanted) in rows.enumerate() {
                let held = texels.row(page, z);
                let differs = held.iter().zip(wanted).position(|(a, b)| a != b);
                if let Some(at) = differs {
                    let x = at / texels.texel_bytes;
                    return Err(format!(
                        "{kind} of {address:?} on page {page} differ at column {x}, row {z}"
                    ));
                }
            }
        }
        checked += 1;
    }
    Ok(checked)
}
