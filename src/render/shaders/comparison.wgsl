// Two pictures become one.

#import bevy_core_pipeline::fullscreen_vertex_shader::FullscreenVertexOutput
#import bevy_render::color_operations::{
    linear_rgb_to_oklab, linear_rgb_to_srgb, oklab_to_linear_rgb, srgb_to_linear_rgb,
}

struct Comparison {
    // The part of the picture that is compared: its first pixel, and the one beyond its last.
    low: vec2<u32>,
    high: vec2<u32>,
    // Columns of the line between the pictures: its first, and the one beyond its last.
    line: vec2<u32>,
    gain: f32,
    // 0: side by side, 1: the difference.
    mode: u32,
    // What the pictures' numbers are: 0 linear, 1 sRGB, 2 Oklab.
    space: u32,
    unused_a: u32,
    unused_b: u32,
    unused_c: u32,
}

// What stands for no difference. A whole step of eight bits, where one half is none.
const GREY: f32 = 128.0 / 255.0;

@group(0) @binding(0) var<uniform> comparison: Comparison;
@group(0) @binding(1) var own_picture: texture_2d<f32>;
@group(0) @binding(2) var other_picture: texture_2d<f32>;

// As an 8-bit picture would store it, in whole steps: drivers decode sRGB by parts of one, and a gain
// would make those seen.
fn encoded(color: vec3<f32>) -> vec3<f32> {
    var srgb = color;
    if comparison.space == 2u {
        srgb = oklab_to_linear_rgb(srgb);
    }
    if comparison.space != 1u {
        srgb = linear_rgb_to_srgb(srgb);
    }
    return round(255.0 * saturate(srgb)) / 255.0;
}

fn decoded(srgb: vec3<f32>) -> vec3<f32> {
    if comparison.space == 1u {
        return srgb;
    }
    let color = srgb_to_linear_rgb(srgb);
    if comparison.space == 2u {
        return linear_rgb_to_oklab(color);
    }
    return color;
}

@fragment
fn fragment(in: FullscreenVertexOutput) -> @location(0) vec4<f32> {
    let pixel = vec2<u32>(in.position.xy);
    let own = textureLoad(own_picture, pixel, 0);
    if any(pixel < comparison.low) || any(pixel >= comparison.high) {
        return own;
    }
    let other = textureLoad(other_picture, pixel, 0);
    if comparison.mode == 1u {
        let difference = encoded(own.rgb) - encoded(other.rgb);
        return vec4(decoded(saturate(GREY + comparison.gain * difference)), own.a);
    }
    if pixel.x >= comparison.line.x && pixel.x < comparison.line.y {
        let light = f32(2u * pixel.x >= comparison.line.x + comparison.line.y);
        return vec4(decoded(vec3(light)), 1.0);
    }
    if pixel.x < comparison.line.x {
        return own;
    }
    return other;
}
