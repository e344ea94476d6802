// The relit picture in linear light (Eq. 1): `hyjax.light.relit.relit_picture`, with what shines by itself.
@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> lights: array<Light, ${lights}>;
@group(0) @binding(2) var<uniform> emitters: array<vec4<f32>, ${emitters}>;
@group(0) @binding(3) var<storage, read> picture: array<Stored>;
@group(0) @binding(4) var<storage, read> surface: array<vec4<f32>>; // normal, depth
@group(0) @binding(5) var<storage, read> coarse: array<Stored>; // light after the cascade
@group(0) @binding(6) var<storage, read> totals: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> visibility: array<Stored>;
@group(0) @binding(8) var<storage, read_write> image: array<vec4<f32>>; // linear; w: how far it shines by itself
$guide_bindings

const PANE = ${pane}u; // vectors of one
const PANE_REFLECTANCE = 0.04;
const LAMP_REFLECTANCE = 0.6;
const FRAME_REFLECTANCE = 0.8;
const PANE_SHARE = 0.4;
const PANE_WHITE = 0.75;
const PANE_UNLIT = 0.05;
const PANE_LIT = 0.1;
const SLACK = 0.12;
const LAMP_DARK = 0.75;
const LAMP_BRIGHT = 1.09;
const CORE_EXPONENT = 4.0;
const RIM_WIDTH = 640u;

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= SIZE)) { return; }
    let pixel = id.y * SIZE.x + id.x;
    let plane = SIZE.x * SIZE.y;
    let photo = to_linear(load(picture[pixel]).xyz);
    let corners = corners_of(id.xy);
    let own = interpolated(corners, 0u);
    let weight = vec4<f32>(own.w);
    let total_weight = vec4<f32>(totals[0].w);
    var shining = completed(own, weight, totals[0], total_weight).xyz;
    for (var group = 0u; 4u * group < frame.counts.x; group++) {
        let each = completed(interpolated(corners, 2u + group), weight, totals[2u + group], total_weight) * load(visibility[group * plane + pixel]);
        for (var k = 0u; k < min(4u, frame.counts.x - 4u * group); k++) {
            shining += each[k] * lights[4u * group + k].color.xyz;
        }
    }
    let photo_light = completed(interpolated(corners, 1u), weight, totals[1], total_weight).xyz;
    let emission = emission_at(id.xy, photo, surface[pixel].w, shining);
    let frame_light = framed * photo / (FRAME_REFLECTANCE * frame.mean.xyz);
    var relight_filter = shining / max(max(photo_light, vec3<f32>(LEAST_PHOTO_LIGHT)), frame_light);
    if (totals[0].w <= 0.0) { relight_filter = frame.ambient.xyz; }
    var result = relight_filter * photo;
    result += emission.w * (emission.xyz - result);
    image[pixel] = vec4<f32>(result, emission.w);
}

// Mean of the view through a pane, held below white.
fn view_light(sent: vec3<f32>, mean: vec3<f32>) -> vec3<f32> {
    let light = PANE_SHARE * sent;
    let white = max(mean, vec3<f32>(PANE_WHITE));
    return select(white * (1.0 - 0.5 * exp(1.0 - 2.0 * light / white)), light, 2.0 * light < white);
}

// Brightness of a pixel, or of one beside it: a lamp's rim is mixed with what lies behind.
fn brightest_near(pixel: vec2<u32>) -> f32 {
    let rim = vec2<u32>((SIZE.x + RIM_WIDTH - 1u) / RIM_WIDTH);
    let low = pixel - min(pixel, rim);
    let high = min(pixel + rim, SIZE - 1u);
    var found = 0.0;
    for (var y = low.y; y <= high.y; y++) {
        for (var x = low.x; x <= high.x; x++) {
            let photo = to_linear(load(picture[y * SIZE.x + x]).xyz);
            found = max(found, min(photo.x, min(photo.y, photo.z)));
        }
    }
    return found;
}

// How far the pixel belongs to the frame or the bars of a window, after `emission_at`; 0 where any shines on.
var<private> framed: f32;

