#define_import_path bevy_tessera::types

// Structs that Rust fills or reads; each has its pair in `gpu_types.rs` and a layout test. No name
// that another module uses may end in a digit: composing would rename it.

// One in the 16.16 fixed point of morphs, levels of detail and edge parameters.
const ONE: i32 = 65536;
// An edge factor of 1.
const FACTOR_SHIFT: u32 = 10u;
const FACTOR_ONE: u32 = 1024u;
const FACTOR_MAX: u32 = 65536u;
// Scales that a view's factors can be brought down by.
const FACTOR_SCALES: u32 = 7u;
// What `counters` holds: faces drawn, faces culled, edges of drawn faces, those of them that would be
// cut more finely but for the largest factor, then the factors' and the triangle sizes' histograms.
const COUNTER_FACES: u32 = 0u;
const COUNTER_CULLED: u32 = 1u;
const COUNTER_EDGES: u32 = 2u;
const COUNTER_CLAMPED: u32 = 3u;
const COUNTER_FACTORS: u32 = 4u;
const COUNTER_SIZES: u32 = 32u;
// Vertices and triangles that the view would have at a density strength of 0, where they are counted.
const COUNTER_PLAIN_VERTICES: u32 = 64u;
const COUNTER_PLAIN_TRIANGLES: u32 = 65u;
const COUNTERS: u32 = 66u;
// Levels that a view can hold.
const MAX_LEVELS: u32 = 24u;
// Samples along a tile's side, its border before them, and its stored side.
const TILE_SAMPLES: i32 = 128;
const TILE_BORDER: i32 = 2;
const TILE_STORED: i32 = 133;
// Pages along the side of an atlas layer.
const PAGES_ACROSS: u32 = 8u;
// No page: the tile isn't resident.
const NO_PAGE: u32 = 0xffffffffu;

const PARTITIONING_FRACTIONAL_ODD: u32 = 0u;
const PARTITIONING_INTEGER: u32 = 1u;
const PARTITIONING_POWER_OF_TWO: u32 = 2u;
const PARTITIONING_FRACTIONAL_EVEN: u32 = 3u;
const PARTITIONING_POWER_OF_TWO_MORPH: u32 = 4u;
// Density texels along a tile's side.
const DENSITY_TEXELS: i32 = 32;
// The density of ground that deserves all triangles, in 8.16 fixed point.
const DENSITY_ONE: f32 = 16711680.0;

// Density filters.
const DENSITY_SECOND_ORDER: u32 = 0u;
const DENSITY_GAUSSIAN: u32 = 1u;
const DENSITY_MEAN: u32 = 2u;
const DENSITY_LAPLACE_BELTRAMI: u32 = 3u;
const DENSITY_LAPLACE_BELTRAMI_VORONOI: u32 = 4u;
const DENSITY_PRINCIPAL: u32 = 5u;
// Words that the densities of a page take in a preview, four texels each.
const DENSITY_PAGE_WORDS: u32 = 256u;

// The destruction mask, in words: a header (layers in use, a bit each; slots less one; pages that
// there is room for; width of the finest texels as a power of two of edit units), slots, pages.
const MASK_HEADER_WORDS: u32 = 4u;
const MASK_SLOT_WORDS: u32 = 3u;
const MASK_PAGE_WORDS: u32 = 1366u;
// What a slot's layer is shifted by; one more than the page's number lies below it.
const MASK_LAYER_SHIFT: u32 = 24u;
// Texels along a page's side, as a power of two, and its mips.
const MASK_PAGE_SHIFT: u32 = 6u;
const MASK_MIPS: u32 = 7u;

// What a triangle's word in the pass of faces holds: its factor less one unit below these, its part of
// the face, its level counted from the finest that there can be.
const TRIANGLE_PART_SHIFT: u32 = 16u;
const TRIANGLE_LEVEL_SHIFT: u32 = 19u;
const TRIANGLE_LEVEL_ZERO: i32 = 8;

// Overlays by their number, and stops that the legend of each has room for.
const OVERLAY_DENSITY: u32 = 0u;
const OVERLAY_LEVEL: u32 = 1u;
const OVERLAY_EDGE_FACTOR: u32 = 2u;
const OVERLAY_TRIANGLE_SIZE: u32 = 3u;
const OVERLAY_MORPH: u32 = 4u;
const OVERLAY_RESIDENCY: u32 = 5u;
const OVERLAY_NORMALS: u32 = 6u;
const OVERLAY_SLOPE: u32 = 7u;
const OVERLAY_ERROR_BOUND: u32 = 8u;
const OVERLAY_DESTRUCTION: u32 = 9u;
const OVERLAY_PAGE_BORDERS: u32 = 10u;
const OVERLAY_WIREFRAME: u32 = 11u;
const OVERLAYS: u32 = 12u;
const OVERLAY_STOPS: u32 = 8u;

