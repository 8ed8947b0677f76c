//! What a terrain can be set to.

use crate::debug::form::{Field, Form, Group, Presence};
use crate::density::{DensityBorder, DensityFilter, DensitySettings};
use crate::detail::{DetailRule, TerrainDetail};
use crate::edit::mask::MaskSettings;
use crate::render::TerrainDensityPreview;
use crate::terrain::TerrainSettings;

/// How a terrain is cut up.
pub(super) const TERRAIN: Group<TerrainSettings> = Group {
    title: "Terrain",
    type_name: "TerrainSettings",
    imports: "terrain::TerrainSettings",
    presence: Presence::Required,
    is_open: true,
    check: check_terrain,
    list: list_terrain,
};

/// Displacement finer than the samples.
pub(super) const DETAIL: Group<TerrainDetail> = Group {
    title: "Detail",
    type_name: "TerrainDetail",
    imports: "detail::{DetailRule, TerrainDetail}",
    presence: Presence::Switch("detail finer than the samples"),
    is_open: false,
    check: |detail| detail.validate().err().map(|error| error.to_string()),
    list: list_detail,
};

/// Densities of other settings, shown.
pub(super) const PREVIEW: Group<TerrainDensityPreview> = Group {
    title: "Density preview",
    type_name: "TerrainDensityPreview",
    imports: "{density::{DensityBorder, DensityFilter, DensitySettings}, \
              render::TerrainDensityPreview}",
    presence: Presence::Switch("show densities"),
    is_open: false,
    check: |preview| {
        preview
            .settings
            .validate()
            .err()
            .map(|error| error.to_string())
    },
    list: list_preview,
};

/// The destruction mask.
pub(super) const MASK: Group<MaskSettings> = Group {
    title: "Destruction mask",
    type_name: "MaskSettings",
    imports: "edit::mask::MaskSettings",
    presence: Presence::Default,
    is_open: false,
    check: |_| None,
    list: list_mask,
};

fn check_terrain(settings: &TerrainSettings) -> Option<String> {
    let mut first = None;
    let _ = settings.checked(|error| {
        first.get_or_insert_with(|| error.to_string());
    });
    first
}

fn list_terrain(form: &mut Form, settings: &mut TerrainSettings, default: &TerrainSettings) {
    form.number(
        Field::new(
            "leaf level",
            "leaf_level",
            "Finest level of the geometry: 0 stands for nodes as large as the finest tiles, -1 for \
             half of that, and so on. Read once, when the manifest has loaded.",
        ),
        TerrainSettings::LEAF_LEVEL_RANGE,
        &mut settings.leaf_level,
        default.leaf_level,
    );
    form.note("      leaf level: counts when the terrain is spawned next");
    form.number(
        Field::new(
            "root levels",
            "root_levels",
            "How many of the coarsest levels are always resident as a whole, wherever the eyes are.",
        ),
        TerrainSettings::ROOT_LEVELS_RANGE,
        &mut settings.root_levels,
        default.root_levels,
    );
    form.number(
        Field::new(
            "fade, levels",
            "fade_levels_per_s",
            "How fast detail appears and disappears at most when tiles come and go in view.",
        )
        .unit("levels/s"),
        TerrainSettings::FADE_RANGE,
        &mut settings.fade_levels_per_s,
        default.fade_levels_per_s,
    );
    form.number(
        Field::new(
            "fade, pixels",
            "fade_px_per_s",
            "How fast the ground moves on the screen at most while detail appears and disappears.",
        )
        .unit("px/s"),
        TerrainSettings::FADE_RANGE,
        &mut settings.fade_px_per_s,
        default.fade_px_per_s,
    );
}

fn list_detail(form: &mut Form, detail: &mut TerrainDetail, default: &TerrainDetail) {
    form.number(
        Field::new(
            "amplitude",
            "amplitude_m",
            "The most that all octaves together raise or lower the ground; 0 turns detail off.",
        )
        .unit("m"),
        TerrainDetail::AMPLITUDE_RANGE,
        &mut detail.amplitude_m,
        default.amplitude_m,
    );
    form.number(
        Field::new(
            "wavelength",
            "wavelength_m",
            "Wavelength of the coarsest octave; each further one has half of it.",
        )
        .unit("m"),
        TerrainDetail::WAVELENGTH_RANGE,
        &mut detail.wavelength_m,
        default.wavelength_m,
    );
    form.number(
        Field::new("octaves", "octaves", "How many octaves there are."),
        TerrainDetail::OCTAVES_RANGE,
        &mut detail.octaves,
        default.octaves,
    );
    form.number(
        Field::new(
            "octave gain",
            "gain",
            "Amplitude of an octave over that of the next coarser one: 0.5 makes rock, less softer \
             ground, more rubble.",
        ),
        TerrainDetail::GAIN_RANGE,
        &mut detail.gain,
        default.gain,
    );
    form.number(
        Field::new(
            "seed",
            "seed",
            "Which of the noises that are alike in all of this.",
        ),
        0..=u32::MAX,
        &mut detail.seed,
        default.seed,
    );
    rule(form, &mut detail.rule, default.rule);
}

