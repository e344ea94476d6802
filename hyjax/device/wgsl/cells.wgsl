// Means over the cells of a level and of coarser ones, from the means of a finer one: `hyjax.core.pyramid.cell_pyramid`.
// A picture has groups of four channels, plane after plane. Cells cut off by the border average the pixels they have.
@group(0) @binding(0) var<storage, read> fine: array<Stored>;
@group(0) @binding(1) var<storage, read_write> coarse: array<Stored>;
$coarser_bindings

const FULL = vec2<u32>($full);
const FINE = vec2<u32>($fine);
const COARSE = vec2<u32>($coarse);
const FINE_FACTOR = ${fine_factor}u; // pixels that a cell of the finer level is wide
const RATIO = ${ratio}u;

var<workgroup> means: array<vec4<f32>, 64>; // of the last level's cells, where their first cells of `coarse` are

fn pixels(cell: vec2<u32>, factor: u32) -> f32 {
    let sides = min(vec2<u32>(factor), FULL - factor * cell);
    return f32(sides.x * sides.y);
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    var mean = vec4<f32>(0.0);
    let inside = all(id.xy < COARSE);
    let place = local.y * 8u + local.x;
    if (inside) {
        var total = vec4<f32>(0.0);
        var count = 0.0;
        let start = RATIO * id.xy;
        let end = min(start + RATIO, FINE);
        for (var y = start.y; y < end.y; y++) {
            for (var x = start.x; x < end.x; x++) {
                let n = pixels(vec2<u32>(x, y), FINE_FACTOR);
                total += n * load(fine[(id.z * FINE.y + y) * FINE.x + x]);
                count += n;
            }
        }
        mean = total / count;
        coarse[(id.z * COARSE.y + id.y) * COARSE.x + id.x] = store(mean);
    }
    means[place] = mean;
    $coarser
}
