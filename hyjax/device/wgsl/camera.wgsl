// Rays of the camera's pixels.
const SIZE = vec2<u32>($size); // columns, rows

fn ray_of_pixel(frame: Frame, pixel: vec2<u32>) -> vec3<f32> { // of unit depth
    let local = (vec2<f32>(pixel) + 0.5 - frame.intrinsics.zw) / frame.intrinsics.xy;
    return local.x * frame.right.xyz + local.y * frame.down.xyz + frame.forward.xyz;
}
