//! What decides how finely ground is cut, and the meshes of the CPU twin that follow.

use crate::ground::{Eye, Ground};
use crate::measure::{Corner, PlanMesh};
use bevy_tessera::lattice::{Lattice, LodSettings, Node, ResidencyField, ViewLod};
use bevy_tessera::tessellate::{FactorView, Pages, Partitioning, TerrainMesh, ViewMesh};

/// Every number that a view's mesh follows from, besides eye and ground.
#[derive(Clone, Copy)]
pub struct Setup {
    pub reach: f32,
    pub leaf_level: i32,
    pub faces_per_side: u32,
    pub triangle_width_px: f64,
    pub density_strength: f32,
    pub max_factor: f32,
    pub partitioning: Partitioning,
    /// No edge is cut into shorter segments; the distance of two samples unless set.
    pub min_triangle_m: Option<f64>,
    pub focal_px: f64,
    /// The error that may be left, in pixels; 0 where widths decide.
    pub max_error_px: f64,
}

/// A picture 1200 pixels high, as both references have it, with Bevy's 45 degrees.
pub const PICTURE_HEIGHT_PX: f64 = 1200.0;
pub const VIEW_ANGLE_DEG: f64 = 45.0;

impl Default for Setup {
    /// The setup of the tables that ask for nothing else, without a density map.
    fn default() -> Self {
        Self {
            reach: 4.0,
            leaf_level: -2,
            faces_per_side: 8,
            triangle_width_px: 6.0,
            density_strength: 0.0,
            max_factor: 64.0,
            partitioning: Partitioning::FractionalOdd,
            min_triangle_m: None,
            focal_px: crate::ground::focal_px(PICTURE_HEIGHT_PX, VIEW_ANGLE_DEG),
            max_error_px: 0.0,
        }
    }
}

impl Setup {
    /// Calls `then` with everything that the mesh of `eye` is built from, and with its nodes.
    pub fn view<R>(
        &self,
        ground: &Ground,
        eye: &Eye,
        then: impl FnOnce(&ViewMesh<Pages>, &[Node]) -> R,
    ) -> R {
        let file = &ground.manifest.file;
        let lattice = Lattice::new(file.size, file.levels, self.leaf_level, self.faces_per_side)
            .unwrap_or_else(|error| panic!("{error}"));
        let unit_m = lattice.unit_m(file.spacing_m);
        let (point, fraction) = lattice.lattice_from_local(eye.place_m, file.spacing_m);
        let settings = LodSettings {
            reach: self.reach,
            ..Default::default()
        };
        let floor = (eye.above_m / unit_m) as i32;
        let lod = ViewLod::new(&lattice, &settings, point, floor, true)
            .unwrap_or_else(|error| panic!("{error}"));
        let field = ResidencyField::new(&lattice, 0);
        let factor_view = FactorView {
            eye: point,
            eye_fraction: fraction,
            eye_height_m: eye.height_m(ground) as f32,
            unit_m: unit_m as f32,
            segments_per_radian: (self.focal_px / self.triangle_width_px) as f32,
            segments_per_m: 0.0,
            min_triangle_m: self.min_triangle_m.unwrap_or(file.spacing_m) as f32,
            max_factor: self.max_factor,
            density_strength: self.density_strength,
            focal_px: self.focal_px as f32,
            px_per_m: 0.0,
            max_error_px: self.max_error_px as f32,
            error_units_per_m: file.error_units_per_m() as f32,
        };
        let mut nodes: Vec<Node> = Vec::new();
        lod.select(&lattice, &mut |_, _| true, &mut |node| nodes.push(node));
        let view = ViewMesh {
            lattice: &lattice,
            lod: &lod,
            field: &field,
            factor_view: &factor_view,
            partitioning: self.partitioning,
            pages: &ground.pages,
            height_min_m: file.height_min_m as f32,
            height_step_m: file.height_step_m as f32,
            max_vertices: u32::MAX,
            max_triangles: u32::MAX,
            culling: None,
            detail: None,
        };
        then(&view, &nodes)
    }

