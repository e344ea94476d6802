// The camera's picture, display-encoded, as the RGB guide.
@group(0) @binding(0) var photo: texture_2d<f32>;
@group(0) @binding(1) var<storage, read_write> picture: array<Stored>;

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= SIZE)) { return; }
    picture[id.y * SIZE.x + id.x] = store(vec4<f32>(textureLoad(photo, id.xy, 0).xyz, 0.0));
}
