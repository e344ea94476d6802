// Visibility where it is known, and its surroundings' where it is not: `hyjax.core.refine.fill_visibility`.
// Groups of values are followed by as many groups of weights; planes of light may come before them.
@group(0) @binding(0) var<storage, read> raw: array<Stored>;
@group(0) @binding(1) var<storage, read> coarse: array<Stored>; // after diffusion
@group(0) @binding(2) var<storage, read> totals: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> result: array<Stored>;
$guide_bindings

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) count: vec3<u32>) {
    if (any(id.xy >= FINE)) { return; }
    let pixel = id.y * FINE.x + id.x;
    let plane = FINE.x * FINE.y;
    let value = $first + id.z;
    let weight = value + count.z;
    let corners = corners_of(id.xy);
    let filled = completed(interpolated(corners, value), interpolated(corners, weight), totals[value], totals[weight]);
    let known = load(raw[weight * plane + pixel]) > vec4<f32>(0.0);
    result[id.z * plane + pixel] = store(select(filled, load(raw[value * plane + pixel]), known));
}
