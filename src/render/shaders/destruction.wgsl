#define_import_path bevy_tessera::destruction

// How scorched the ground is: twin of `src/edit/mask/read.rs`, operation for operation. A terrain
// without scorch costs one read of a uniform; where there is some elsewhere, ground without costs
// about one word of the table by which pages are found for each layer that is in use.

#import bevy_tessera::types::{
    MASK_HEADER_WORDS, MASK_LAYER_SHIFT, MASK_MIPS, MASK_PAGE_SHIFT, MASK_PAGE_WORDS, MASK_SLOT_WORDS,
}
#import bevy_tessera::surface::{TerrainSurface, surface_tables, terrain_draw}

// Edit units between two samples of level 0, as a power of two.
const UNITS_SHIFT: u32 = 6u;

// A place in units, whole and the fraction beyond it.
struct MaskPlace {
    whole: vec2<i32>,
    fraction: vec2<f32>,
}

fn mask_place(from_eye_m: vec2<f32>) -> MaskPlace {
    let units = (terrain_draw.eye_sample_fraction + from_eye_m / terrain_draw.spacing_m)
        * f32(1u << UNITS_SHIFT);
    let whole = floor(units);
    return MaskPlace(
        terrain_draw.eye_sample * i32(1u << UNITS_SHIFT) + vec2<i32>(whole),
        units - whole,
    );
}

// Where the texels of a page begin in `surface_tables`; 0 where there is no such page.
fn mask_page(layer: u32, page: vec2<i32>) -> u32 {
    let header = terrain_draw.mask_first;
    let table = header + MASK_HEADER_WORDS;
    let last = surface_tables[header + 1u];
    let pages = surface_tables[header + 2u];
    let place = bitcast<vec2<u32>>(page);
    var mixed = (place.x * 0x9e3779b1u) ^ (place.y * 0x85ebca77u) ^ (layer * 0xc2b2ae3du);
    mixed = (mixed ^ (mixed >> 15u)) * 0x2c1b3c6du;
    mixed ^= mixed >> 12u;
    // The table is half empty, but nothing may keep a shader going forever.
    for (var tried = 0u; tried <= last; tried++) {
        let slot = table + ((mixed + tried) & last) * MASK_SLOT_WORDS;
        let tag = surface_tables[slot];
        if tag == 0u {
            return 0u;
        }
        if (tag >> MASK_LAYER_SHIFT) == layer
            && surface_tables[slot + 1u] == place.x
            && surface_tables[slot + 2u] == place.y
        {
            let number = (tag & ((1u << MASK_LAYER_SHIFT) - 1u)) - 1u;
            let first = table + (last + 1u) * MASK_SLOT_WORDS;
            return select(0u, first + number * MASK_PAGE_WORDS, number < pages);
        }
    }
    return 0u;
}

// A texel of a mip of the page that begins at `first`; 0 without a page.
fn mask_texel(first: u32, mip: u32, texel: vec2<i32>) -> f32 {
    if first == 0u {
        return 0.0;
    }
    let side_shift = MASK_PAGE_SHIFT - mip;
    let inside = vec2<u32>(texel & vec2(i32(1u << side_shift) - 1));
    // The mips before it, each a quarter of the one before.
    let whole = 1u << (2u * MASK_PAGE_SHIFT + 2u);
    let before = (whole - (whole >> (2u * mip))) / 3u;
    let at = before + (inside.y << side_shift) + inside.x;
    let word = surface_tables[first + at / 4u];
    return f32((word >> (8u * (at % 4u))) & 0xffu) / 255.0;
}

// Stands for a page that hasn't been looked up.
const MASK_NOWHERE: u32 = 0xffffffffu;

// One mip of a layer whose texels are `2^layer_shift` units wide, bilinear.
fn mask_mip(layer: u32, layer_shift: u32, mip: u32, place: MaskPlace) -> f32 {
    let shift = layer_shift + mip;
    let inside = vec2<f32>(place.whole & vec2(i32(1u << shift) - 1));
    // Texels have their values in their middles.
    var between = (inside + place.fraction) / f32(1u << shift) - 0.5;
    let before = between < vec2(0.0);
    between += select(vec2(0.0), vec2(1.0), before);
    let texel = (place.whole >> vec2(shift)) - select(vec2(0), vec2(1), before);

    // One place that looks pages up, whatever their number: drivers put every call's code in line.
    let page_shift = vec2(MASK_PAGE_SHIFT - mip);
    var page = texel >> page_shift;
    var first = MASK_NOWHERE;
    var aa = 0.0;
    var ba = 0.0;
    var ab = 0.0;
    var bb = 0.0;
    for (var corner = 0u; corner < 4u; corner++) {
        let at = texel + vec2<i32>(vec2(corner & 1u, corner >> 1u));
        let its_page = at >> page_shift;
        // Few places lie between pages.
        if first == MASK_NOWHERE || any(its_page != page) {
            page = its_page;
            first = mask_page(layer, page);
        }
        let value = mask_texel(first, mip, at);
        aa = select(aa, value, corner == 0u);
        ba = select(ba, value, corner == 1u);
        ab = select(ab, value, corner == 2u);
        bb = select(bb, value, corner == 3u);
    }
    let top = aa + (ba - aa) * between.x;
    let bottom = ab + (bb - ab) * between.x;
    return top + (bottom - top) * between.y;
}

