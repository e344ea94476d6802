// Shadow maps by casting rays: `hyjax.geometry.shadow_caster`. One layer of the launch is one view.
@group(0) @binding(3) var<storage, read> lights: array<Light>;
@group(0) @binding(4) var<storage, read> jobs: array<vec4<u32>>; // light, view
@group(0) @binding(5) var<storage, read_write> depths: array<f32>;
@group(0) @binding(6) var<storage, read> views: array<vec4<f32>>;

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let light = lights[jobs[id.z].x];
    let k = jobs[id.z].y;
    let side = light.size + 2u;
    if (any(id.xy >= vec2<u32>(side))) { return; }
    let uv = (2.0 * (vec2<f32>(id.xy) - 1.0) + 1.0) / f32(light.size) - 1.0;
    let view = view_of(light, k);
    var depth = 0.0;
    switch projection_of(light) {
        case ORTHOGRAPHIC: {
            let plane = reach_of(light) * (uv.x * view.axes[0] + uv.y * view.axes[1]);
            if (light.shadow.y > 0.0) {
                // Rays start in the opening; beside it no light does.
                let normal = cross(light.right.xyz, light.up.xyz);
                let to_opening = -dot(plane, normal) / dot(view.axes[2], normal);
                let start = plane + to_opening * view.axes[2];
                let inside = abs(dot(start, light.right.xyz)) <= dot(light.right.xyz, light.right.xyz)
                    && abs(dot(start, light.up.xyz)) <= dot(light.up.xyz, light.up.xyz);
                depth = -FAR;
                if (inside) { depth = to_opening + cast_ray(view.origin + start, view.axes[2]); }
            } else {
                depth = cast_ray(view.origin + plane, view.axes[2]);
            }
        }
        case PERSPECTIVE: {
            let ray = view.axes * vec3<f32>(uv * spread_of(light), 1.0);
            depth = light.direction.w + cast_ray(view.origin + light.direction.w * ray, ray);
        }
        default: {
            let ray = view.axes * ray_of(uv, projection_of(light));
            depth = light.direction.w + cast_ray(view.origin + light.direction.w * ray, ray);
        }
    }
    depths[light.start + k * side * side + id.y * side + id.x] = depth;
}

// Direction of a ray by its map coordinates; those outside the square continue the map.
fn ray_of(uv: vec2<f32>, projection: u32) -> vec3<f32> {
    if (projection == HEMISPHERE) {
        let p = 0.5 * vec2<f32>(uv.x + uv.y, uv.x - uv.y);
        return normalize(vec3<f32>(p, 1.0 - abs(p.x) - abs(p.y)));
    }
    var p = uv;
    if (abs(uv.x) > 1.0) { p = vec2<f32>(2.0 * sign(uv.x) - uv.x, -uv.y); }
    if (abs(p.y) > 1.0) { p = vec2<f32>(-p.x, 2.0 * sign(p.y) - p.y); }
    let z = 1.0 - abs(p.x) - abs(p.y);
    return normalize(vec3<f32>(select(p, fold(p), z < 0.0), z));
}
