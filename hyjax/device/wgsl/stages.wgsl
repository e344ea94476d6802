// Filters of a frame to look at: raw, refined without shadows, what shadows leave, raw with shadows; plane after plane.
@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> lights: array<Light>;
@group(0) @binding(2) var<storage, read> raw: array<Stored>;
@group(0) @binding(3) var<storage, read> refined: array<Stored>;
@group(0) @binding(4) var<storage, read> totals: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> raw_visibility: array<Stored>; // weighted values, then weights
@group(0) @binding(6) var<storage, read> visibility: array<Stored>;
@group(0) @binding(7) var<storage, read_write> stages: array<vec4<f32>>;


@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= SIZE)) { return; }
    let pixel = id.y * SIZE.x + id.x;
    let plane = SIZE.x * SIZE.y;
    let groups = (frame.counts.x + 3u) / 4u;
    let own = load(refined[pixel]);
    let weight = vec4<f32>(own.w);
    let total_weight = vec4<f32>(totals[0].w);
    let thrown = load(raw[pixel]).xyz;
    let bounced = completed(own, weight, totals[0], total_weight).xyz;
    var filters = array<vec3<f32>, 4>(thrown, bounced, bounced, thrown);
    for (var group = 0u; group < groups; group++) {
        let at = (2u + group) * plane + pixel;
        let before = load(raw[at]);
        let after = completed(load(refined[at]), weight, totals[2u + group], total_weight);
        let visible = load(visibility[group * plane + pixel]);
        let seen = load(raw_visibility[($first + group) * plane + pixel]); // nothing where the light does not reach
        for (var k = 0u; k < min(4u, frame.counts.x - 4u * group); k++) {
            let color = lights[4u * group + k].color.xyz;
            filters[0] += before[k] * color;
            filters[1] += after[k] * color;
            filters[2] += after[k] * visible[k] * color;
            filters[3] += before[k] * seen[k] * color;
        }
    }
    let photo_light = completed(load(refined[plane + pixel]), weight, totals[1], total_weight).xyz;
    for (var k = 0u; k < 4u; k++) {
        let after = k == 1u || k == 2u;
        let divisor = select(load(raw[plane + pixel]).xyz, photo_light, after);
        filters[k] /= max(divisor, vec3<f32>(LEAST_PHOTO_LIGHT));
        if (after && totals[0].w <= 0.0) { filters[k] = frame.ambient.xyz; }
    }
    let whole = filters[1] > vec3<f32>(0.0);
    let share = select(vec3<f32>(1.0), filters[2] / select(vec3<f32>(1.0), filters[1], whole), whole);
    stages[pixel] = vec4<f32>(filters[0], 1.0);
    stages[plane + pixel] = vec4<f32>(filters[1], 1.0);
    stages[2u * plane + pixel] = vec4<f32>(share, 1.0);
    stages[3u * plane + pixel] = vec4<f32>(filters[3], 1.0);
}
