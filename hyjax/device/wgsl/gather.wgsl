// Light that reaches each point by way of others: the mean over its rays of what is sent at their ends.
@group(0) @binding(0) var<storage, read> hits: array<u32>; // ray after ray, point by point
@group(0) @binding(1) var<storage, read> sent: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> indirect: array<vec4<f32>>;

const POINTS = ${points}u;
const RAYS = ${rays}u;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= POINTS) { return; }
    var total = vec4<f32>(0.0);
    for (var ray = 0u; ray < RAYS; ray++) { total += sent[hits[ray * POINTS + id.x]]; }
    indirect[id.x] = total / f32(RAYS);
}
