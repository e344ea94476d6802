// What is known of a picture, completed: `hyjax.core.refine.cascade_known` after its cascade.
// (weight x value, weight) are diffused, then divided; far from anything known stands the mean of all that is.
const HOLE_FLOOR = 1e-3;
const TINY = 1e-12;
const LEAST_PHOTO_LIGHT = 0.05; // `hyjax.light.photo_light`: what divides is no less

fn completed(value: vec4<f32>, weight: vec4<f32>, total: vec4<f32>, total_weight: vec4<f32>) -> vec4<f32> {
    let floor_weight = max(HOLE_FLOOR * (1.0 - weight), vec4<f32>(0.0));
    let divisor = weight + floor_weight;
    let mean = total / max(total_weight, vec4<f32>(TINY));
    return (value + floor_weight * mean) / select(vec4<f32>(1.0), divisor, divisor > vec4<f32>(0.0));
}
