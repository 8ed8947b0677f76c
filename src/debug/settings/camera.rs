//! What a camera can be set to.

use crate::debug::form::{Field, Form, Group, Presence};
use crate::lattice::LodSettings;
use crate::terrain::{TerrainCamera, TessellationPolicy};
use crate::tessellate::Partitioning;

/// A camera's settings.
pub(in crate::debug) const CAMERA: Group<TerrainCamera> = Group {
    title: "Camera",
    type_name: "TerrainCamera",
    imports: "{lattice::LodSettings, terrain::{TerrainCamera, TessellationPolicy}, \
              tessellate::Partitioning}",
    presence: Presence::Required,
    is_open: true,
    check,
    list,
};

const PARTITIONINGS: [(Partitioning, &str, &str); 5] = [
    (
        Partitioning::FractionalOdd,
        "fractional odd",
        "Partitioning::FractionalOdd",
    ),
    (
        Partitioning::FractionalEven,
        "fractional even",
        "Partitioning::FractionalEven",
    ),
    (Partitioning::Integer, "integer", "Partitioning::Integer"),
    (
        Partitioning::PowerOfTwo,
        "power of two",
        "Partitioning::PowerOfTwo",
    ),
    (
        Partitioning::PowerOfTwoMorph,
        "power of two, morph",
        "Partitioning::PowerOfTwoMorph",
    ),
];

const FACES: [(u32, &str, &str); 5] = [
    (2, "2", "2"),
    (4, "4", "4"),
    (8, "8", "8"),
    (16, "16", "16"),
    (32, "32", "32"),
];

const MORPHS: [(f32, &str, &str); 7] = [
    (0.0625, "1/16", "0.0625"),
    (0.125, "1/8", "0.125"),
    (0.25, "1/4", "0.25"),
    (0.5, "1/2", "0.5"),
    (1.0, "1", "1.0"),
    (2.0, "2", "2.0"),
    (4.0, "4", "4.0"),
];

/// The error with which the other policy begins, in pixels.
const FIRST_ERROR_PX: f32 = 1.0;

fn check(camera: &TerrainCamera) -> Option<String> {
    let mut first = None;
    let _ = camera.checked(|error| {
        first.get_or_insert_with(|| error.to_string());
    });
    first
}

/// Goes through a camera's settings; a comparison has those of a second one.
pub(in crate::debug) fn list(form: &mut Form, camera: &mut TerrainCamera, default: &TerrainCamera) {
    let differs = camera.lod != default.lod;
    form.nested("lod", "LodSettings", differs, |form| {
        lod(form, &mut camera.lod, &default.lod);
    });
    form.choice(
        Field::new(
            "faces per side",
            "faces_per_side",
            "Control faces along a node's side. More follow the density map more closely; they cost \
             GPU time whether or not they are cut up.",
        ),
        &FACES,
        &mut camera.faces_per_side,
        default.faces_per_side,
    );
    policy(form, &mut camera.policy, default.policy);
    form.number(
        Field::new(
            "triangle width",
            "triangle_width_px",
            "Wanted length of a triangle's edge on the screen where the ground is roughest. \
             Triangles grow with the inverse square of it.",
        )
        .unit("px"),
        TerrainCamera::TRIANGLE_WIDTH_RANGE,
        &mut camera.triangle_width_px,
        default.triangle_width_px,
    );
    form.number(
        Field::new(
            "max factor",
            "max_factor",
            "The most segments that an edge of a control face is cut into. With 1 nothing is \
             tessellated.",
        ),
        TerrainCamera::MAX_FACTOR_RANGE,
        &mut camera.max_factor,
        default.max_factor,
    );
    form.optional(
        Field::new(
            "min triangle",
            "min_triangle_m",
            "Edges are not cut shorter than this, along the ground. Off, it is the spacing of the \
             finest samples.",
        )
        .unit("m"),
        TerrainCamera::MIN_TRIANGLE_RANGE,
        &mut camera.min_triangle_m,
        1.0,
    );
    form.number(
        Field::new(
            "density",
            "density",
            "How far the density map counts: 0 makes triangles of one size everywhere, 1 leaves \
             plain ground coarse.",
        ),
        TerrainCamera::DENSITY_RANGE,
        &mut camera.density,
        default.density,
    );
    form.choice(
        Field::new(
            "partitioning",
            "partitioning",
            "How real edge factors become whole segments.",
        ),
        &PARTITIONINGS,
        &mut camera.partitioning,
        default.partitioning,
    );
    form.number(
        Field::new(
            "max vertices",
            "max_vertices",
            "The most vertices of this camera's view, 40 bytes of GPU memory each. Where it wants \
             more, all factors are lowered together.",
        ),
        TerrainCamera::MAX_VERTICES_RANGE,
        &mut camera.max_vertices,
        default.max_vertices,
    );
}

