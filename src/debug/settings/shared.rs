//! What all terrains and cameras share: resources.

use crate::debug::form::{Field, Form, Group, Presence};
#[cfg(feature = "avian")]
use crate::physics::TerrainPhysics;
use crate::stream::TerrainStreaming;

/// Memory and time of streaming.
pub(super) const STREAMING: Group<TerrainStreaming> = Group {
    title: "Streaming",
    type_name: "TerrainStreaming",
    imports: "stream::TerrainStreaming",
    presence: Presence::Required,
    is_open: false,
    check: check_streaming,
    list: list_streaming,
};

fn check_streaming(streaming: &TerrainStreaming) -> Option<String> {
    let mut first = None;
    let _ = streaming.checked(|error| {
        first.get_or_insert_with(|| error.to_string());
    });
    first
}

fn list_streaming(form: &mut Form, streaming: &mut TerrainStreaming, default: &TerrainStreaming) {
    form.number(
        Field::new(
            "GPU pages",
            "page_bytes",
            "GPU memory for pages, 113 KiB each. Memory is taken as pages come into use.",
        )
        .mib(),
        TerrainStreaming::PAGE_BYTES_RANGE,
        &mut streaming.page_bytes,
        default.page_bytes,
    );
    form.number(
        Field::new(
            "tiles in memory",
            "tile_bytes",
            "Main memory for tiles, 44 KiB each. What is left over keeps tiles that have lost their \
             page.",
        )
        .mib(),
        TerrainStreaming::TILE_BYTES_RANGE,
        &mut streaming.tile_bytes,
        default.tile_bytes,
    );
    form.number(
        Field::new(
            "loads in flight",
            "loads_in_flight",
            "The most tiles that are read at once.",
        )
        .unit("tiles"),
        TerrainStreaming::LOADS_RANGE,
        &mut streaming.loads_in_flight,
        default.loads_in_flight,
    );
    form.number(
        Field::new(
            "upload per frame",
            "upload_bytes_per_frame",
            "What is uploaded to the GPU in one frame at most, at least one page.",
        )
        .mib(),
        TerrainStreaming::UPLOAD_BYTES_RANGE,
        &mut streaming.upload_bytes_per_frame,
        default.upload_bytes_per_frame,
    );
    form.number(
        Field::new(
            "eyes' lookahead",
            "lookahead_s",
            "How far ahead along their velocity eyes are followed.",
        )
        .unit("s"),
        TerrainStreaming::LOOKAHEAD_RANGE,
        &mut streaming.lookahead_s,
        default.lookahead_s,
    );
    form.number(
        Field::new(
            "load timeout",
            "load_timeout_s",
            "How long a tile may take to load before it counts as failed.",
        )
        .unit("s"),
        TerrainStreaming::PATIENCE_RANGE,
        &mut streaming.load_timeout_s,
        default.load_timeout_s,
    );
    form.number(
        Field::new(
            "retry after",
            "retry_s",
            "After how long what could not be read is asked for again. Doubles with every failure, \
             up to 32 times as long.",
        )
        .unit("s"),
        TerrainStreaming::PATIENCE_RANGE,
        &mut streaming.retry_s,
        default.retry_s,
    );
}

/// Colliders.
#[cfg(feature = "avian")]
pub(super) const PHYSICS: Group<TerrainPhysics> = Group {
    title: "Physics",
    type_name: "TerrainPhysics",
    imports: "physics::TerrainPhysics",
    presence: Presence::Required,
    is_open: false,
    check: check_physics,
    list: list_physics,
};

#[cfg(feature = "avian")]
fn check_physics(physics: &TerrainPhysics) -> Option<String> {
    let mut first = None;
    let _ = physics.checked(|error| {
        first.get_or_insert_with(|| error.to_string());
    });
    first
}

#[cfg(feature = "avian")]
const CHUNKS: [(u32, &str, &str); 4] = [
    (16, "16", "16"),
    (32, "32", "32"),
    (64, "64", "64"),
    (128, "128", "128"),
];

#[cfg(feature = "avian")]
fn list_physics(form: &mut Form, physics: &mut TerrainPhysics, default: &TerrainPhysics) {
    form.choice(
        Field::new(
            "chunk",
            "chunk_cells",
            "Cells along a collider's side. Smaller ones follow few bodies more closely; larger ones \
             have fewer seams. Another number makes all colliders anew.",
        )
        .unit("cells"),
        &CHUNKS,
        &mut physics.chunk_cells,
        default.chunk_cells,
    );
    form.number(
        Field::new(
            "margin",
            "margin_m",
            "How far around a body's box the ground gets colliders.",
        )
        .unit("m"),
        TerrainPhysics::MARGIN_RANGE,
        &mut physics.margin_m,
        default.margin_m,
    );
    form.number(
        Field::new(
            "bodies' lookahead",
            "lookahead_s",
            "How far ahead along their velocity bodies are followed.",
        )
        .unit("s"),
        TerrainPhysics::LOOKAHEAD_RANGE,
        &mut physics.lookahead_s,
        default.lookahead_s,
    );
    form.number(
        Field::new(
            "keep",
            "keep_s",
            "For how long colliders stay that nobody wants any more.",
        )
        .unit("s"),
        TerrainPhysics::KEEP_RANGE,
        &mut physics.keep_s,
        default.keep_s,
    );
    form.number(
        Field::new(
            "builds per step",
            "builds_per_step",
            "Colliders that are begun, or made finer, in one physics step at most.",
        ),
        TerrainPhysics::BUILDS_RANGE,
        &mut physics.builds_per_step,
        default.builds_per_step,
    );
    form.number(
        Field::new(
            "max colliders",
            "max_colliders",
            "The most colliders there may be, of all terrains.",
        ),
        TerrainPhysics::MAX_COLLIDERS_RANGE,
        &mut physics.max_colliders,
        default.max_colliders,
    );
    form.toggle(
        Field::new(
            "keep resident",
            "keep_resident",
            "Whether bodies keep the finest tiles under them resident.",
        ),
        &mut physics.keep_resident,
        default.keep_resident,
    );
    form.toggle(
        Field::new(
            "kinematic bodies",
            "kinematic_bodies",
            "Whether kinematic bodies get ground too.",
        ),
        &mut physics.kinematic_bodies,
        default.kinematic_bodies,
    );
    form.toggle(
        Field::new(
            "lift bodies",
            "lift_bodies",
            "Whether bodies that stood on the ground are lifted with it where it rises under them.",
        ),
        &mut physics.lift_bodies,
        default.lift_bodies,
    );
}

#[cfg(all(test, feature = "avian"))]
mod tests {
    use super::*;

    #[test]
    fn choices_are_what_the_settings_accept() {
        assert_eq!(CHUNKS.map(|(cells, ..)| cells), TerrainPhysics::CHUNK_CELLS);
    }
}
