//! Surfaces as files of other programs' formats.

use super::Surface;
use glam::DVec3;
use std::fmt::Write as _;
use std::io::{self, Write};

/// What files say of themselves, by which they are known again.
pub(super) const MARK: &str = "tessera mesh";

impl Surface {
    /// Writes a Wavefront OBJ file: `v` in metres from the terrain's origin, `vn`, and `f`.
    ///
    /// Has no limit to its precision: places are written to a half of a lattice unit, heights to the
    /// last bit.
    ///
    /// # Errors
    /// Where `out` refuses.
    pub fn write_obj(&self, out: &mut impl Write) -> io::Result<()> {
        writeln!(out, "# {MARK}: metres, y up, counter-clockwise from above")?;
        writeln!(out, "o terrain")?;
        let places = (-(0.5 * self.unit_m).log10()).ceil().clamp(0.0, 12.0) as usize;
        let mut line = String::new();
        for vertex in &self.vertices {
            let at = self.position_m(vertex);
            line.clear();
            line.push('v');
            push_number(&mut line, at.x, places);
            // The fewest digits that are no other number of 32 bits.
            let _ = write!(line, " {}", vertex.height_m);
            push_number(&mut line, at.z, places);
            writeln!(out, "{line}")?;
        }
        for vertex in &self.vertices {
            line.clear();
            line.push_str("vn");
            for axis in vertex.normal.to_array() {
                push_number(&mut line, axis.into(), 5);
            }
            writeln!(out, "{line}")?;
        }
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|vertex| vertex + 1);
            writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?;
        }
        Ok(())
    }

    /// Writes a binary glTF 2.0 file of one node, one mesh and one primitive: positions, normals
    /// and 32 bit indices.
    ///
    /// Positions are `f32` and relative to `origin_m`, which the node's translation puts back, so
    /// that they are precise where the eye is however large the terrain.
    ///
    /// # Errors
    /// Where `out` refuses, and where there is nothing to write or more than the format's 4 GiB.
    pub fn write_glb(&self, out: &mut impl Write, origin_m: DVec3) -> io::Result<()> {
        if self.triangles.is_empty() {
            // glTF has no empty meshes.
            return Err(io::Error::other("there are no triangles"));
        }
        let position = |vertex| (self.position_m(vertex) - origin_m).as_vec3();
        let positions = self.vertices.iter().map(position);
        let low = positions
            .clone()
            .reduce(glam::Vec3::min)
            .unwrap_or_default();
        let high = positions
            .clone()
            .reduce(glam::Vec3::max)
            .unwrap_or_default();
        let (vertices, triangles) = (self.vertices.len(), self.triangles.len());
        let [vectors, indices] = [vertices, triangles].map(|count| 12 * count);
        let binary = 2 * vectors + indices;
        let json = format!(
            concat!(
                r#"{{"asset":{{"version":"2.0","generator":"{mark}"}},"scene":0,"#,
                r#""scenes":[{{"nodes":[0]}}],"#,
                r#""nodes":[{{"name":"terrain","mesh":0,"translation":{origin}}}],"#,
                r#""meshes":[{{"name":"terrain","primitives":[{{"#,
                r#""attributes":{{"POSITION":0,"NORMAL":1}},"indices":2}}]}}],"#,
                r#""accessors":["#,
                r#"{{"bufferView":0,"componentType":5126,"count":{vertices},"type":"VEC3","#,
                r#""min":{low},"max":{high}}},"#,
                r#"{{"bufferView":1,"componentType":5126,"count":{vertices},"type":"VEC3"}},"#,
                r#"{{"bufferView":2,"componentType":5125,"count":{corners},"type":"SCALAR"}}],"#,
                r#""bufferViews":["#,
                r#"{{"buffer":0,"byteOffset":0,"byteLength":{vectors},"target":34962}},"#,
                r#"{{"buffer":0,"byteOffset":{vectors},"byteLength":{vectors},"target":34962}},"#,
                r#"{{"buffer":0,"byteOffset":{after},"byteLength":{indices},"target":34963}}],"#,
                r#""buffers":[{{"byteLength":{binary}}}]}}"#,
            ),
            mark = MARK,
            vertices = vertices,
            vectors = vectors,
            indices = indices,
            binary = binary,
            origin = array(origin_m),
            low = array(low.as_dvec3()),
            high = array(high.as_dvec3()),
            corners = 3 * triangles,
            after = 2 * vectors,
        );
        let padding = json.len().next_multiple_of(4) - json.len();
        let text = json.len() + padding;
        // A header of 12 bytes, and of 8 for each of the two chunks.
        let whole = u32::try_from(12 + 8 + text + 8 + binary)
            .map_err(|_| io::Error::other("a binary glTF file can't be longer than 4 GiB"))?;
        let [text, binary] = [text, binary].map(|length| length as u32);
        out.write_all(b"glTF")?;
        out.write_all(&2_u32.to_le_bytes())?;
        out.write_all(&whole.to_le_bytes())?;
        out.write_all(&text.to_le_bytes())?;
        out.write_all(b"JSON")?;
        out.write_all(json.as_bytes())?;
        out.write_all(&b"   "[..padding])?;
        out.write_all(&binary.to_le_bytes())?;
        out.write_all(b"BIN\0")?;
        let normals = self.vertices.iter().map(|vertex| vertex.normal);
        for axis in positions
            .chain(normals)
            .flat_map(|vector| vector.to_array())
        {
            out.write_all(&axis.to_le_bytes())?;
        }
        for vertex in self.triangles.iter().flatten() {
            out.write_all(&vertex.to_le_bytes())?;
        }
        Ok(())
    }
}

/// A vector as JSON. Rust never writes exponents, nor loses a digit that tells two numbers apart.
fn array(vector: DVec3) -> String {
    let [x, y, z] = vector.to_array().map(|axis| axis + 0.0);
    format!("[{x},{y},{z}]")
}

/// A space and a number to so many decimals, without zeros at the end.
fn push_number(line: &mut String, number: f64, places: usize) {
    let _ = write!(line, " {number:.places$}");
    if places > 0 {
        let kept = line.trim_end_matches('0').trim_end_matches('.').len();
        line.truncate(kept);
    }
    if line.ends_with(" -0") {
        line.truncate(line.len() - 2);
        line.push('0');
    }
}
