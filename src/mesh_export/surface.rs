//! A view's mesh as other programs want it: without vertices that are there twice.

use crate::tessellate::TerrainMesh;
use glam::{DVec2, DVec3, IVec2, Vec3};
use std::collections::{BTreeMap, HashMap};

/// A corner of a [`Surface`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceVertex {
    /// Its lattice point, in lattice units from the terrain's first sample.
    pub point: IVec2,
    /// Height in metres above the terrain's origin.
    pub height_m: f32,
    /// Unit normal: the mean of the triangles around, weighted by their areas.
    pub normal: Vec3,
}

/// A mesh whose triangles share their vertices.
///
/// Right-handed with y up; triangles are counter-clockwise seen from above. Where the view's mesh
/// is watertight, every edge but those on the terrain's rim belongs to two triangles, once in each
/// direction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// Metres per lattice unit.
    pub unit_m: f64,
    /// The corners, each once.
    pub vertices: Vec<SurfaceVertex>,
    /// The triangles, as numbers of corners, counter-clockwise from above.
    pub triangles: Vec<[u32; 3]>,
}

impl Surface {
    /// Makes a surface of meshes that belong together, such as a view's faces.
    ///
    /// Vertices at the same lattice point and height become one. Triangles without area seen from
    /// above are there where faces have morphed away, and where an edge has other vertices than what
    /// lies beside it. They are left out as far as nothing hangs on them: what remains closes the
    /// surface, and so some triangles have no area but no two corners in one place.
    #[must_use]
    pub fn new(meshes: impl IntoIterator<Item = TerrainMesh>, unit_m: f64) -> Self {
        let mut surface = Self {
            unit_m,
            ..Self::default()
        };
        let mut numbers: HashMap<(IVec2, u32), u32> = HashMap::new();
        let mut seam = Seam::default();
        for mesh in meshes {
            let of: Vec<u32> = mesh
                .vertices
                .iter()
                .map(|vertex| {
                    // Adding 0 makes -0 and 0 the same bits.
                    let height_m = vertex.height_m + 0.0;
                    let next = surface.vertices.len() as u32;
                    let key = (vertex.point, height_m.to_bits());
                    let number = *numbers.entry(key).or_insert(next);
                    if number == next {
                        surface.vertices.push(SurfaceVertex {
                            point: vertex.point,
                            height_m,
                            normal: Vec3::ZERO,
                        });
                    }
                    number
                })
                .collect();
            for triangle in mesh.triangles {
                let triangle = triangle.map(|vertex| of[vertex as usize]);
                if surface.area2(triangle) == 0 {
                    seam.add(triangle);
                } else {
                    surface.triangles.push(triangle);
                }
            }
        }
        surface.triangles.extend(seam.triangles());
        surface.drop_unused();
        surface.set_normals();
        surface
    }

    /// Leaves out vertices that no triangle has, and counts the others in the order of their use.
    fn drop_unused(&mut self) {
        let mut numbers = vec![u32::MAX; self.vertices.len()];
        let mut used = Vec::with_capacity(self.vertices.len());
        for vertex in self.triangles.iter_mut().flatten() {
            let number = &mut numbers[*vertex as usize];
            if *number == u32::MAX {
                *number = used.len() as u32;
                used.push(self.vertices[*vertex as usize]);
            }
            *vertex = *number;
        }
        self.vertices = used;
    }

    /// Twice the area of a triangle seen from above, in square units.
    fn area2(&self, triangle: [u32; 3]) -> i64 {
        let [a, b, c] = triangle.map(|vertex| self.vertices[vertex as usize].point);
        let [u, v] = [b - a, c - a].map(|d| (i64::from(d.x), i64::from(d.y)));
        u.0 * v.1 - v.0 * u.1
    }

    fn set_normals(&mut self) {
        let mut sums = vec![Vec3::ZERO; self.vertices.len()];
        for &triangle in &self.triangles {
            // What stands upright joins two edges, and is no ground.
            if self.area2(triangle) == 0 {
                continue;
            }
            let corners = triangle.map(|vertex| self.vertices[vertex as usize]);
            let [u, v] = [1, 2].map(|corner| {
                let across = (corners[corner].point - corners[0].point).as_dvec2() * self.unit_m;
                let up_m = corners[corner].height_m - corners[0].height_m;
                Vec3::new(across.x as f32, up_m, across.y as f32)
            });
            // As long as twice the triangle's area.
            let normal = u.cross(v);
            for vertex in triangle {
                sums[vertex as usize] += normal;
            }
        }
        for (vertex, sum) in self.vertices.iter_mut().zip(sums) {
            vertex.normal = sum.try_normalize().unwrap_or(Vec3::Y);
        }
    }

    /// Where a vertex is, in metres from the terrain's origin.
    #[must_use]
    pub fn position_m(&self, vertex: &SurfaceVertex) -> DVec3 {
        let plane: DVec2 = vertex.point.as_dvec2() * self.unit_m;
        DVec3::new(plane.x, vertex.height_m.into(), plane.y)
    }
}

