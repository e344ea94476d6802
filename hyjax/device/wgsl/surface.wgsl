// The surface that each pixel shows: `hyjax.geometry.raycast.RayCaster.gbuffer`, and the light that lies on it.
// Of each vertex, `fields` holds position, normal, the photo's own light and albedo.
const HOLE = 0.35;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var shown: texture_2d<u32>;
@group(0) @binding(2) var<storage, read> faces: array<u32>;
@group(0) @binding(3) var<storage, read> fields: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> bounced: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> surface: array<vec4<f32>>; // normal, depth; 0 where there is none
@group(0) @binding(6) var<storage, read_write> light: array<Stored>; // bounced light, weight; photo's light
@group(0) @binding(7) var<storage, read_write> picture: array<Stored>;

fn mixed(field: u32, corners: vec3<u32>, weights: vec3<f32>) -> vec3<f32> {
    return weights.x * fields[4u * corners.x + field].xyz + weights.y * fields[4u * corners.y + field].xyz
        + weights.z * fields[4u * corners.z + field].xyz;
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= SIZE)) { return; }
    let pixel = id.y * SIZE.x + id.x;
    let plane = SIZE.x * SIZE.y;
    let face = textureLoad(shown, id.xy, 0).x;
    if (face == 0u) {
        surface[pixel] = vec4<f32>(0.0);
        light[pixel] = store(vec4<f32>(0.0));
        light[plane + pixel] = store(vec4<f32>(0.0));
        // Off the photos, holes of the mesh are grey, not black.
        if (frame.counts.w == 1u) { picture[pixel] = store(vec4<f32>(to_display(HOLE * frame.mean.xyz), 0.0)); }
        return;
    }
    let corners = vec3<u32>(faces[3u * face - 3u], faces[3u * face - 2u], faces[3u * face - 1u]);
    let ray = ray_of_pixel(frame, id.xy);
    let a = fields[4u * corners.x].xyz;
    let e = fields[4u * corners.y].xyz - a;
    let f = fields[4u * corners.z].xyz - a;
    let s = frame.origin.xyz - a;
    let p = cross(ray, f);
    let q = cross(s, e);
    let determinant = dot(e, p);
    let scale = select(1.0 / determinant, 0.0, determinant == 0.0);
    let u = clamp(dot(s, p) * scale, 0.0, 1.0);
    let v = clamp(dot(ray, q) * scale, 0.0, 1.0 - u);
    let weights = vec3<f32>(1.0 - u - v, u, v);
    let depth = dot(f, q) * scale;
    // The triangle decides which side is seen; a smooth normal may lean a little away from the camera.
    var normal = mixed(1u, corners, weights);
    let flat_normal = cross(e, f);
    if ((dot(flat_normal, ray) > 0.0) != (dot(flat_normal, normal) < 0.0)) { normal = -normal; }
    let length = sqrt(dot(normal, normal));
    normal = select(vec3<f32>(0.0), normal / length, length > 0.0);
    surface[pixel] = vec4<f32>(normal, depth);
    let thrown = weights.x * bounced[corners.x].xyz + weights.y * bounced[corners.y].xyz + weights.z * bounced[corners.z].xyz;
    let photo = mixed(2u, corners, weights);
    light[pixel] = store(vec4<f32>(thrown, 1.0));
    light[plane + pixel] = store(vec4<f32>(photo, 0.0));
    // Off the photos the mesh is shown as if it had been photographed: albedo times the photo's light.
    if (frame.counts.w == 1u) {
        picture[pixel] = store(vec4<f32>(to_display(mixed(3u, corners, weights) * photo * frame.mean.xyz), 0.0));
    }
}
