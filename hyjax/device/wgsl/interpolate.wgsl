// Interpolation between cell centres: `hyjax.core.pyramid.upsample`, or under a guide
// `hyjax.core.upsampling.guided_upsample`. Needs `coarse`.
const FINE = vec2<u32>($fine);
const COARSE = vec2<i32>($coarse);
const FACTOR = f32($factor);

$likeness

// Cells around a pixel, and their weights, which add up to one.
struct Corners { cells: vec4<u32>, weights: vec4<f32> }

fn corners_of(pixel: vec2<u32>) -> Corners {
    let place = (vec2<f32>(pixel) + 0.5) / FACTOR - 0.5;
    let first = vec2<i32>(floor(place));
    let share = place - floor(place);
    var cells = vec4<u32>(0u);
    var weights = vec4<f32>(0.0);
    for (var k = 0; k < 4; k++) {
        let corner = vec2<i32>(k & 1, k >> 1u);
        let cell = vec2<u32>(clamp(first + corner, vec2<i32>(0), COARSE - 1));
        let near = select(1.0 - share, share, corner == vec2<i32>(1));
        weights[k] = near.x * near.y * likeness(pixel, cell);
        cells[k] = cell.y * u32(COARSE.x) + cell.x;
    }
    return Corners(cells, weights / dot(weights, vec4<f32>(1.0)));
}

fn interpolated(corners: Corners, group: u32) -> vec4<f32> {
    let plane = group * u32(COARSE.x * COARSE.y);
    var total = vec4<f32>(0.0);
    for (var k = 0; k < 4; k++) { total += corners.weights[k] * load(coarse[plane + corners.cells[k]]); }
    return total;
}
