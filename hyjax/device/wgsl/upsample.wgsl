// Interpolation between cell centres: `hyjax.core.pyramid.upsample`, or under a guide
// `hyjax.core.upsampling.guided_upsample`.
@group(0) @binding(0) var<storage, read> coarse: array<Stored>;
@group(0) @binding(1) var<storage, read_write> fine: array<Stored>;
$guide_bindings

const FINE = vec2<u32>($fine);
const COARSE = vec2<i32>($coarse);
const FACTOR = f32($factor);

$likeness

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= FINE)) { return; }
    let place = (vec2<f32>(id.xy) + 0.5) / FACTOR - 0.5;
    let first = vec2<i32>(floor(place));
    let share = place - floor(place);
    var total = vec4<f32>(0.0);
    var weights = 0.0;
    for (var k = 0; k < 4; k++) {
        let corner = vec2<i32>(k & 1, k >> 1u);
        let cell = vec2<u32>(clamp(first + corner, vec2<i32>(0), COARSE - 1));
        let near = select(1.0 - share, share, corner == vec2<i32>(1));
        let weight = near.x * near.y * likeness(id.xy, cell);
        total += weight * load(coarse[(id.z * u32(COARSE.y) + cell.y) * u32(COARSE.x) + cell.x]);
        weights += weight;
    }
    fine[(id.z * FINE.y + id.y) * FINE.x + id.x] = store(total / weights);
}
