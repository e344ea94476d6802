// A picture with edges and noise, and light of a wide range on it, by which precisions are compared.
@group(0) @binding(0) var<storage, read_write> guide: array<Stored>;
@group(0) @binding(1) var<storage, read_write> light: array<Stored>;

const SIZE = vec2<u32>($size); // columns, rows

fn noise(k: u32) -> f32 {
    let a = (k ^ (k >> 15u)) * 739982445u;
    let b = (a ^ (a >> 12u)) * 695872825u;
    return f32(b >> 8u) / 16777216.0;
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= SIZE)) { return; }
    let pixel = id.y * SIZE.x + id.x;
    let side = select(0.2, 0.8, (id.x / 24u + id.y / 20u) % 2u == 1u);
    if (id.z == 0u) { guide[pixel] = store(vec4<f32>(vec3<f32>(side, 1.0 - side, 0.5) + 0.05 * noise(pixel), 0.0)); }
    let strength = exp2(8.0 * noise(7919u * id.z + pixel / 5u) - 6.0);
    light[id.z * SIZE.x * SIZE.y + pixel] = store(strength * vec4<f32>(side, 1.0, 0.3, 1.0));
}
