// Lights: what they throw on a surface. The mirror of `hyjax.light.kinds`; `hyjax.device.light_records` fills the
// records.
struct Light {
    kind: u32,        // 0 ambient, 1 point, 2 spot, 3 rect, 4 directional, 5 sky
    views: u32,       // of its shadow map; 0 for no shadows
    size: u32,        // texels a side of each view, without gutter
    start: u32,       // of its views in `depths`
    position: vec4<f32>,   // also a rectangle's centre; radius of a bulb, or angular radius of a disc
    direction: vec4<f32>,  // unit; of a sky, up; clearance
    right: vec4<f32>,      // half-axis of a rectangle or of an aperture; cosine of the inner angle
    up: vec4<f32>,         // likewise; cosine of the outer angle
    color: vec4<f32>,      // linear; strength: lumen or lux
    bounds: vec4<f32>,     // centre of the mesh and half its diagonal, which parallel rays cover
    // Slack, or -1; whether there is an aperture; width of a texel, metres for orthographic maps, else metres at one
    // metre's distance; its first view in `views`.
    shadow: vec4<f32>,
}

const PI = 3.14159265358979;

const POINT = 1u;
const SPOT = 2u;
const RECT = 3u;
const DIRECTIONAL = 4u;
const SKY = 5u;
const WIDEST_PERSPECTIVE = 0.5; // cosine; wider spots have hemisphere maps
const OCTAHEDRAL = 0u;
const HEMISPHERE = 1u;
const PERSPECTIVE = 2u;
const ORTHOGRAPHIC = 3u;

fn projection_of(light: Light) -> u32 {
    switch light.kind {
        case POINT: { return OCTAHEDRAL; }
        case SPOT: { return select(PERSPECTIVE, HEMISPHERE, light.up.w < WIDEST_PERSPECTIVE); }
        case RECT: { return HEMISPHERE; }
        default: { return ORTHOGRAPHIC; }
    }
}

// Tangent of a spot's half angle with a margin: sources of a wide lamp see the rim of the cone from aside.
fn spread_of(light: Light) -> f32 {
    let c = light.up.w;
    return 1.05 * sqrt(1.0 - c * c) / c;
}

// Metres that an orthographic map reaches from its middle.
fn reach_of(light: Light) -> f32 {
    if (light.shadow.y > 0.0) { return 1.02 * length(vec2<f32>(length(light.right.xyz), length(light.up.xyz))); }
    return light.bounds.w;
}

fn fold(p: vec2<f32>) -> vec2<f32> { return (1.0 - abs(p.yx)) * select(vec2<f32>(1.0), vec2<f32>(-1.0), p < vec2<f32>(0.0)); }

// Clamped cosine, 1/r^2 and unit vector to the light, for light from a point.
struct Incidence { cosine: f32, inverse_square: f32, to_light: vec3<f32> }

fn incidence(at: vec3<f32>, p: vec3<f32>, n: vec3<f32>) -> Incidence {
    let offset = at - p;
    let inverse_square = 1.0 / (dot(offset, offset) + 1e-12);
    let to_light = offset * sqrt(inverse_square);
    return Incidence(max(dot(to_light, n), 0.0), inverse_square, to_light);
}

fn edge_integral(a: vec3<f32>, b: vec3<f32>, n: vec3<f32>) -> f32 {
    let normal = cross(a, b);
    let sine = sqrt(dot(normal, normal) + 1e-24);
    return atan2(sine, dot(a, b)) * dot(normal, n) / sine;
}

// Share of the hemisphere, cosine-weighted, that a rectangle fills: `hyjax.light.kinds.polygon`.
fn form_factor(light: Light, p: vec3<f32>, n: vec3<f32>) -> f32 {
    var corners = array<vec3<f32>, 4>(
        light.position.xyz - light.right.xyz - light.up.xyz - p,
        light.position.xyz + light.right.xyz - light.up.xyz - p,
        light.position.xyz + light.right.xyz + light.up.xyz - p,
        light.position.xyz - light.right.xyz + light.up.xyz - p,
    );
    var total = 0.0;
    var sinks = vec3<f32>(0.0);
    var rises = vec3<f32>(0.0);
    var above = false;
    var below = false;
    for (var k = 0u; k < 4u; k++) {
        let a = corners[k];
        let b = corners[(k + 1u) % 4u];
        let ha = dot(a, n);
        let hb = dot(b, n);
        above = above || ha > 0.0;
        below = below || ha <= 0.0;
        let crosses = (ha > 0.0) != (hb > 0.0);
        let horizon = a + select(0.0, ha / (ha - hb), crosses) * (b - a);
        if (ha > 0.0 || hb > 0.0) {
            total += edge_integral(select(horizon, a, ha > 0.0), select(horizon, b, hb > 0.0), n);
        }
        if (crosses && ha > 0.0) { sinks = horizon; }
        if (crosses && hb > 0.0) { rises = horizon; }
    }
    if (above && below) { total += edge_integral(sinks, rises, n); }
    return abs(total) / (2.0 * PI);
}

// Lux without shadows, before the colour.
fn illuminance_at(light: Light, p: vec3<f32>, n: vec3<f32>) -> f32 {
    let strength = light.color.w;
    switch light.kind {
        case POINT: {
            let i = incidence(light.position.xyz, p, n);
            return strength / (4.0 * PI) * i.cosine * i.inverse_square;
        }
        case SPOT: {
            let i = incidence(light.position.xyz, p, n);
            let inner = light.right.w;
            let outer = light.up.w;
            let t = clamp((dot(-i.to_light, light.direction.xyz) - outer) / max(inner - outer, 1e-6), 0.0, 1.0);
            let peak = strength / (2.0 * PI * (1.0 - 0.5 * (inner + outer)));
            return peak * t * t * (3.0 - 2.0 * t) * i.cosine * i.inverse_square;
        }
        case RECT: {
            let normal = cross(light.right.xyz, light.up.xyz);
            if (dot(p - light.position.xyz, normal) <= 0.0) { return 0.0; }
            return form_factor(light, p, n) * strength / (4.0 * length(normal));
        }
        case DIRECTIONAL: { return strength * max(dot(-n, light.direction.xyz), 0.0); }
        case SKY: { return strength * 0.5 * (1.0 + dot(n, light.direction.xyz)); }
        default: { return strength; }
    }
}
