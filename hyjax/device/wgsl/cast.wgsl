// Ray parameter at which a ray enters a box; FAR if it does not before `limit`.
fn enter(node: u32, origin: vec3<f32>, inverse: vec3<f32>, limit: f32) -> f32 {
    let corner = boxes[2u * node].xyz;
    let opposite = boxes[2u * node + 1u].xyz;
    if (corner.x > opposite.x) { return FAR; } // of no triangle
    let a = (corner - origin) * inverse;
    let b = (opposite - origin) * inverse;
    let low = min(a, b);
    let high = max(a, b);
    let first = max(max(low.x, low.y), max(low.z, 0.0));
    let last = min(min(high.x, high.y), min(high.z, limit)) * 1.0000004;
    return select(FAR, first, first <= last);
}

// Möller and Trumbore, 1997, with a hair's breadth around each triangle so that no ray slips through an edge.
fn meet(face: u32, origin: vec3<f32>, direction: vec3<f32>) -> f32 {
    let a = vertex(faces[3u * face]);
    let e = vertex(faces[3u * face + 1u]) - a;
    let f = vertex(faces[3u * face + 2u]) - a;
    let p = cross(direction, f);
    let determinant = dot(e, p);
    if (determinant == 0.0) { return FAR; }
    let s = origin - a;
    let u = dot(s, p) / determinant;
    let q = cross(s, e);
    let v = dot(direction, q) / determinant;
    let t = dot(f, q) / determinant;
    let inside = u >= -1e-6 && v >= -1e-6 && u + v <= 1.000001;
    return select(FAR, t, inside && t > 0.0);
}

// Ray parameter of the nearest hit; FAR for none.
fn cast_ray(origin: vec3<f32>, direction: vec3<f32>) -> f32 {
    let small = abs(direction) < vec3<f32>(1e-12);
    let inverse = 1.0 / select(direction, vec3<f32>(1e-12), small);
    var stack: array<u32, 32>;
    var height = 0u;
    var nearest = FAR;
    var node = 0u;
    if (enter(0u, origin, inverse, FAR) >= FAR) { return FAR; }
    loop {
        if (node >= LEAVES - 1u) {
            let first = (node - (LEAVES - 1u)) * LEAF;
            for (var face = first; face < min(first + LEAF, FACES); face++) {
                nearest = min(nearest, meet(face, origin, direction));
            }
        } else {
            let left = enter(2u * node + 1u, origin, inverse, nearest);
            let right = enter(2u * node + 2u, origin, inverse, nearest);
            let nearer = 2u * node + select(1u, 2u, right < left);
            if (min(left, right) < FAR) {
                if (max(left, right) < FAR) {
                    stack[height] = 4u * node + 3u - nearer;
                    height++;
                }
                node = nearer;
                continue;
            }
        }
        // Back to the last child that was put off, unless something nearer was met since.
        var found = false;
        while (height > 0u && !found) {
            height--;
            node = stack[height];
            found = enter(node, origin, inverse, nearest) < FAR;
        }
        if (!found) { break; }
    }
    return nearest;
}
