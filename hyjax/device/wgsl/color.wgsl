// The sRGB curve: `hyjax.light.color`.
fn to_linear(display: vec3<f32>) -> vec3<f32> {
    let power = pow((max(display, vec3<f32>(0.04045)) + 0.055) / 1.055, vec3<f32>(2.4));
    return select(power, display / 12.92, display <= vec3<f32>(0.04045));
}

fn to_display(linear: vec3<f32>) -> vec3<f32> {
    let power = 1.055 * pow(clamp(linear, vec3<f32>(0.0031308), vec3<f32>(1.0)), vec3<f32>(1.0 / 2.4)) - 0.055;
    return select(power, max(linear, vec3<f32>(0.0)) * 12.92, linear <= vec3<f32>(0.0031308));
}
