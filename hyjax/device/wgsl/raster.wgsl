// Which triangle each pixel shows: its number plus one. No culling: a scan has two sides.
@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> faces: array<u32>;
@group(0) @binding(2) var<storage, read> fields: array<vec4<f32>>;

const NEAR = 0.01; // metres

struct Corner { @builtin(position) place: vec4<f32>, @location(0) @interpolate(flat) face: u32 }

@vertex
fn vertex(@builtin(vertex_index) k: u32) -> Corner {
    let away = fields[4u * faces[k]].xyz - frame.origin.xyz;
    let local = vec3<f32>(dot(away, frame.right.xyz), dot(away, frame.down.xyz), dot(away, frame.forward.xyz));
    let pixel = frame.intrinsics.xy * local.xy + frame.intrinsics.zw * local.z;
    let place = 2.0 * pixel / vec2<f32>(SIZE) - local.z;
    return Corner(vec4<f32>(place.x, -place.y, NEAR, local.z), k / 3u + 1u); // depth is NEAR / z: greater is nearer
}

@fragment
fn fragment(corner: Corner) -> @location(0) u32 { return corner.face; }