#[derive(Clone, Copy, PartialEq)]
enum RuleKind {
    Everywhere,
    Slope,
    Height,
    InverseHeight,
}

const RULES: [(RuleKind, &str, &str); 4] = [
    (RuleKind::Everywhere, "everywhere", ""),
    (RuleKind::Slope, "by slope", ""),
    (RuleKind::Height, "by height", ""),
    (RuleKind::InverseHeight, "by inverse height", ""),
];

const fn kind(rule: DetailRule) -> RuleKind {
    match rule {
        DetailRule::Everywhere => RuleKind::Everywhere,
        DetailRule::Slope { .. } => RuleKind::Slope,
        DetailRule::Height { .. } => RuleKind::Height,
        DetailRule::InverseHeight { .. } => RuleKind::InverseHeight,
    }
}

/// What a rule begins with when it is chosen.
const fn first_rule(kind: RuleKind) -> DetailRule {
    match kind {
        RuleKind::Everywhere => DetailRule::Everywhere,
        RuleKind::Slope => DetailRule::Slope {
            from_deg: 15.0,
            to_deg: 40.0,
        },
        RuleKind::Height => DetailRule::Height {
            from_m: 0.0,
            to_m: 500.0,
        },
        RuleKind::InverseHeight => DetailRule::InverseHeight {
            full_m: 100.0,
            none_m: 500.0,
        },
    }
}

fn rule(form: &mut Form, rule: &mut DetailRule, default: DetailRule) {
    form.code("rule", *rule != default, || {
        // Its derived text is Rust but for the type.
        format!("DetailRule::{rule:?}")
            .replace("NaN", "f32::NAN")
            .replace("inf", "f32::INFINITY")
    });
    if form.is_writing() {
        return;
    }
    let mut chosen = kind(*rule);
    form.choice(
        Field::new(
            "rule",
            "",
            "How much of the detail the ground gets, by its stored shape.",
        ),
        &RULES,
        &mut chosen,
        kind(default),
    );
    if chosen != kind(*rule) {
        *rule = first_rule(chosen);
    }
    let mut end = |label, hover, unit, range, value: &mut f32, default| {
        form.number(
            Field::new(label, "", hover).unit(unit),
            range,
            value,
            default,
        );
    };
    let angles = DetailRule::ANGLE_RANGE;
    let heights = DetailRule::HEIGHT_RANGE;
    match (rule, first_rule(chosen)) {
        (
            DetailRule::Slope { from_deg, to_deg },
            DetailRule::Slope {
                from_deg: from,
                to_deg: to,
            },
        ) => {
            end(
                "from slope",
                "None up to this angle.",
                "°",
                angles.clone(),
                from_deg,
                from,
            );
            end(
                "to slope",
                "All of it from this angle on.",
                "°",
                angles,
                to_deg,
                to,
            );
        }
        (
            DetailRule::Height { from_m, to_m },
            DetailRule::Height {
                from_m: from,
                to_m: to,
            },
        ) => {
            end(
                "from height",
                "None up to this height.",
                "m",
                heights.clone(),
                from_m,
                from,
            );
            end(
                "to height",
                "All of it from this height on.",
                "m",
                heights,
                to_m,
                to,
            );
        }
        (
            DetailRule::InverseHeight { full_m, none_m },
            DetailRule::InverseHeight {
                full_m: full,
                none_m: none,
            },
        ) => {
            end(
                "full height",
                "All of it up to this height.",
                "m",
                heights.clone(),
                full_m,
                full,
            );
            end(
                "none height",
                "None from this height on.",
                "m",
                heights,
                none_m,
                none,
            );
        }
        _ => {}
    }
}

