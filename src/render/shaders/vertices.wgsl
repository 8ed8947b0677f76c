// Pass 3, the domain shader: every vertex is evaluated once and then drawn by all passes.

#import bevy_tessera::types::{ONE, TerrainVertex}
#import bevy_tessera::bindings::{
    terrain_view, nodes, face_factors, node_offsets, draw_args, mesh_vertices,
}
#import bevy_tessera::lattice::lambda_at
#import bevy_tessera::height::displaced_m
#import bevy_tessera::face::{
    drawn_point, face_corners, face_counts, face_vertex, scaled_factors, unpack_factors,
}
#import bevy_tessera::scan::{LANES, face_places, faces_a_node, scan_faces, face_at}

@compute @workgroup_size(256)
fn vertices(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    // A node is shared out among `z` workgroups, because nodes near the eye are the heaviest.
    let node_index = workgroup.y * workgroups.x + workgroup.x;
    if node_index >= terrain_view.node_count || draw_args.index_count == 0u {
        return;
    }
    let total = scan_faces(node_index, lane).x;
    let node = nodes[node_index];
    let first = node_offsets[node_index].x;
    for (
        var place = workgroup.z * LANES + lane;
        place < total;
        place += workgroups.z * LANES
    ) {
        let face = face_at(place, 0u);
        let factors = scaled_factors(
            unpack_factors(face_factors[node_index * faces_a_node() + face]),
            draw_args.scale,
        );
        let counts = face_counts(factors);
        let corners = face_corners(node, face);
        let own = face_vertex(corners, factors, counts, place - face_places[face].x);
        var vertex: TerrainVertex;
        vertex.point = drawn_point(own);
        vertex.lambda = lambda_at(vertex.point, node.level);
        vertex.height_m = displaced_m(own.point, node.level).x;
        if own.rise != ONE {
            var parents = own.parents;
            var between_m = 0.0;
            for (var k = 0u; k < 2u; k++) {
                between_m += 0.5 * displaced_m(parents[k], node.level).x;
            }
            let rise = f32(own.rise) / f32(ONE);
            vertex.height_m = between_m + (vertex.height_m - between_m) * rise;
        }
        mesh_vertices[first + place] = vertex;
    }
}
