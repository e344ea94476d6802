// Boxes of one depth of the tree; depths are done from the leaves up.
@group(0) @binding(3) var<uniform> depth: vec4<u32>; // first node, number of nodes

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) count: vec3<u32>) {
    let k = id.x + id.y * 64u * count.x;
    if (k >= depth.y) { return; }
    let node = depth.x + k;
    var low = vec3<f32>(FAR);
    var high = vec3<f32>(-FAR);
    if (node >= LEAVES - 1u) {
        let first = (node - (LEAVES - 1u)) * LEAF;
        for (var face = first; face < min(first + LEAF, FACES); face++) {
            for (var corner = 0u; corner < 3u; corner++) {
                let p = vertex(faces[3u * face + corner]);
                low = min(low, p);
                high = max(high, p);
            }
        }
    } else {
        for (var child = 2u * node + 1u; child <= 2u * node + 2u; child++) {
            low = min(low, boxes[2u * child].xyz);
            high = max(high, boxes[2u * child + 1u].xyz);
        }
    }
    boxes[2u * node] = vec4<f32>(low, 0.0);
    boxes[2u * node + 1u] = vec4<f32>(high, 0.0);
}
