// Preview of densities: twin of `src/density/kernel.rs`, `DensityKernel::run`, for a tile's own
// 32 by 32 texels. A workgroup takes four rows of a page's texels: 17 rows of 129 samples and one
// more sample on every side, each height read once.

#import bevy_tessera::types::{
    DensityKernel, DensityLevel, DensityJob, TILE_BORDER, TILE_SAMPLES,
    DENSITY_SECOND_ORDER, DENSITY_GAUSSIAN, DENSITY_MEAN, DENSITY_LAPLACE_BELTRAMI,
    DENSITY_LAPLACE_BELTRAMI_VORONOI, DENSITY_PRINCIPAL, DENSITY_PAGE_WORDS,
}
#import bevy_tessera::height::{page_origin, page_layer}
#import bevy_tessera::curvature::{
    Ring, second_order, gaussian, mean, laplace_beltrami, laplace_beltrami_voronoi, principal,
}

@group(0) @binding(0) var<uniform> density_kernel: DensityKernel;
@group(0) @binding(1) var<storage, read> density_jobs: array<DensityJob>;
@group(0) @binding(2) var density_heights: texture_2d_array<u32>;
// Four texels a word, row by row, a page after the other.
@group(0) @binding(3) var<storage, read_write> densities: array<u32>;

const LANES: u32 = 256u;
const CELL: u32 = 4u;
// Rows of texels that a workgroup takes, its texels, and texels across.
const STRIP: u32 = 4u;
const TEXELS: u32 = 32u;
const STRIP_TEXELS: u32 = 128u;
// Samples that count, and those with their neighbours.
const WIDTH: u32 = 129u;
const HEIGHT: u32 = 17u;
const READ_WIDTH: u32 = 131u;
const READ_HEIGHT: u32 = 19u;

// 10 KiB together.
var<workgroup> heights: array<f32, 2489>;
// Curvatures are not negative, and such floats are ordered like their bits.
var<workgroup> largest: array<atomic<u32>, 128>;

// The magnitude of the curvature that the filter sees.
fn curvature(ring: Ring, unit: f32) -> f32 {
    switch density_kernel.density_filter {
        case DENSITY_SECOND_ORDER: { return abs(second_order(ring, unit)); }
        case DENSITY_GAUSSIAN: { return abs(gaussian(ring, unit)); }
        case DENSITY_LAPLACE_BELTRAMI: { return laplace_beltrami(ring, unit); }
        case DENSITY_LAPLACE_BELTRAMI_VORONOI: { return laplace_beltrami_voronoi(ring, unit); }
        case DENSITY_PRINCIPAL: { return principal(ring, unit); }
        default: { return abs(mean(ring, unit)); }
    }
}

// The density of ground whose largest curvature is `found`, never rounded down.
fn quantise(found: f32, noise: f32) -> u32 {
    let beyond = found - noise;
    let sure = min(found, beyond + beyond);
    var density = clamp(sure * density_kernel.factor, 0.0, 1.0);
    // Powers go through logarithms, which 0 has none of.
    if density_kernel.exponent != 1.0 && density > 0.0 {
        density = pow(density, density_kernel.exponent);
    }
    let stored = u32(ceil(min(density, 1.0) * 255.0));
    return max(stored, select(0u, 1u, sure * density_kernel.factor > 0.0));
}

fn ring_at(x: u32, z: u32) -> Ring {
    let above = z * READ_WIDTH + x;
    let middle = above + READ_WIDTH;
    let below = middle + READ_WIDTH;
    return Ring(
        heights[above], heights[above + 1u], heights[above + 2u],
        heights[middle], heights[middle + 1u], heights[middle + 2u],
        heights[below], heights[below + 1u], heights[below + 2u],
    );
}

// The height of a sample of the terrain, counted from one before the strip's first. Beyond the rim
// the ground goes on straight.
fn read_height(page: u32, origin: vec2<i32>, sample: vec2<i32>, samples: vec2<i32>) -> f32 {
    let on = clamp(sample, vec2(0), samples - 1);
    let layer = page_layer(page);
    let here = f32(textureLoad(density_heights, origin + on, layer, 0).r);
    if all(on == sample) {
        return here;
    }
    let inner = 2 * on - sample;
    let across = f32(textureLoad(density_heights, origin + vec2(inner.x, on.y), layer, 0).r);
    let down = f32(textureLoad(density_heights, origin + vec2(on.x, inner.y), layer, 0).r);
    let both = f32(textureLoad(density_heights, origin + inner, layer, 0).r);
    return 2.0 * (2.0 * here - across) - (2.0 * down - both);
}

@compute @workgroup_size(256)
fn density(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let job = density_jobs[workgroup.x];
    let level = density_kernel.levels[job.level];
    // The strip's first sample, in the tile and in the terrain.
    let local = vec2(0u, workgroup.y * STRIP * CELL);
    let first = job.tile * u32(TILE_SAMPLES) + local;

    // Where sample 0 of the terrain would lie in the page.
    let origin = page_origin(job.page) + TILE_BORDER - vec2<i32>(job.tile) * TILE_SAMPLES;
    for (var place = lane; place < READ_WIDTH * READ_HEIGHT; place += LANES) {
        let sample = vec2<i32>(first + vec2(place % READ_WIDTH, place / READ_WIDTH)) - 1;
        // What lies further out than a neighbour of the rim is not read.
        let near = min(sample, vec2<i32>(level.samples));
        heights[place] = read_height(job.page, origin, near, vec2<i32>(level.samples));
    }
    if lane < STRIP_TEXELS {
        atomicStore(&largest[lane], 0u);
    }
    workgroupBarrier();

    for (var place = lane; place < WIDTH * HEIGHT; place += LANES) {
        let sample = vec2(place % WIDTH, place / WIDTH);
        if any(first + sample >= level.samples) {
            continue;
        }
        let found = curvature(ring_at(sample.x, sample.y), level.step);
        if !(found > 0.0) {
            continue;
        }
        // Texels share the samples between them: one, two or four take this one.
        // Those beyond the terrain keep nothing.
        let first_texel = first / CELL;
        let ends = max(level.texels, first_texel) - first_texel;
        let room = min(vec2(TEXELS, STRIP), ends);
        if any(room == vec2(0u)) {
            continue;
        }
        let last = min(sample / CELL, room - 1u);
        let before = max((sample + CELL - 1u) / CELL, vec2(1u)) - 1u;
        for (var z = before.y; z <= last.y; z++) {
            for (var x = before.x; x <= last.x; x++) {
                atomicMax(&largest[z * TEXELS + x], bitcast<u32>(found));
            }
        }
    }
    workgroupBarrier();

    if lane < STRIP_TEXELS / 4u {
        var word = 0u;
        for (var byte = 0u; byte < 4u; byte++) {
            let found = bitcast<f32>(atomicLoad(&largest[4u * lane + byte]));
            word |= quantise(found, level.noise) << (8u * byte);
        }
        densities[job.page * DENSITY_PAGE_WORDS + workgroup.y * (STRIP_TEXELS / 4u) + lane] = word;
    }
}
