// The curve of sRGB and the shoulder of bright light: `hyjax.light.color`.
const SHOULDER = 0.7;
const WHITE = 1.2;
const WIDTH = (WHITE - SHOULDER) / (1.0 - SHOULDER);

fn to_linear(display: vec3<f32>) -> vec3<f32> {
    let power = pow((max(display, vec3<f32>(0.04045)) + 0.055) / 1.055, vec3<f32>(2.4));
    return released(select(power, display / 12.92, display <= vec3<f32>(0.04045)));
}

fn to_display(linear: vec3<f32>) -> vec3<f32> {
    return encoded(held(linear));
}

// sRGB's encoding alone, for filters.
fn encoded(linear: vec3<f32>) -> vec3<f32> {
    return unclipped(clamp(linear, vec3<f32>(0.0), vec3<f32>(1.0)));
}

// The same, which goes on beyond white.
fn unclipped(linear: vec3<f32>) -> vec3<f32> {
    let power = 1.055 * pow(max(linear, vec3<f32>(0.0031308)), vec3<f32>(1.0 / 2.4)) - 0.055;
    return select(power, max(linear, vec3<f32>(0.0)) * 12.92, linear <= vec3<f32>(0.0031308));
}

fn held(linear: vec3<f32>) -> vec3<f32> {
    let t = (clamp(linear, vec3<f32>(SHOULDER), vec3<f32>(WHITE)) - SHOULDER) / (1.0 - SHOULDER);
    let shoulder = SHOULDER + (1.0 - SHOULDER) * t * (1.0 + t / (WIDTH * WIDTH)) / (1.0 + t);
    return select(shoulder + max(linear - WHITE, vec3<f32>(0.0)), linear, linear <= vec3<f32>(SHOULDER));
}

fn released(held_light: vec3<f32>) -> vec3<f32> {
    let y = (clamp(held_light, vec3<f32>(SHOULDER), vec3<f32>(1.0)) - SHOULDER) / (1.0 - SHOULDER);
    let t = 2.0 * y / (1.0 - y + sqrt((1.0 - y) * (1.0 - y) + 4.0 / (WIDTH * WIDTH) * y));
    return select(SHOULDER + (1.0 - SHOULDER) * t, held_light, held_light <= vec3<f32>(SHOULDER));
}