const FILTERS: [(DensityFilter, &str, &str); 6] = [
    (
        DensityFilter::SecondOrder,
        "second order",
        "DensityFilter::SecondOrder",
    ),
    (
        DensityFilter::Gaussian,
        "Gaussian",
        "DensityFilter::Gaussian",
    ),
    (DensityFilter::Mean, "mean", "DensityFilter::Mean"),
    (
        DensityFilter::LaplaceBeltrami,
        "Laplace-Beltrami",
        "DensityFilter::LaplaceBeltrami",
    ),
    (
        DensityFilter::LaplaceBeltramiVoronoi,
        "the same, Voronoi",
        "DensityFilter::LaplaceBeltramiVoronoi",
    ),
    (
        DensityFilter::Principal,
        "principal",
        "DensityFilter::Principal",
    ),
];

const BORDERS: [(DensityBorder, &str, &str); 2] = [
    (DensityBorder::None, "none", "DensityBorder::None"),
    (
        DensityBorder::PointSampled,
        "point-sampled",
        "DensityBorder::PointSampled",
    ),
];

fn list_preview(
    form: &mut Form,
    preview: &mut TerrainDensityPreview,
    default: &TerrainDensityPreview,
) {
    form.number(
        Field::new(
            "preview opacity",
            "opacity",
            "How much of the ground's colour is covered.",
        ),
        TerrainDensityPreview::OPACITY_RANGE,
        &mut preview.opacity,
        default.opacity,
    );
    let differs = preview.settings != default.settings;
    form.nested("settings", "DensitySettings", differs, |form| {
        list_density(form, &mut preview.settings, &default.settings);
    });
}

fn list_density(form: &mut Form, settings: &mut DensitySettings, default: &DensitySettings) {
    form.choice(
        Field::new("filter", "filter", "The estimate of curvature."),
        &FILTERS,
        &mut settings.filter,
        default.filter,
    );
    form.number(
        Field::new(
            "curvature gain",
            "gain",
            "Scale of curvature before it is clamped to 0..1.",
        ),
        DensitySettings::GAIN_RANGE,
        &mut settings.gain,
        default.gain,
    );
    form.number(
        Field::new(
            "exponent",
            "exponent",
            "Exponent of the clamped curvature: a high one keeps triangles for the sharpest crests.",
        ),
        DensitySettings::EXPONENT_RANGE,
        &mut settings.exponent,
        default.exponent,
    );
    form.note("      These count when densities are baked, not in the preview:");
    form.toggle(
        Field::new(
            "preprocess",
            "preprocess",
            "Whether densities spread to their surroundings before the coarser levels are made.",
        ),
        &mut settings.preprocess,
        default.preprocess,
    );
    form.number(
        Field::new(
            "filter size",
            "filter_size",
            "Side of the square whose largest density a texel takes.",
        )
        .unit("texels"),
        DensitySettings::FILTER_SIZE_RANGE,
        &mut settings.filter_size,
        default.filter_size,
    );
    form.choice(
        Field::new(
            "border",
            "border",
            "How the texels along tiles' borders come about in the coarser levels.",
        ),
        &BORDERS,
        &mut settings.border,
        default.border,
    );
    form.number(
        Field::new(
            "LOD skip",
            "lod_skip",
            "With point-sampled borders, the level at which they are about right.",
        )
        .unit("levels"),
        DensitySettings::LOD_SKIP_RANGE,
        &mut settings.lod_skip,
        default.lod_skip,
    );
}

fn list_mask(form: &mut Form, settings: &mut MaskSettings, default: &MaskSettings) {
    form.number(
        Field::new(
            "texels per metre",
            "texels_per_m",
            "Texels of scorch per metre of ground, at the least. Another number draws all edits \
             anew.",
        )
        .unit("/m")
        .slow(),
        MaskSettings::TEXELS_PER_M_RANGE,
        &mut settings.texels_per_m,
        default.texels_per_m,
    );
    form.number(
        Field::new(
            "mask memory",
            "max_bytes",
            "What the mask's pages may take, on the CPU and on the GPU each. Another number draws \
             all edits anew.",
        )
        .mib()
        .slow(),
        0..=u64::MAX,
        &mut settings.max_bytes,
        default.max_bytes,
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_are_what_the_settings_accept() {
        assert_eq!(FILTERS.map(|(filter, ..)| filter), DensityFilter::ALL);
        assert_eq!(BORDERS.map(|(border, ..)| border), DensityBorder::ALL);
        for (filter, _, code) in FILTERS {
            assert_eq!(code, format!("DensityFilter::{filter:?}"));
        }
        for (border, _, code) in BORDERS {
            assert_eq!(code, format!("DensityBorder::{border:?}"));
        }
        for (chosen, ..) in RULES {
            assert!(kind(first_rule(chosen)) == chosen);
            assert_eq!(first_rule(chosen).validate(), Ok(()));
        }
    }
}
