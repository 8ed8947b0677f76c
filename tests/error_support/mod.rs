//! Grounds, triangles and their exact errors, for the tests of error bounds.

/// Numbers that look random, the same on every machine.
pub struct Random(pub u64);

impl Random {
    /// Evenly from 0 to 1.
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }
}

/// A level's ground: the bilinear surface through stored heights.
pub struct Ground {
    pub size: [u32; 2],
    pub heights: Vec<u16>,
}

pub type Point = [f64; 2];
pub type Triangle = [Point; 3];

impl Ground {
    pub fn new(size: [u32; 2], mut height: impl FnMut(f64, f64) -> f64) -> Self {
        let samples = (0..size[1]).flat_map(|z| (0..size[0]).map(move |x| (x, z)));
        let heights = samples
            .map(|(x, z)| height(x.into(), z.into()).clamp(0.0, 65535.0).round() as u16)
            .collect();
        Self { size, heights }
    }

    pub fn row(&self, z: u32) -> &[u16] {
        let width = self.size[0] as usize;
        &self.heights[z as usize * width..][..width]
    }

    pub fn sample(&self, x: i64, z: i64) -> f64 {
        let at = |at: i64, axis: usize| at.clamp(0, i64::from(self.size[axis]) - 1) as u32;
        f64::from(self.row(at(z, 1))[at(x, 0) as usize])
    }

    pub fn at(&self, [x, z]: Point) -> f64 {
        let (cell_x, cell_z) = (x.floor() as i64, z.floor() as i64);
        let (u, v) = (x - x.floor(), z - z.floor());
        let along = |z: i64| {
            let (a, b) = (self.sample(cell_x, z), self.sample(cell_x + 1, z));
            a + (b - a) * u
        };
        let (a, b) = (along(cell_z), along(cell_z + 1));
        a + (b - a) * v
    }

    pub fn holds(&self, triangle: &Triangle) -> bool {
        triangle.iter().all(|corner| {
            (0..2).all(|axis| (0.0..=f64::from(self.size[axis] - 1)).contains(&corner[axis]))
        })
    }

    /// The largest vertical distance between the ground and a triangle with its corners on it. Exact:
    /// within a cell of the grid the difference is a saddle, and so it is largest at a grid point, or
    /// on the triangle's edges, where it is a parabola from one of the grid's lines to the next.
    pub fn worst(&self, triangle: &Triangle) -> f64 {
        let [a, b, c] = *triangle;
        let heights = triangle.map(|corner| self.at(corner));
        let (u, v) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
        let area = u[0] * v[1] - u[1] * v[0];
        let mut worst: f64 = 0.0;
        for (from, to) in [(0, 1), (1, 2), (2, 0)] {
            let (start, end) = (triangle[from], triangle[to]);
            let at = |t: f64| {
                let point = [0, 1].map(|axis| start[axis] + (end[axis] - start[axis]) * t);
                heights[from] + (heights[to] - heights[from]) * t - self.at(point)
            };
            let mut stops = vec![0.0, 1.0];
            for axis in [0, 1] {
                let (low, high) = (start[axis].min(end[axis]), start[axis].max(end[axis]));
                let mut line = low.ceil();
                while line <= high && high > low {
                    stops.push((line - start[axis]) / (end[axis] - start[axis]));
                    line += 1.0;
                }
            }
            stops.sort_by(f64::total_cmp);
            for pair in stops.windows(2) {
                let [s, t] = [pair[0], pair[1]].map(|t| t.clamp(0.0, 1.0));
                let (first, middle, last) = (at(s), at(0.5 * (s + t)), at(t));
                worst = worst.max(first.abs()).max(last.abs());
                let bend = 2.0 * (first + last - 2.0 * middle);
                if bend.abs() > 1e-9 {
                    let top = 0.5 - (last - first) / (2.0 * bend);
                    if (0.0..=1.0).contains(&top) {
                        worst = worst.max(at(s + (t - s) * top).abs());
                    }
                }
            }
        }
        if area.abs() < 1e-9 {
            return worst;
        }
        let bounds = |axis: usize| {
            let low = triangle.iter().map(|p| p[axis]).fold(f64::MAX, f64::min);
            let high = triangle.iter().map(|p| p[axis]).fold(f64::MIN, f64::max);
            low.ceil() as i64..=high.floor() as i64
        };
        for z in bounds(1) {
            for x in bounds(0) {
                let p = [x as f64 - a[0], z as f64 - a[1]];
                let s = (p[0] * v[1] - p[1] * v[0]) / area;
                let t = (u[0] * p[1] - u[1] * p[0]) / area;
                if s >= 0.0 && t >= 0.0 && s + t <= 1.0 {
                    let on_triangle =
                        heights[0] + (heights[1] - heights[0]) * s + (heights[2] - heights[0]) * t;
                    worst = worst.max((on_triangle - self.sample(x, z)).abs());
                }
            }
        }
        worst
    }
}