fn lod(form: &mut Form, lod: &mut LodSettings, default: &LodSettings) {
    // What `LodSettings::validate` asks of the two together.
    let least = (2.0 + 2.0 * lod.morph).max(*LodSettings::REACH_RANGE.start());
    let longest = 0.5 * lod.reach - 1.0;
    form.number(
        Field::new(
            "LOD reach",
            "reach",
            "How far a level of detail reaches, in node sizes of that level; at least 2 and twice \
             the morph zone. Memory and triangles grow with the square of it.",
        )
        .unit("nodes"),
        least..=*LodSettings::REACH_RANGE.end(),
        &mut lod.reach,
        default.reach,
    );
    let possible = MORPHS
        .iter()
        .filter(|(morph, ..)| *morph <= longest || *morph == lod.morph)
        .count();
    form.choice(
        Field::new(
            "LOD morph",
            "morph",
            "Length of the zone in which a level turns into the next one, in node sizes; at most \
             (reach - 2) / 2.",
        )
        .unit("nodes"),
        &MORPHS[..possible.max(1)],
        &mut lod.morph,
        default.morph,
    );
}

fn policy(form: &mut Form, policy: &mut TessellationPolicy, default: TessellationPolicy) {
    form.code("policy", *policy != default, || match *policy {
        TessellationPolicy::TriangleWidth => "TessellationPolicy::TriangleWidth".to_owned(),
        TessellationPolicy::ScreenError { max_px } => format!(
            "TessellationPolicy::ScreenError {{ max_px: {} }}",
            crate::debug::form::code_of_f32(max_px)
        ),
    });
    if form.is_writing() {
        return;
    }
    let mut by_error = matches!(policy, TessellationPolicy::ScreenError { .. });
    let was = by_error;
    form.choice(
        Field::new(
            "policy",
            "",
            "What decides how finely the ground is cut: triangles of a width, or as few as keep an \
             error.",
        ),
        &[(false, "triangle width", ""), (true, "screen error", "")],
        &mut by_error,
        matches!(default, TessellationPolicy::ScreenError { .. }),
    );
    if by_error != was {
        *policy = if by_error {
            TessellationPolicy::ScreenError {
                max_px: FIRST_ERROR_PX,
            }
        } else {
            TessellationPolicy::TriangleWidth
        };
    }
    if let TessellationPolicy::ScreenError { max_px } = policy {
        let default = match default {
            TessellationPolicy::ScreenError { max_px } => max_px,
            TessellationPolicy::TriangleWidth => FIRST_ERROR_PX,
        };
        form.number(
            Field::new(
                "max error",
                "",
                "The most that a height that is drawn may be off, as seen on the screen.",
            )
            .unit("px"),
            TessellationPolicy::MAX_PX_RANGE,
            max_px,
            default,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_are_what_the_settings_accept() {
        assert_eq!(
            FACES.map(|(faces, ..)| faces),
            TerrainCamera::FACES_PER_SIDE
        );
        assert_eq!(MORPHS.map(|(morph, ..)| morph), LodSettings::MORPHS);
        let listed = PARTITIONINGS.map(|(partitioning, ..)| partitioning);
        assert_eq!(listed, Partitioning::ALL);
        for (partitioning, _, code) in PARTITIONINGS {
            assert_eq!(code, format!("Partitioning::{partitioning:?}"));
        }
        for (morph, _, code) in MORPHS {
            assert_eq!(code, format!("{morph:?}"));
        }
    }
}
