// A stage of the frame on the canvas, and the photo wiped over it.
const SIZE = vec2<u32>($size); // columns, rows
override most_light: f32 = WHITE; // brightest light; more than white in high dynamic range

struct Shown {
    stage: u32,  // 0 result, 1 photo, 2 normals, 3 depth, 4 raw filter, 5 refined filter, 6 visibility
    lights: u32,
    wipe: f32,   // columns from the left that show the photo
    stops: f32,  // factor on the result
}

@group(0) @binding(0) var<uniform> shown: Shown;
@group(0) @binding(1) var<storage, read> image: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> picture: array<Stored>;
@group(0) @binding(3) var<storage, read> surface: array<vec4<f32>>; // normal, depth
@group(0) @binding(4) var<storage, read> light: array<Stored>; // raw, or after the cascade
@group(0) @binding(5) var<storage, read> totals: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> visibility: array<Stored>;
@group(0) @binding(7) var<uniform> colors: array<vec4<f32>, 32>; // of the lights

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(select(-1.0, 3.0, k == 1u), select(-1.0, 3.0, k == 2u), 0.0, 1.0);
}

@fragment
fn fragment(@builtin(position) place: vec4<f32>) -> @location(0) vec4<f32> {
    let cell = min(vec2<u32>(place.xy), SIZE - 1u);
    let pixel = cell.y * SIZE.x + cell.x;
    if (shown.stage == 1u || place.x < shown.wipe) { return vec4<f32>(load(picture[pixel]).xyz, 1.0); }
    switch shown.stage {
        case 2u: { return vec4<f32>(select(vec3<f32>(0.0), 0.5 + 0.5 * surface[pixel].xyz, surface[pixel].w > 0.0), 1.0); }
        case 3u: {
            let depth = surface[pixel].w;
            return vec4<f32>(vec3<f32>(select(0.0, exp(-0.3 * depth), depth > 0.0)), 1.0);
        }
        case 4u, 5u: {
            let relight_filter = filter_at(pixel, false);
            return vec4<f32>(encoded(relight_filter / (1.0 + relight_filter)), 1.0);
        }
        case 6u: {
            let whole = filter_at(pixel, false);
            let left = filter_at(pixel, true);
            return vec4<f32>(select(vec3<f32>(1.0), left / max(whole, vec3<f32>(1e-12)), whole > vec3<f32>(1e-9)), 1.0);
        }
        default: { return vec4<f32>(unclipped(held(min(shown.stops * image[pixel].xyz, vec3<f32>(most_light)))) + dither(place.xy), 1.0); }
    }
}

// Noise of one step of eight bits, so that dark gradients have no bands (Jimenez, *Next generation post processing in
// Call of Duty: Advanced Warfare*, 2014).
fn dither(place: vec2<f32>) -> f32 {
    return (fract(52.9829189 * fract(dot(place, vec2<f32>(0.06711056, 0.00583715)))) - 0.5) / 255.0;
}

// The relight filter; of the raw light where the surface is known, else black.
fn filter_at(pixel: u32, shadowed: bool) -> vec3<f32> {
    let plane = SIZE.x * SIZE.y;
    let own = load(light[pixel]);
    let weight = vec4<f32>(own.w);
    let total_weight = vec4<f32>(totals[0].w);
    let raw = shown.stage == 4u;
    if (raw && own.w <= 0.0) { return vec3<f32>(0.0); }
    var shining = select(completed(own, weight, totals[0], total_weight), own, raw).xyz;
    for (var group = 0u; 4u * group < shown.lights; group++) {
        let at = (2u + group) * plane + pixel;
        var each = load(light[at]);
        if (!raw) { each = completed(each, weight, totals[2u + group], total_weight); }
        if (shadowed) { each *= load(visibility[group * plane + pixel]); }
        for (var k = 0u; k < min(4u, shown.lights - 4u * group); k++) {
            shining += each[k] * colors[4u * group + k].xyz;
        }
    }
    let old = load(light[plane + pixel]);
    let photo_light = select(completed(old, weight, totals[1], total_weight), old, raw).xyz;
    return shining / max(photo_light, vec3<f32>(LEAST_PHOTO_LIGHT));
}
