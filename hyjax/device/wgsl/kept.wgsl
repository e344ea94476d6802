// Bounced light, filled up by the ambient lights, and what is left of the sources that lit the photos.
@group(0) @binding(0) var<storage, read> indirect: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read> sources: array<f32>; // source after source, vertex by vertex, three channels
@group(0) @binding(2) var<storage, read> kept: array<vec4<f32>>; // of each source; last the least bounced light
@group(0) @binding(3) var<storage, read_write> bounced: array<vec4<f32>>;

const VERTICES = ${vertices}u;
const SOURCES = ${sources}u;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= VERTICES) { return; }
    var total = max(indirect[id.x].xyz, kept[SOURCES].xyz);
    for (var s = 0u; s < SOURCES; s++) {
        let k = 3u * (s * VERTICES + id.x);
        total += kept[s].xyz * vec3<f32>(sources[k], sources[k + 1u], sources[k + 2u]);
    }
    bounced[id.x] = vec4<f32>(total, 0.0);
}