// What panes and lamps send from a pixel, and how far it belongs to one: `hyjax.light.emission`. Of each pane there
// are centre, right, up, sent, kept, mean and bars; of each lamp position with radius, sent and kept.
fn emission_at(pixel: vec2<u32>, photo: vec3<f32>, own_depth: f32, shining: vec3<f32>) -> vec4<f32> {
    let ray = ray_of_pixel(frame, pixel);
    let depth = select(1e30, own_depth, own_depth > 0.0);
    let width = 1.0 / frame.intrinsics.x;
    let darkest = min(photo.x, min(photo.y, photo.z));
    let hole = frame.counts.w == 1u && own_depth <= 0.0; // of the mesh, which has no glass
    var weight = 0.0;
    var shown = 1.0; // of the weight
    var sent = vec3<f32>(0.0);
    var shines_on = false;
    framed = 0.0;
    for (var k = 0u; k < frame.counts.y; k++) {
        let center = emitters[PANE * k].xyz;
        let right = emitters[PANE * k + 1u].xyz;
        let up = emitters[PANE * k + 2u].xyz;
        let normal = cross(right, up);
        let slope = dot(ray, normal);
        let distance = dot(center - frame.origin.xyz, normal) / select(1e-9, slope, abs(slope) > 1e-9);
        let place = frame.origin.xyz + distance * ray - center;
        let axes = mat2x3<f32>(normalize(right), normalize(up));
        let at_pane = place * axes;
        let opening = min(length(right) - abs(at_pane.x), length(up) - abs(at_pane.y));
        var inside = opening;
        let recess = emitters[PANE * k + PANE - 1u].x * length(normal) / select(1e9, -slope, slope < -1e-9);
        let at = (place + recess * ray) * axes;
        for (var bar = 6u; bar < PANE - 1u; bar++) {
            let own = emitters[PANE * k + bar];
            inside = min(inside, min(abs(at.x - own.x) - own.y, abs(at.y - own.z) - own.w));
        }
        let mean = emitters[PANE * k + 5u].xyz;
        let lit = smoothstep(PANE_UNLIT, PANE_LIT, min(mean.x, min(mean.y, mean.z)));
        let dark = select(1.0 - smoothstep(PANE_UNLIT, PANE_LIT, darkest), 0.0, own_depth > 0.0);
        let kept = emitters[PANE * k + 4u].xyz;
        shines_on = shines_on || any(kept != vec3<f32>(0.0));
        let free = distance > 0.0 && slope < 0.0 && depth > distance - SLACK;
        let shares = select(vec2<f32>(0.0), clamp(vec2<f32>(inside, opening) / (width * max(distance, 1e-3)) + 0.5, vec2<f32>(0.0), vec2<f32>(1.0)), free);
        framed = max(framed, shares.y - shares.x);
        let cover = shares.x * select(mix(dark, smoothstep(0.1, 0.3, darkest), lit), 1.0, hole);
        if (cover > 0.0 && cover >= weight) {
            weight = cover;
            let pane = select(photo, mean, hole);
            let pattern = mix(vec3<f32>(1.0), pane / max(mean, vec3<f32>(1e-3)), lit);
            sent = view_light(emitters[PANE * k + 3u].xyz * frame.mean.xyz, mean) * pattern + kept * pane
                + PANE_REFLECTANCE * frame.mean.xyz * max(1.0 - kept, vec3<f32>(0.0)) * shining;
        }
    }
    if (shines_on || frame.counts.w == 1u) { framed = 0.0; }
    for (var k = 0u; k < frame.counts.z; k++) {
        let first = PANE * frame.counts.y + 3u * k;
        let radius = emitters[first].w;
        let toward = emitters[first].xyz - frame.origin.xyz;
        let along = dot(toward, ray) / dot(ray, ray);
        let away = sqrt(max(dot(toward, toward) - along * along * dot(ray, ray), 1e-12));
        var cover = clamp((1.5 * radius - away) / (width * max(along, 1e-3)) + 0.5, 0.0, 1.0);
        if (along <= 0.0 || depth <= along - 2.0 * radius - SLACK) { cover = 0.0; }
        if (cover > 0.0) { cover *= smoothstep(LAMP_DARK, LAMP_BRIGHT, brightest_near(pixel)); }
        if (cover > 0.0 && cover >= weight) {
            weight = cover;
            let kept = emitters[first + 2u].xyz;
            let light = emitters[first + 1u].xyz * frame.mean.xyz;
            let burnt = smoothstep(LAMP_DARK, LAMP_BRIGHT, darkest);
            let off = clamp(1.0 - max(kept.x, max(kept.y, kept.z)), 0.0, 1.0);
            let lit = off * clamp(max(light.x, max(light.y, light.z)), 0.0, 1.0);
            shown = mix(1.0, burnt, lit); // if it goes on, the photo's soft rim
            let white = min(light, vec3<f32>(WHITE));
            sent = white + (light - white) * pow(burnt, CORE_EXPONENT) + kept * photo
                + LAMP_REFLECTANCE * frame.mean.xyz * max(1.0 - kept, vec3<f32>(0.0)) * shining;
        }
    }
    return vec4<f32>(sent, weight * shown);
}