// How scorched the ground is, 0 to 1, at a place relative to the eye (`TerrainSurface::from_eye_m`)
// as a pixel sees it that is `footprint_m` wide on the ground.
fn destruction_mask(from_eye_m: vec2<f32>, footprint_m: f32) -> f32 {
    let header = terrain_draw.mask_first;
    if header == 0u {
        return 0.0;
    }
    let place = mask_place(from_eye_m);
    let footprint = footprint_m * (f32(1u << UNITS_SHIFT) / terrain_draw.spacing_m);
    let finest_shift = surface_tables[header + 3u];
    var layers = surface_tables[header];
    var strength = 0.0;
    while layers != 0u {
        let layer = firstTrailingBit(layers);
        layers &= layers - 1u;
        let shift = finest_shift + layer;
        let wide = footprint / f32(1u << shift);
        let mip = min(log2(max(wide, 1.0)), f32(MASK_MIPS - 1u));
        let fine = u32(floor(mip));
        let blend = mip - f32(fine);
        var here = 0.0;
        let mips = select(1u, 2u, blend > 0.0);
        for (var further = 0u; further < mips; further++) {
            let value = mask_mip(layer, shift, fine + further, place);
            here = select(here + (value - here) * blend, value, further == 0u);
        }
        strength = max(strength, here);
    }
    return strength;
}

// The same for the ground that a material is asked to shade.
fn surface_scorch(surface: TerrainSurface) -> f32 {
    return destruction_mask(surface.from_eye_m, surface.footprint_m);
}

fn grain_corner(cell: vec2<i32>) -> f32 {
    let place = bitcast<vec2<u32>>(cell);
    var mixed = (place.x * 0x9e3779b1u) ^ (place.y * 0x85ebca77u);
    mixed = (mixed ^ (mixed >> 16u)) * 0x7feb352du;
    mixed = (mixed ^ (mixed >> 15u)) * 0x846ca68bu;
    return f32((mixed ^ (mixed >> 16u)) >> 8u) / 16777216.0;
}

// Noise of cells that are `2^shift` units wide, 0 to 1; 0.5 where a pixel is wider than a cell.
fn grain_octave(place: MaskPlace, shift: u32, footprint: f32) -> f32 {
    let size = f32(1u << shift);
    let weight = clamp(2.0 - 2.0 * footprint / size, 0.0, 1.0);
    if weight == 0.0 {
        return 0.5;
    }
    let inside = vec2<f32>(place.whole & vec2(i32(1u << shift) - 1));
    let between = (inside + place.fraction) / size;
    let smoothed = between * between * (3.0 - 2.0 * between);
    let cell = place.whole >> vec2(shift);
    let top = mix(grain_corner(cell), grain_corner(cell + vec2(1, 0)), smoothed.x);
    let bottom = mix(grain_corner(cell + vec2(0, 1)), grain_corner(cell + vec2(1, 1)), smoothed.x);
    return mix(0.5, mix(top, bottom, smoothed.y), weight);
}

// Noise that hides the mask's texels: 0 to 1, 0.5 in the mean and where a pixel can't show it. To be
// asked for only where there is scorch.
fn scorch_grain(surface: TerrainSurface) -> f32 {
    if terrain_draw.mask_first == 0u {
        return 0.5;
    }
    let place = mask_place(surface.from_eye_m);
    let footprint = surface.footprint_m * (f32(1u << UNITS_SHIFT) / terrain_draw.spacing_m);
    let shift = surface_tables[terrain_draw.mask_first + 3u];
    let wide = grain_octave(place, shift + 1u, footprint);
    let middle = grain_octave(place, max(shift, 1u) - 1u, footprint);
    return 0.6 * wide + 0.4 * middle;
}
