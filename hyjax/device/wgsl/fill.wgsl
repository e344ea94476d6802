// Visibility where it is known, and its surroundings' where it is not: `hyjax.core.refine.fill_visibility`.
// Groups of values come first, then as many groups of weights.
@group(0) @binding(0) var<storage, read> raw: array<Stored>;
@group(0) @binding(1) var<storage, read> diffused: array<Stored>;
@group(0) @binding(2) var<storage, read> totals: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> result: array<Stored>;

const PIXELS = ${pixels}u;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) count: vec3<u32>) {
    let pixel = id.x + id.y * 64u * count.x;
    if (pixel >= PIXELS) { return; }
    let value = id.z * PIXELS + pixel;
    let weight = (id.z + count.z) * PIXELS + pixel;
    let filled = completed(load(diffused[value]), load(diffused[weight]), totals[id.z], totals[id.z + count.z]);
    let known = load(raw[weight]) > vec4<f32>(0.0);
    result[value] = store(select(filled, load(raw[value]), known));
}