/// Triangles without area, by their outline.
///
/// However many lie on one another, with their corners in whatever order: what they close is the
/// edges that remain when those are taken away that are there both ways.
#[derive(Default)]
struct Seam {
    /// How often an edge is there from its lower to its higher vertex, less the times back.
    edges: BTreeMap<(u32, u32), i32>,
}

impl Seam {
    fn add(&mut self, triangle: [u32; 3]) {
        for k in 0..3 {
            let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
            if a != b {
                let (key, way) = if a < b { ((a, b), 1) } else { ((b, a), -1) };
                *self.edges.entry(key).or_default() += way;
            }
        }
    }

    /// As many triangles as have the same outline.
    fn triangles(&self) -> Vec<[u32; 3]> {
        let mut next: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for (&(a, b), &times) in &self.edges {
            let (from, to) = if times > 0 { (a, b) } else { (b, a) };
            let all = next.entry(from).or_default();
            all.extend((0..times.unsigned_abs()).map(|_| to));
        }
        let mut triangles = Vec::new();
        let mut walk: Vec<u32> = Vec::new();
        let starts: Vec<u32> = next.keys().copied().collect();
        for start in starts {
            let mut at = start;
            // As many edges lead away from a vertex as to it, so a walk ends where it began.
            while let Some(to) = next.get_mut(&at).and_then(Vec::pop) {
                walk.push(at);
                if let Some(first) = walk.iter().position(|&vertex| vertex == to) {
                    let ring = walk.split_off(first);
                    let pairs = ring[1..].windows(2);
                    triangles.extend(pairs.map(|pair| [ring[0], pair[0], pair[1]]));
                }
                at = to;
            }
            walk.clear();
        }
        triangles
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tessellate::TerrainVertex;

    fn mesh(points: &[(i32, i32, f32)], triangles: &[[u32; 3]]) -> TerrainMesh {
        TerrainMesh {
            vertices: points
                .iter()
                .map(|&(x, z, height_m)| TerrainVertex {
                    point: IVec2::new(x, z),
                    height_m,
                    lambda: 0,
                })
                .collect(),
            triangles: triangles.to_vec(),
            ..Default::default()
        }
    }

    #[test]
    fn what_several_faces_share_is_there_once() {
        let near = mesh(&[(0, 0, 1.0), (4, 4, 1.0), (4, 0, 1.0)], &[[0, 1, 2]]);
        let far = mesh(&[(0, 0, 1.0), (0, 4, 1.0), (4, 4, 1.0)], &[[0, 1, 2]]);
        let surface = Surface::new([near, far], 0.5);
        assert_eq!(surface.vertices.len(), 4);
        assert_eq!(surface.triangles, [[0, 1, 2], [0, 3, 1]]);
        for vertex in &surface.vertices {
            assert_eq!(vertex.normal, Vec3::Y);
        }
        let last = surface.position_m(&surface.vertices[1]);
        assert_eq!(last, DVec3::new(2.0, 1.0, 2.0));
    }

    #[test]
    fn other_heights_at_a_point_stay_apart_and_what_closes_the_surface_stays() {
        let points = [
            (0, 0, 1.0),
            (2, 0, 5.0),
            (4, 0, 1.0),
            (4, 4, 0.0),
            (0, 0, 2.0),
        ];
        let surface = Surface::new(
            [mesh(&points, &[[0, 3, 2], [2, 1, 0], [4, 3, 2], [2, 2, 0]])],
            1.0,
        );
        assert_eq!(surface.vertices.len(), 5);
        let points: Vec<_> = surface
            .vertices
            .iter()
            .map(|vertex| vertex.height_m)
            .collect();
        assert_eq!(points, [1.0, 0.0, 1.0, 2.0, 5.0]);
        assert_eq!(surface.triangles, [[0, 1, 2], [3, 1, 2], [0, 2, 4]]);
        let zeros = [(0, 0, -0.0), (0, 0, 0.0), (4, 0, 0.0), (4, 4, 0.0)];
        let surface = Surface::new([mesh(&zeros, &[[0, 3, 2], [1, 3, 2]])], 1.0);
        assert_eq!(surface.vertices.len(), 3);
    }

    #[test]
    fn triangles_without_area_that_lie_on_one_another_go() {
        // A face that has morphed away: its sides in one line, cut there in two and in three.
        let points = [
            (0, 0, 1.0),
            (2, 0, 5.0),
            (4, 0, 1.0),
            (6, 0, 2.0),
            (4, 4, 0.0),
        ];
        let gone = [[0, 1, 3], [1, 2, 3], [3, 2, 0], [2, 1, 0]];
        let surface = Surface::new([mesh(&points, &[&gone[..], &[[0, 4, 3]]].concat())], 1.0);
        assert_eq!(surface.triangles.len(), 1);
        assert_eq!(surface.vertices.len(), 3);
        // With one of them missing, the others' outline stays.
        let surface = Surface::new([mesh(&points, &gone[..3])], 1.0);
        assert_eq!(surface.triangles.len(), 1);
    }
}
