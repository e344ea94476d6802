// Light straight from the lights on the points of the transport: vertices, and patches that close the scan.
@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> lights: array<Light>;
@group(0) @binding(2) var<storage, read> depths: array<f32>;
@group(0) @binding(3) var<storage, read> fields: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> direct: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> indirect: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> views: array<vec4<f32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= ${points}u) { return; }
    let p = fields[4u * id.x].xyz;
    let n = fields[4u * id.x + 1u].xyz;
    var total = vec3<f32>(0.0);
    for (var k = 0u; k < frame.counts.x; k++) {
        let own = lights[k];
        if (own.kind == 0u) { continue; } // bounces stand in for light that falls on any surface alike
        let lux = illuminance_at(own, p, n);
        if (lux > 0.0) { total += lux * frame.ambient.w * visibility_at(own, p, n) * own.color.xyz; }
    }
    direct[id.x] = vec4<f32>(total, 0.0);
    indirect[id.x] = vec4<f32>(0.0);
}
