//! Error over triangles: the crate's policies and what could be had at best.

use crate::bintree::Bintree;
use crate::check;
use crate::delaunay::Greedy;
use crate::ground::{EYES, Eye, Ground, px_per_m};
use crate::measure::{Errors, PlanMesh, errors};
use crate::policy::{Policy, Setup};
use crate::table::{Cell, Table};
use std::path::Path;
use std::time::Instant;

/// Errors that the references go down to, in pixels, the coarsest mesh first.
const REFERENCE_PX: [f64; 11] = [16.0, 12.0, 8.0, 6.0, 4.0, 3.0, 2.0, 1.5, 1.0, 0.75, 0.5];
/// Errors at which methods are compared, in pixels.
const COMPARED_PX: [f64; 4] = [1.0, 2.0, 3.0, 4.0];

/// What made a mesh.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Method {
    Policy(Policy),
    Bintree,
    Greedy,
}

impl Method {
    /// All of them, the crate's own first.
    pub fn all() -> impl Iterator<Item = Self> {
        let policies = Policy::ALL.into_iter().map(Self::Policy);
        policies.chain([Self::Bintree, Self::Greedy])
    }

    pub const fn name(self) -> &'static str {
        match self {
            Self::Policy(policy) => policy.name(),
            Self::Bintree => "bintree",
            Self::Greedy => "greedy Delaunay",
        }
    }

    const fn unit(self) -> &'static str {
        match self {
            Self::Policy(policy) => policy.unit(),
            Self::Bintree | Self::Greedy => "px error",
        }
    }
}

/// One mesh of a curve.
pub struct Step {
    /// The number that the method was given.
    pub step: f64,
    pub vertices: usize,
    pub triangles: usize,
    pub errors: Errors,
}

impl Step {
    pub fn new(step: f64, mesh: &PlanMesh, ground: &Ground, px_per_m: &[f32]) -> Self {
        Self {
            step,
            vertices: mesh.corners.len(),
            triangles: mesh.triangles.len(),
            errors: errors(&ground.samples, px_per_m, mesh),
        }
    }

    /// Vertices, triangles and errors as tables show them.
    pub fn cells(&self) -> [Cell; 5] {
        [
            Cell::Count(self.vertices),
            Cell::Count(self.triangles),
            Cell::Number(self.errors.largest_px, 2),
            Cell::Number(self.errors.most_px, 2),
            Cell::Number(self.errors.rms_px, 3),
        ]
    }
}

pub struct Curve {
    pub method: Method,
    pub steps: Vec<Step>,
}

impl Curve {
    /// Triangles at which 99.9 % of the samples are within `px`, on the straight line between the
    /// two steps around that in a plot with logarithmic axes.
    fn triangles_at(&self, px: f64) -> Option<f64> {
        let mut steps: Vec<&Step> = self.steps.iter().collect();
        steps.sort_by_key(|step| step.triangles);
        steps.windows(2).find_map(|pair| {
            let [coarse, fine] = [pair[0], pair[1]].map(|step| step.errors.most_px);
            (coarse >= px && fine <= px && coarse > fine).then(|| {
                let t = (coarse / px).ln() / (coarse / fine).ln();
                let [from, to] = [pair[0], pair[1]].map(|step| (step.triangles as f64).ln());
                (from + t * (to - from)).exp()
            })
        })
    }
}

fn policy_curve(ground: &Ground, eye: &Eye, px_per_m: &[f32], policy: Policy) -> Curve {
    let steps = policy.steps().iter().map(|&step| {
        let (mesh, _) = policy.setup(step).mesh(ground, eye);
        Step::new(step, &mesh, ground, px_per_m)
    });
    Curve {
        method: Method::Policy(policy),
        steps: steps.collect(),
    }
}

fn greedy_curve(ground: &Ground, px_per_m: &[f32]) -> Curve {
    let mut greedy = Greedy::new(&ground.samples, px_per_m);
    let mut steps = Vec::new();
    for max_px in REFERENCE_PX {
        if !greedy.refine(max_px) {
            println!("greedy Delaunay: too many vertices for {max_px} px, left out");
            break;
        }
        let mesh = greedy.mesh();
        let step = Step::new(max_px, &mesh, ground, px_per_m);
        check::reference(&ground.samples, &mesh, &step);
        steps.push(step);
    }
    let method = Method::Greedy;
    Curve { method, steps }
}

