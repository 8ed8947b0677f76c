// Pass 4: the triangles, each found from its number alone.

#import bevy_tessera::bindings::{
    terrain_view, face_factors, node_offsets, draw_args, mesh_indices,
}
#import bevy_tessera::face::{face_counts, face_triangle, scaled_factors, unpack_factors}
#import bevy_tessera::scan::{LANES, face_places, faces_a_node, scan_faces, face_at}

@compute @workgroup_size(256)
fn indices(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let node_index = workgroup.y * workgroups.x + workgroup.x;
    if node_index >= terrain_view.node_count || draw_args.index_count == 0u {
        return;
    }
    let total = scan_faces(node_index, lane).y;
    let first = node_offsets[node_index];
    for (
        var place = workgroup.z * LANES + lane;
        place < total;
        place += workgroups.z * LANES
    ) {
        let face = face_at(place, 1u);
        let factors = scaled_factors(
            unpack_factors(face_factors[node_index * faces_a_node() + face]),
            draw_args.scale,
        );
        let counts = face_counts(factors);
        let triangle = face_triangle(counts, place - face_places[face].y);
        let base = first.x + face_places[face].x;
        let at = 3u * (first.y + place);
        mesh_indices[at] = base + triangle.x;
        mesh_indices[at + 1u] = base + triangle.y;
        mesh_indices[at + 2u] = base + triangle.z;
    }
}
