// Share of a light that shadows leave: `hyjax.light.shadow_map.visibility`. Needs `depths` and `views`.
fn visibility_at(light: Light, p: vec3<f32>, n: vec3<f32>) -> f32 {
    if (light.views == 0u) { return 1.0; }
    let projection = projection_of(light);
    let texel_at_one = light.shadow.z;
    let across = cross(light.right.xyz, light.up.xyz);
    let side = light.size + 2u;
    var lit = 0.0;
    var total = 0.0;
    for (var k = 0u; k < light.views; k++) {
        let view = view_of(light, k);
        let offset = view.origin - p;
        var squared = 1.0;
        var to_light = -view.axes[2];
        var texel = texel_at_one;
        if (projection != ORTHOGRAPHIC) {
            squared = dot(offset, offset) + 1e-12;
            to_light = offset * inverseSqrt(squared);
            texel *= sqrt(squared);
        }
        let cosine = clamp(dot(n, to_light), 0.0, 1.0);
        var weight = cosine / squared;
        if (light.kind == RECT) { weight *= max(-dot(to_light, across), 0.0); }
        if (weight <= 0.0) { continue; }
        let sine = sqrt(max(1.0 - cosine * cosine, 1e-12));
        var bias = texel;
        if (light.shadow.x >= 0.0) { bias += light.shadow.x / max(cosine, 0.35); }
        let local = (n * (2.0 * texel * sine) - offset) * view.axes; // in the view's axes
        lit += weight * compared(light, k, side, map_place(light, projection, local), bias);
        total += weight;
    }
    if (total <= 0.0) { return 1.0; }
    if (light.shadow.y > 0.0 && dot(p - light.position.xyz, across) * dot(light.direction.xyz, across) <= 0.0) { return 0.0; }
    return lit / total;
}

// Map coordinates and distance along the map's rays.
fn map_place(light: Light, projection: u32, local: vec3<f32>) -> vec3<f32> {
    if (projection == ORTHOGRAPHIC) { return vec3<f32>(local.xy / reach_of(light), local.z); }
    if (projection == PERSPECTIVE) {
        let depth = max(local.z, 1e-6);
        return vec3<f32>(local.xy / (spread_of(light) * depth), depth);
    }
    let p = local.xy / (abs(local.x) + abs(local.y) + abs(local.z) + 1e-12);
    let distance = sqrt(dot(local, local) + 1e-12);
    if (projection == HEMISPHERE) { return vec3<f32>(p.x + p.y, p.x - p.y, distance); }
    return vec3<f32>(select(p, fold(p), local.z < 0.0), distance);
}

// Fraction of the 2 x 2 nearest texels, bilinearly weighted, that are no nearer than a point.
fn compared(light: Light, k: u32, side: u32, place: vec3<f32>, bias: f32) -> f32 {
    let t = clamp((place.xy + 1.0) * (0.5 * f32(light.size)) + 0.5, vec2<f32>(0.0), vec2<f32>(f32(side) - 1.001));
    let cell = vec2<u32>(t);
    let share = t - vec2<f32>(cell);
    let corner = light.start + k * side * side + cell.y * side + cell.x;
    let distance = place.z - bias;
    let upper = mix(f32(distance <= depths[corner]), f32(distance <= depths[corner + 1u]), share.x);
    let lower = mix(f32(distance <= depths[corner + side]), f32(distance <= depths[corner + side + 1u]), share.x);
    return mix(upper, lower, share.y);
}
