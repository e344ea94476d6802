// A picture in single precision.
@group(0) @binding(0) var<storage, read> picture: array<Stored>;
@group(0) @binding(1) var<storage, read_write> result: array<vec4<f32>>;

const SIZE = vec2<u32>($size); // columns, rows

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= SIZE)) { return; }
    let k = (id.z * SIZE.y + id.y) * SIZE.x + id.x;
    result[k] = load(picture[k]);
}
