// Light of four lights on each pixel without shadows, over the reference illuminance, and what shadows leave of it.
@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> lights: array<Light>;
@group(0) @binding(2) var<storage, read> depths: array<f32>;
@group(0) @binding(3) var<storage, read> positions: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> normals: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> light: array<Stored>;      // after two groups of the surface's own
@group(0) @binding(6) var<storage, read_write> visibility: array<Stored>; // weighted values, then weights

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) count: vec3<u32>) {
    if (any(id.xy >= SIZE)) { return; }
    let pixel = id.y * SIZE.x + id.x;
    let plane = SIZE.x * SIZE.y;
    var each = vec4<f32>(0.0);
    var visible = vec4<f32>(0.0);
    let n = normals[pixel];
    if (n.w > 0.0) {
        let p = positions[pixel].xyz;
        for (var k = 0u; k < min(4u, frame.counts.x - 4u * id.z); k++) {
            let own = lights[4u * id.z + k];
            let lux = illuminance_at(own, p, n.xyz);
            each[k] = lux * frame.ambient.w;
            if (lux > 0.0) { visible[k] = visibility_at(own, p, n.xyz); }
        }
    }
    let known = select(vec4<f32>(0.0), vec4<f32>(1.0), each > vec4<f32>(0.0));
    light[(2u + id.z) * plane + pixel] = store(each);
    visibility[id.z * plane + pixel] = store(visible * known);
    visibility[(id.z + count.z) * plane + pixel] = store(known);
}