    /// The mesh all around `eye`, and the number of its nodes.
    pub fn mesh(&self, ground: &Ground, eye: &Eye) -> (PlanMesh, usize) {
        self.view(ground, eye, |view, nodes| {
            let mesh = view.build(nodes);
            (plan_mesh(&mesh, view.lattice), nodes.len())
        })
    }
}

fn plan_mesh(mesh: &TerrainMesh, lattice: &Lattice) -> PlanMesh {
    let units = f64::from(1_u32 << lattice.unit_log2);
    PlanMesh {
        corners: mesh
            .vertices
            .iter()
            .map(|vertex| Corner {
                plan: vertex.point.as_dvec2() / units,
                height_m: vertex.height_m.into(),
            })
            .collect(),
        triangles: mesh.triangles.clone(),
    }
}

/// A way of the crate to decide how finely ground is cut, with one number that makes it finer or
/// coarser.
///
/// **A further policy is one more variant here** (the error on the screen, by `max_px`, say): its
/// name, its steps and its [`Setup`] below, and a colour in `plot`. Tables, files and plot follow.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Policy {
    /// Triangles of one width in pixels (Cantlay 2011).
    Uniform,
    /// The same with an even number of segments an edge, which can come to lie on samples.
    UniformEven,
    /// That width scaled by the density map (Cervin 2012).
    Density,
    /// As few as keep the error below a bound.
    ScreenError,
    /// The same with an even number of segments.
    ScreenErrorEven,
    /// No tessellation: a node's faces as they are, more or fewer by the levels' reach.
    Cdlod,
}

impl Policy {
    pub const ALL: [Self; 6] = [
        Self::Uniform,
        Self::UniformEven,
        Self::Density,
        Self::ScreenError,
        Self::ScreenErrorEven,
        Self::Cdlod,
    ];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::UniformEven => "uniform, even",
            Self::Density => "density map",
            Self::ScreenError => "screen error",
            Self::ScreenErrorEven => "screen error, even",
            Self::Cdlod => "CDLOD",
        }
    }

    /// What the number of a step is.
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Uniform | Self::UniformEven | Self::Density => "px wide",
            Self::ScreenError | Self::ScreenErrorEven => "px allowed",
            Self::Cdlod => "reach",
        }
    }

    /// Numbers to draw a curve through, the finest mesh first.
    pub const fn steps(self) -> &'static [f64] {
        match self {
            // Beyond 12 pixels nobody would play, but the curves go on to where others begin.
            Self::Uniform | Self::UniformEven => {
                &[1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0]
            }
            Self::ScreenError | Self::ScreenErrorEven => {
                &[1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0]
            }
            Self::Density => &[1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0],
            Self::Cdlod => &[32.0, 24.0, 16.0, 12.0, 8.0, 6.0, 4.0],
        }
    }

    pub fn setup(self, step: f64) -> Setup {
        let default = Setup::default();
        match self {
            Self::Uniform => Setup {
                triangle_width_px: step,
                ..default
            },
            Self::UniformEven => Setup {
                triangle_width_px: step,
                partitioning: Partitioning::FractionalEven,
                ..default
            },
            Self::Density => Setup {
                triangle_width_px: step,
                density_strength: 1.0,
                ..default
            },
            Self::ScreenError => Setup {
                max_error_px: step,
                min_triangle_m: Some(f64::from(f32::MIN_POSITIVE)),
                faces_per_side: 4,
                ..default
            },
            Self::ScreenErrorEven => Setup {
                partitioning: Partitioning::FractionalEven,
                ..Self::ScreenError.setup(step)
            },
            Self::Cdlod => Setup {
                reach: step as f32,
                max_factor: 1.0,
                // Faces have to become as small as samples by themselves.
                leaf_level: -4,
                ..default
            },
        }
    }
}
