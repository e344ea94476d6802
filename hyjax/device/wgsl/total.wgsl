// Sum over a picture of each channel, from the means of a level's cells.
@group(0) @binding(0) var<storage, read> means: array<Stored>;
@group(0) @binding(1) var<storage, read_write> totals: array<vec4<f32>>;

const FULL = vec2<u32>($full);
const CELLS = vec2<u32>($cells);
const FACTOR = ${factor}u;

var<workgroup> parts: array<vec4<f32>, 256>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    var total = vec4<f32>(0.0);
    for (var k = local; k < CELLS.x * CELLS.y; k += 256u) {
        let cell = vec2<u32>(k % CELLS.x, k / CELLS.x);
        let sides = min(vec2<u32>(FACTOR), FULL - FACTOR * cell);
        total += f32(sides.x * sides.y) * load(means[group.z * CELLS.x * CELLS.y + k]);
    }
    parts[local] = total;
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if (local < half) { parts[local] += parts[local + half]; }
    }
    workgroupBarrier();
    if (local == 0u) { totals[group.z] = parts[0]; }
}
