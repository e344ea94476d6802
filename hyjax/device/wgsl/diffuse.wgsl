// Several explicit steps of guided diffusion (Eq. 2) in one launch: `hyjax.core.diffusion.diffuse`.
// A workgroup takes a tile of 32 x 32 cells into its memory, of which a rim of one cell a step is spent.
@group(0) @binding(0) var<storage, read> before: array<Stored>;
@group(0) @binding(1) var<storage, read> edges: array<vec2<f32>>;
@group(0) @binding(2) var<storage, read_write> after: array<Stored>;
$source_binding

const SIZE = vec2<i32>($size);
const RIM = ${rim};
const STEPS = ${steps};

var<workgroup> tile: array<vec4<f32>, 1024>;

fn conductances(cell: vec2<i32>) -> vec4<f32> { // up, left, down, right
    if (any(cell < vec2<i32>(0)) || any(cell >= SIZE)) { return vec4<f32>(0.0); }
    let here = cell.y * SIZE.x + cell.x;
    var result = vec4<f32>(0.0, 0.0, edges[here]);
    if (cell.y > 0) { result.x = edges[here - SIZE.x].x; }
    if (cell.x > 0) { result.y = edges[here - 1].y; }
    return result;
}

@compute @workgroup_size(16, 16)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    let start = vec2<i32>(group.xy) * (32 - 2 * RIM) - RIM;
    let plane = i32(group.z) * SIZE.x * SIZE.y;
    var step_sizes = array<f32, STEPS>($step_sizes);
    var y: array<vec4<f32>, 4>;
    var c: array<vec4<f32>, 4>;
    var source: array<vec4<f32>, 4>;
    for (var q = 0; q < 4; q++) {
        let place = vec2<i32>(local.xy) * 2 + vec2<i32>(q & 1, q >> 1u);
        let cell = start + place;
        c[q] = conductances(cell);
        let inside = clamp(cell, vec2<i32>(0), SIZE - 1);
        let index = plane + inside.y * SIZE.x + inside.x;
        y[q] = load(before[index]);
        source[q] = $source;
        tile[place.y * 32 + place.x] = y[q];
    }
    workgroupBarrier();
    for (var s = 0; s < STEPS; s++) {
        let lam = step_sizes[s];
        for (var q = 0; q < 4; q++) {
            let place = vec2<i32>(local.xy) * 2 + vec2<i32>(q & 1, q >> 1u);
            let here = place.y * 32 + place.x;
            let up = tile[select(here, here - 32, place.y > 0)];
            let left = tile[select(here, here - 1, place.x > 0)];
            let down = tile[select(here, here + 32, place.y < 31)];
            let right = tile[select(here, here + 1, place.x < 31)];
            let own = y[q];
            let flow = c[q].x * (up - own) + c[q].y * (left - own) + c[q].z * (down - own) + c[q].w * (right - own);
            y[q] = $update;
        }
        workgroupBarrier();
        for (var q = 0; q < 4; q++) {
            let place = vec2<i32>(local.xy) * 2 + vec2<i32>(q & 1, q >> 1u);
            tile[place.y * 32 + place.x] = y[q];
        }
        workgroupBarrier();
    }
    for (var q = 0; q < 4; q++) {
        let place = vec2<i32>(local.xy) * 2 + vec2<i32>(q & 1, q >> 1u);
        let cell = start + place;
        if (all(place >= vec2<i32>(RIM)) && all(place < vec2<i32>(32 - RIM)) && all(cell >= vec2<i32>(0)) && all(cell < SIZE)) {
            after[plane + cell.y * SIZE.x + cell.x] = store(y[q]);
        }
    }
}
