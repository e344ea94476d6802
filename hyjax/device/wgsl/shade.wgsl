// Light of four lights on each pixel without shadows, over the reference illuminance, and what shadows leave of it.
@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> lights: array<Light>;
@group(0) @binding(2) var<storage, read> depths: array<f32>;
@group(0) @binding(3) var<storage, read> surface: array<vec4<f32>>; // normal, depth
@group(0) @binding(4) var<storage, read_write> light: array<Stored>;      // after two groups of the surface's own
@group(0) @binding(5) var<storage, read> views: array<vec4<f32>>;
$visibility_binding

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) count: vec3<u32>) {
    if (any(id.xy >= SIZE)) { return; }
    let pixel = id.y * SIZE.x + id.x;
    let plane = SIZE.x * SIZE.y;
    var each = vec4<f32>(0.0);
    var visible = vec4<f32>(0.0);
    let own_surface = surface[pixel];
    if (own_surface.w > 0.0) {
        let n = own_surface.xyz;
        let p = frame.origin.xyz + own_surface.w * ray_of_pixel(frame, id.xy);
        for (var k = 0u; k < min(4u, frame.counts.x - 4u * id.z); k++) {
            let own = lights[4u * id.z + k];
            let lux = illuminance_at(own, p, n);
            each[k] = lux * frame.ambient.w;
            if (lux > 0.0) { visible[k] = visibility_at(own, p, n); }
        }
    }
    let known = select(vec4<f32>(0.0), vec4<f32>(1.0), each > vec4<f32>(0.0));
    light[(2u + id.z) * plane + pixel] = store(each);
    // Weighted values, then weights.
    let first = $first + id.z;
    $visibility[first * plane + pixel] = store(visible * known);
    $visibility[(first + count.z) * plane + pixel] = store(known);
}