// Everything that a view's mesh follows from.
struct TerrainView {
    eye: vec2<i32>,
    extent: vec2<i32>,
    eye_fraction: vec2<f32>,
    eye_height_m: f32,
    unit_m: f32,
    distance_floor: i32,
    planar: u32,
    unit_shift: u32,
    faces_shift: u32,
    leaf_level: i32,
    root_level: i32,
    partitioning: u32,
    node_count: u32,
    segments_per_radian: f32,
    segments_per_m: f32,
    min_triangle_m: f32,
    max_factor: f32,
    height_min_m: f32,
    height_step_m: f32,
    field_cell_shift: u32,
    max_vertices: u32,
    field_cells: vec2<u32>,
    max_triangles: u32,
    density_strength: f32,
    // Volumes that faces are culled by; with 0 none is.
    volume_count: u32,
    // Pixels a radian in the middle of the picture; 0 in orthographic views, which have pixels a metre.
    focal_px: f32,
    px_per_m: f32,
    // The error that the screen-error policy allows; 0 under the policy of triangle widths.
    max_error_px: f32,
    // Units of stored error bounds that make a metre.
    error_units_per_m: f32,
    unused_a: u32,
    unused_b: u32,
    // 1 where it is counted what the view would have at a density strength of 0.
    counts_plain: u32,
    // x: where the level begins to morph; y: its zone's length as a power of two.
    geometry: array<vec4<i32>, 24>,
    // x: the level's first entry in the page table; y, z: tiles across and down.
    tiles: array<vec4<u32>, 24>,
    // Six planes a volume.
    volumes: array<vec4<f32>, 96>,
}

// How a view's mesh comes to stand in the world.
struct TerrainDraw {
    // From metres relative to the eye that the mesh was made for.
    world_from_eye: mat4x4<f32>,
    previous_world_from_eye: mat4x4<f32>,
    // That eye: lattice point, fraction of a unit.
    eye_point: vec2<i32>,
    eye_fraction: vec2<f32>,
    // Its sample at level 0, whole and fraction.
    eye_sample: vec2<i32>,
    eye_sample_fraction: vec2<f32>,
    // Metres from the terrain's corner to it.
    eye_local_m: vec2<f32>,
    eye_height_m: f32,
    unit_m: f32,
    spacing_m: f32,
    root_level: i32,
    // How much of the ground's colour the preview of densities takes.
    density_opacity: f32,
    // Where the destruction mask begins in the tables; 0 while there is none.
    mask_first: u32,
    // x: the level's first entry in the page table; y, z: tiles across and down.
    tiles: array<vec4<u32>, 24>,
}

// What overlays a camera's draws of the ground show.
struct TerrainOverlays {
    // How much each covers, four a vector.
    opacities: array<vec4<f32>, 3>,
    // The longest edge that the camera asks for, and the error that it allows, pixels.
    target_px: f32,
    max_error_px: f32,
    // 1 where the colours are to come out as in the legend.
    unlit: u32,
    unused: u32,
    // Colours and, last, the values that they stand for, `OVERLAY_STOPS` an overlay.
    legend: array<vec4<f32>, 96>,
}

struct TerrainNode {
    origin: vec2<i32>,
    level: i32,
    // Between which heights it may be drawn, metres.
    lowest_m: f32,
    highest_m: f32,
    unused: u32,
}

struct TerrainVertex {
    point: vec2<i32>,
    height_m: f32,
    lambda: i32,
}

// Arguments of the indirect draw, then what became of the view.
struct TerrainDrawArgs {
    index_count: u32,
    instance_count: u32,
    first_index: u32,
    base_vertex: i32,
    first_instance: u32,
    // Power of two by which all factors were brought down.
    scale: u32,
    vertices: u32,
    triangles: u32,
    // What would have been drawn with room enough.
    wanted_vertices: u32,
    wanted_triangles: u32,
    unused: vec2<u32>,
}

// What turns heights into densities, for a preview.
struct DensityKernel {
    density_filter: u32,
    factor: f32,
    exponent: f32,
    unused: u32,
    levels: array<DensityLevel, 24>,
}

struct DensityLevel {
    // What a stored unit is worth in sample spacings, and what rounding to it makes of a plane.
    step: f32,
    noise: f32,
    // The level's samples in x and z that lie on the terrain, and its texels.
    samples: vec2<u32>,
    texels: vec2<u32>,
    unused: vec2<u32>,
}

// A page whose densities are to be made, and the tile that it holds.
struct DensityJob {
    page: u32,
    level: u32,
    tile: vec2<u32>,
}
