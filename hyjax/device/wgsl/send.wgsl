// What each radiator sends back: triangles the mean of their corners, patches their own, openings nothing.
@group(0) @binding(0) var<storage, read> faces: array<u32>;
@group(0) @binding(1) var<storage, read> fields: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> direct: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> indirect: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> sent: array<vec4<f32>>;

const FACES = ${faces}u;
const VERTICES = ${vertices}u;
const POINTS = ${points}u;

fn reflected(k: u32) -> vec3<f32> { return fields[4u * k + 3u].xyz * (direct[k].xyz + indirect[k].xyz); }

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) count: vec3<u32>) {
    let k = id.x + id.y * 64u * count.x;
    var total = vec3<f32>(0.0);
    if (k < FACES) {
        total = (reflected(faces[3u * k]) + reflected(faces[3u * k + 1u]) + reflected(faces[3u * k + 2u])) / 3.0;
    } else if (k < FACES + POINTS - VERTICES) {
        total = reflected(k - FACES + VERTICES);
    } else if (k > FACES + POINTS - VERTICES) {
        return;
    }
    sent[k] = vec4<f32>(total, 0.0);
}
