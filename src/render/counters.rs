//! Reads back what the passes counted, a frame or two after it was written, and never waits.

use super::gpu_types::{GpuTerrainCounters, GpuTerrainDrawArgs};
use super::overlay::StoredDensities;
use super::pages::GpuTerrainPages;
use super::prepare::{GpuTerrain, GpuTerrainMeshes, GpuTerrains, buffer};
use super::statistics::{Measured, SharedStatistics, TerrainGpuMemory, TerrainViewStatistics};
use bevy::prelude::*;
use bevy::render::render_resource::{
    Buffer, BufferDescriptor, BufferUsages, CommandEncoder, MapMode, PollType,
};
use bevy::render::renderer::{RenderContext, RenderDevice};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

const ARGS_BYTES: u64 = size_of::<GpuTerrainDrawArgs>() as u64;
const COUNTERS_BYTES: u64 = size_of::<GpuTerrainCounters>() as u64;

/// Frames whose counters may be on their way at once.
const SLOTS: usize = 3;

const FREE: u8 = 0;
/// The copy into the slot is part of a frame that is being recorded or was submitted.
const COPIED: u8 = 1;
const MAPPING: u8 = 2;
const READY: u8 = 3;
const FAILED: u8 = 4;

/// A buffer that a frame's counters are copied into.
struct Slot {
    buffer: Buffer,
    state: Arc<AtomicU8>,
    /// What the frame was drawn with.
    room_vertices: u32,
    width_scale: f32,
    measured: Measured,
}

/// A mesh's counters, on the GPU and on their way back.
pub(super) struct Counters {
    pub(super) buffer: Buffer,
    slots: Vec<Slot>,
    /// The newest that have arrived.
    newest: Option<TerrainViewStatistics>,
}

impl Counters {
    pub(super) fn new(device: &RenderDevice) -> Self {
        let slot = |_| Slot {
            buffer: device.create_buffer(&BufferDescriptor {
                label: Some("terrain_counters_read_back"),
                size: ARGS_BYTES + COUNTERS_BYTES,
                usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
            state: Arc::new(AtomicU8::new(FREE)),
            room_vertices: 0,
            width_scale: 1.0,
            measured: Measured::default(),
        };
        Self {
            buffer: buffer(
                device,
                "terrain_counters",
                COUNTERS_BYTES,
                BufferUsages::STORAGE | BufferUsages::COPY_SRC,
            ),
            slots: (0..SLOTS).map(slot).collect(),
            newest: None,
        }
    }

    /// Copies this frame's counters into a free slot; skips the frame where none is.
    pub(super) fn copy(
        &mut self,
        encoder: &mut CommandEncoder,
        args: &Buffer,
        room_vertices: u32,
        width_scale: f32,
        measured: Measured,
    ) {
        let free = |slot: &&mut Slot| slot.state.load(Ordering::Acquire) == FREE;
        let Some(slot) = self.slots.iter_mut().find(free) else {
            return;
        };
        encoder.copy_buffer_to_buffer(args, 0, &slot.buffer, 0, ARGS_BYTES);
        encoder.copy_buffer_to_buffer(&self.buffer, 0, &slot.buffer, ARGS_BYTES, COUNTERS_BYTES);
        slot.room_vertices = room_vertices;
        slot.width_scale = width_scale;
        slot.measured = measured;
        slot.state.store(COPIED, Ordering::Release);
    }

    /// Asks for the slots whose frames have been submitted.
    fn map(&self) {
        for slot in &self.slots {
            if slot.state.load(Ordering::Acquire) != COPIED {
                continue;
            }
            slot.state.store(MAPPING, Ordering::Release);
            let state = slot.state.clone();
            slot.buffer
                .slice(..)
                .map_async(MapMode::Read, move |result| {
                    let next = if result.is_ok() { READY } else { FAILED };
                    state.store(next, Ordering::Release);
                });
        }
    }

    /// Takes what has arrived; `None` where nothing new has.
    fn take(&mut self) -> Option<TerrainViewStatistics> {
        let mut taken = None;
        for slot in &mut self.slots {
            match slot.state.load(Ordering::Acquire) {
                READY => {
                    let mapped = slot.buffer.slice(..).get_mapped_range();
                    let (args, counters) = mapped.split_at(ARGS_BYTES as usize);
                    taken = Some(TerrainViewStatistics::new(
                        bytemuck::pod_read_unaligned(args),
                        bytemuck::pod_read_unaligned(counters),
                        slot.room_vertices,
                        slot.width_scale,
                        slot.measured,
                    ));
                    drop(mapped);
                    slot.buffer.unmap();
                    slot.state.store(FREE, Ordering::Release);
                }
                // The device is lost or about to be; nothing is mapped.
                FAILED => slot.state.store(FREE, Ordering::Release),
                _ => {}
            }
        }
        if taken.is_some() {
            self.newest = taken;
        }
        taken
    }
}

/// Takes the counters that have arrived; before buffers grow by them.
pub(super) fn read_counters(
    mut meshes: ResMut<GpuTerrainMeshes>,
    device: Res<RenderDevice>,
    terrains: Res<GpuTerrains>,
    pages: Res<GpuTerrainPages>,
    densities: Res<StoredDensities>,
    shared: Res<SharedStatistics>,
) {
    let _span = bevy::log::debug_span!("terrain_read_counters").entered();
    for mesh in meshes.meshes.values() {
        mesh.counters.map();
    }
    // What has been finished is handed over now, and nothing is waited for. Errors come again where
    // Bevy looks for them.
    let _ = device.poll(PollType::Poll);
    for mesh in meshes.meshes.values_mut() {
        if let Some(counted) = mesh.counters.take() {
            mesh.follow(&counted);
        }
    }
    shared.with(|shared| {
        shared
            .views
            .retain(|key, _| meshes.meshes.contains_key(key));
        // What all meshes with overlays share.
        let mut meshes_bytes = densities.bytes();
        for (key, mesh) in &meshes.meshes {
            let bytes = mesh.bytes();
            meshes_bytes += bytes;
            if let Some(newest) = mesh.counters.newest {
                let gpu_bytes = bytes;
                shared.views.insert(
                    *key,
                    TerrainViewStatistics {
                        gpu_bytes,
                        ..newest
                    },
                );
            }
        }
        shared.memory = TerrainGpuMemory {
            pages_bytes: pages.bytes(),
            meshes_bytes,
            tables_bytes: terrains.terrains.values().map(GpuTerrain::bytes).sum(),
        };
    });
}

/// Copies this frame's counters to where the CPU can read them.
pub(super) fn copy_counters(mut meshes: ResMut<GpuTerrainMeshes>, mut context: RenderContext) {
    if meshes.meshes.is_empty() {
        return;
    }
    let encoder = context.command_encoder();
    for mesh in meshes.meshes.values_mut() {
        mesh.copy_counters(encoder);
    }
}
