#define_import_path bevy_tessera::curvature

// Twin of `src/density/curvature.rs`, which has the equations: the same functions, operation for
// operation. Quotients, roots and fused multiplications may be rounded otherwise here.

// Heights of a sample and its neighbours: x grows to the east, z to the south.
struct Ring {
    north_west: f32,
    north: f32,
    north_east: f32,
    west: f32,
    centre: f32,
    east: f32,
    south_west: f32,
    south: f32,
    south_east: f32,
}

// First and second derivatives in sample spacings.
struct Derivatives {
    x: f32,
    z: f32,
    xx: f32,
    zz: f32,
    xz: f32,
}

fn derivatives(ring: Ring, unit: f32) -> Derivatives {
    let half = unit * 0.5;
    let quarter = unit * 0.25;
    let twice = ring.centre + ring.centre;
    return Derivatives(
        (ring.east - ring.west) * half,
        (ring.south - ring.north) * half,
        (ring.east + ring.west - twice) * unit,
        (ring.south + ring.north - twice) * unit,
        ((ring.south_east + ring.north_west) - (ring.south_west + ring.north_east)) * quarter,
    );
}

// 1 + h_x^2 + h_z^2.
fn derivatives_square(d: Derivatives) -> f32 {
    return 1.0 + (d.x * d.x + d.z * d.z);
}

fn derivatives_mean(d: Derivatives, square: f32) -> f32 {
    let x_square = d.x * d.x;
    let z_square = d.z * d.z;
    let cross_term = d.xz * (d.x * d.z);
    let trace = (d.xx * (1.0 + z_square) + d.zz * (1.0 + x_square)) - (cross_term + cross_term);
    return trace / ((square + square) * sqrt(square));
}

fn derivatives_gaussian(d: Derivatives, square: f32) -> f32 {
    return (d.xx * d.zz - d.xz * d.xz) / (square * square);
}

// The sum of the second differences, equation 2.19.
fn second_order(ring: Ring, unit: f32) -> f32 {
    let twice = ring.centre + ring.centre;
    return ((ring.east + ring.west - twice) + (ring.south + ring.north - twice)) * unit;
}

// Gaussian curvature, equation 2.27.
fn gaussian(ring: Ring, unit: f32) -> f32 {
    let d = derivatives(ring, unit);
    return derivatives_gaussian(d, derivatives_square(d));
}

// Mean curvature, equation 2.26.
fn mean(ring: Ring, unit: f32) -> f32 {
    let d = derivatives(ring, unit);
    return derivatives_mean(d, derivatives_square(d));
}

// The magnitude of the larger principal curvature, from equation 2.34.
fn principal(ring: Ring, unit: f32) -> f32 {
    let d = derivatives(ring, unit);
    let square = derivatives_square(d);
    let mean = derivatives_mean(d, square);
    let below = max(mean * mean - derivatives_gaussian(d, square), 0.0);
    return abs(mean) + sqrt(below);
}

// A triangle of the ring: the sample and two of its neighbours, a and b.
struct Triangle {
    // Cotangents of the angles at a and b.
    cot_a: f32,
    cot_b: f32,
    // Twice the triangle's area, or eight times the part of it that belongs to the sample.
    area: f32,
}

// `flat_parts`: the horizontal parts of the products a.a, b.b and a.b of the edges to a and b, which
// lie `a` and `b` above the sample.
fn triangle(
    mixed: bool,
    flat_parts: vec3<f32>,
    a: f32,
    b: f32,
    slope_x: f32,
    slope_z: f32,
) -> Triangle {
    let aa = flat_parts.x + a * a;
    let bb = flat_parts.y + b * b;
    let ab = flat_parts.z + a * b;
    let double_area = sqrt(1.0 + (slope_x * slope_x + slope_z * slope_z));
    let inverse = 1.0 / double_area;
    let cot_a = (aa - ab) * inverse;
    let cot_b = (bb - ab) * inverse;
    var area = double_area;
    if mixed {
        // The sample's Voronoi cell; half of a triangle that is obtuse there, a quarter of one that
        // is obtuse elsewhere.
        if ab < 0.0 {
            area = double_area + double_area;
        } else if cot_a >= 0.0 && cot_b >= 0.0 {
            area = aa * cot_b + bb * cot_a;
        }
    }
    return Triangle(cot_a, cot_b, area);
}

// Length of the sum of (cot a + cot b)(v_j - v) over the ring (x), and the sum of the triangles'
// areas (y).
fn cotangent_sum(mixed: bool, ring: Ring, unit: f32) -> vec2<f32> {
    let centre = ring.centre;
    let e = (ring.east - centre) * unit;
    let se = (ring.south_east - centre) * unit;
    let s = (ring.south - centre) * unit;
    let w = (ring.west - centre) * unit;
    let nw = (ring.north_west - centre) * unit;
    let n = (ring.north - centre) * unit;
    let ese = triangle(mixed, vec3(1.0, 2.0, 1.0), e, se, e, se - e);
    let ses = triangle(mixed, vec3(2.0, 1.0, 1.0), se, s, se - s, s);
    let sw = triangle(mixed, vec3(1.0, 1.0, 0.0), s, w, w, s);
    let wnw = triangle(mixed, vec3(1.0, 2.0, 1.0), w, nw, w, nw - w);
    let nwn = triangle(mixed, vec3(2.0, 1.0, 1.0), nw, n, nw - n, n);
    let ne = triangle(mixed, vec3(1.0, 1.0, 0.0), n, e, e, n);
    // An edge's two cotangents lie opposite it, in the triangles to its sides.
    let to_e = ne.cot_a + ese.cot_b;
    let to_se = ese.cot_a + ses.cot_b;
    let to_s = ses.cot_a + sw.cot_b;
    let to_w = sw.cot_a + wnw.cot_b;
    let to_nw = wnw.cot_a + nwn.cot_b;
    let to_n = nwn.cot_a + ne.cot_b;
    let x = (to_e - to_w) + (to_se - to_nw);
    let z = (to_s - to_n) + (to_se - to_nw);
    let y = ((to_e * e + to_w * w) + (to_s * s + to_n * n)) + (to_se * se + to_nw * nw);
    let area = ((ese.area + ses.area) + (sw.area + wnw.area)) + (nwn.area + ne.area);
    return vec2(sqrt(y * y + (x * x + z * z)), area);
}

// Mean curvature by the Laplace-Beltrami operator, equation 2.30 put right.
fn laplace_beltrami(ring: Ring, unit: f32) -> f32 {
    let found = cotangent_sum(false, ring, unit);
    return 1.5 * found.x / found.y;
}

// The same over the mixed Voronoi area, equations 2.31 and 2.32 put right.
fn laplace_beltrami_voronoi(ring: Ring, unit: f32) -> f32 {
    let found = cotangent_sum(true, ring, unit);
    return (found.x + found.x) / found.y;
}
