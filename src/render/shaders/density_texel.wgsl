#define_import_path bevy_tessera::density_texel

// Where densities lie that are stored four a word; shared by all that show them.

#import bevy_tessera::surface::SurfacePage

// Column and row of the texel of a page that a place lies in.
fn density_texel(found: SurfacePage) -> vec2<u32> {
    return vec2<u32>(clamp(vec2<i32>(floor(found.local / 4.0)), vec2(0), vec2(31)));
}

// Density `index % 4` of a word, 0 to 1.
fn unpacked_density(word: u32, index: u32) -> f32 {
    return f32((word >> (8u * (index % 4u))) & 0xffu) / 255.0;
}