fn bintree_curve(ground: &Ground, px_per_m: &[f32]) -> Curve {
    let tree = Bintree::new(&ground.samples, px_per_m);
    let steps = REFERENCE_PX.map(|max_px| {
        let mesh = tree.mesh(max_px);
        let step = Step::new(max_px, &mesh, ground, px_per_m);
        check::reference(&ground.samples, &mesh, &step);
        step
    });
    Curve {
        method: Method::Bintree,
        steps: steps.into(),
    }
}

/// The curves of all methods for each of the two eyes.
pub fn curves(ground: &Ground, folder: &Path) -> [Vec<Curve>; 2] {
    let curves = EYES.map(|eye| {
        let px_per_m = px_per_m(ground, &eye, Setup::default().focal_px);
        let curve = |method| {
            let start = Instant::now();
            let curve = match method {
                Method::Policy(policy) => policy_curve(ground, &eye, &px_per_m, policy),
                Method::Bintree => bintree_curve(ground, &px_per_m),
                Method::Greedy => greedy_curve(ground, &px_per_m),
            };
            if !matches!(method, Method::Policy(_)) {
                check::falls(&curve);
            }
            eprintln!(
                "{}, {}: {:.1} s",
                eye.name,
                method.name(),
                start.elapsed().as_secs_f64()
            );
            curve
        };
        Method::all().map(curve).collect::<Vec<Curve>>()
    });
    all_table(&curves).finish(folder, "tessellation_errors");
    compared_table(&curves).finish(folder, "tessellation_compared");
    curves
}

fn all_table(curves: &[Vec<Curve>; 2]) -> Table {
    let heads = [
        "view",
        "method",
        "step",
        "unit",
        "vertices",
        "triangles",
        "largest px",
        "99.9 % below px",
        "RMS px",
    ];
    let mut table = Table::new("Error over triangles", &heads);
    for (eye, curves) in EYES.iter().zip(curves) {
        for curve in curves {
            for step in &curve.steps {
                let which = [
                    Cell::from(eye.name),
                    Cell::from(curve.method.name()),
                    Cell::Text(step.step.to_string()),
                    Cell::from(curve.method.unit()),
                ];
                table.row(which.into_iter().chain(step.cells()));
            }
        }
    }
    table
}

fn compared_table(curves: &[Vec<Curve>; 2]) -> Table {
    let heads = [
        "view",
        "method",
        "1 px",
        "2 px",
        "3 px",
        "4 px",
        "of greedy at 1 px",
        "of greedy at 2 px",
        "of greedy at 3 px",
        "of greedy at 4 px",
    ];
    let title = "Triangles at which 99.9 % of the samples are within so many pixels";
    let mut table = Table::new(title, &heads);
    for (eye, curves) in EYES.iter().zip(curves) {
        let at = |curve: &Curve| COMPARED_PX.map(|px| curve.triangles_at(px));
        let greedy = curves
            .iter()
            .find(|curve| curve.method == Method::Greedy)
            .map_or([None; 4], at);
        for curve in curves {
            let own = at(curve);
            let counts = own.map(|count| {
                // Three digits: there is no more in a place between two steps.
                count.map_or(Cell::Nothing, |count| Cell::Count(rounded(count)))
            });
            let times = own.iter().zip(greedy).map(|(own, greedy)| {
                own.zip(greedy)
                    .map_or(Cell::Nothing, |(own, greedy)| Cell::Number(own / greedy, 1))
            });
            let which = [Cell::from(eye.name), Cell::from(curve.method.name())];
            table.row(which.into_iter().chain(counts).chain(times));
        }
    }
    table
}

/// A count to three digits.
fn rounded(count: f64) -> usize {
    let step = 10_f64.powf((count.log10().floor() - 2.0).max(0.0));
    ((count / step).round() * step) as usize
}