pub fn longest_edge(triangle: &Triangle) -> f64 {
    let [a, b, c] = triangle;
    [(a, b), (b, c), (c, a)]
        .iter()
        .map(|(p, q)| (p[0] - q[0]).hypot(p[1] - q[1]))
        .fold(0.0, f64::max)
}

/// Whether a triangle and the closed square of texel `(x, z)` have a point in common.
pub fn meets(triangle: &Triangle, texel: [u32; 2]) -> bool {
    let low = texel.map(|at| 4.0 * f64::from(at));
    let high = low.map(|at| at + 4.0);
    let corners = [low, [high[0], low[1]], high, [low[0], high[1]]];
    let mut axes = vec![[1.0, 0.0], [0.0, 1.0]];
    for (p, q) in [(0, 1), (1, 2), (2, 0)] {
        let (p, q) = (triangle[p], triangle[q]);
        axes.push([q[1] - p[1], p[0] - q[0]]);
    }
    axes.iter().all(|axis| {
        let range = |points: &[Point]| {
            let along = points.iter().map(|p| p[0] * axis[0] + p[1] * axis[1]);
            along.fold((f64::MAX, f64::MIN), |(low, high), at| {
                (low.min(at), high.max(at))
            })
        };
        let (a, b) = (range(triangle), range(&corners));
        a.0 <= b.1 && b.0 <= a.1
    })
}

/// A triangle of any shape and direction whose longest edge is `spacing`, and which has a point in
/// common with the texel; it may reach beyond the ground.
pub fn random_triangle(random: &mut Random, texel: [u32; 2], spacing: f64) -> Triangle {
    let turn = random.between(0.0, std::f64::consts::TAU);
    let (apex, height) = match (random.unit() * 4.0) as u32 {
        0 => (0.5, 0.75_f64.sqrt()),
        1 => (random.unit(), 0.0),
        2 => (0.5, 0.5),
        _ => (random.unit(), random.unit()),
    };
    let shape = [[0.0, 0.0], [1.0, 0.0], [apex, height]];
    let scale = spacing / longest_edge(&shape) * (1.0 - 1e-12);
    let (sin, cos) = turn.sin_cos();
    let turned = shape.map(|[x, z]| [scale * (x * cos - z * sin), scale * (x * sin + z * cos)]);
    // The point in common: one of the triangle's, in the texel or on its border.
    let mut weights = [0; 3].map(|_| random.unit());
    if random.unit() < 0.5 {
        weights[(random.unit() * 3.0) as usize] += 50.0;
    }
    let sum: f64 = weights.iter().sum();
    let common = [0, 1].map(|axis| {
        let inside = match (random.unit() * 4.0) as u32 {
            0 => 0.0,
            1 => 4.0,
            _ => random.between(0.0, 4.0),
        };
        4.0 * f64::from(texel[axis]) + inside
    });
    let centre = [0, 1].map(|axis| {
        let all = turned.iter().zip(&weights);
        all.map(|(corner, weight)| corner[axis] * weight / sum)
            .sum::<f64>()
    });
    turned.map(|corner| [0, 1].map(|axis| corner[axis] - centre[axis] + common[axis]))
}

/// The largest error found among triangles with edges up to `spacing` that meet the texel: the best
/// of some random ones, moved about while that makes it worse.
pub fn search(
    ground: &Ground,
    random: &mut Random,
    texel: [u32; 2],
    spacing: f64,
    tries: usize,
    steps: usize,
) -> f64 {
    let mut best: Option<(f64, Triangle)> = None;
    for _ in 0..tries {
        let triangle = random_triangle(random, texel, spacing);
        if ground.holds(&triangle) && meets(&triangle, texel) {
            let worst = ground.worst(&triangle);
            if best.is_none_or(|(most, _)| worst > most) {
                best = Some((worst, triangle));
            }
        }
    }
    let Some((mut most, mut triangle)) = best else {
        return 0.0;
    };
    let mut step = spacing * 0.3;
    for _ in 0..steps {
        let mut moved = triangle;
        let together = random.unit() < 0.3;
        let shift = [0; 2].map(|_| random.between(-step, step));
        let one = (random.unit() * 3.0) as usize;
        for (number, corner) in moved.iter_mut().enumerate() {
            if together || number == one {
                *corner = [corner[0] + shift[0], corner[1] + shift[1]];
            }
        }
        let long = longest_edge(&moved) > spacing;
        if !long && ground.holds(&moved) && meets(&moved, texel) {
            let worst = ground.worst(&moved);
            if worst > most {
                (most, triangle) = (worst, moved);
                continue;
            }
        }
        step = (step * 0.985).max(spacing * 0.002);
    }
    most
}
