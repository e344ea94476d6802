// The camera, and what all passes over a frame need to know.
struct Frame {
    right: vec4<f32>,   // camera axes in the world: x to the right, y down, z forward
    down: vec4<f32>,
    forward: vec4<f32>,
    origin: vec4<f32>,
    intrinsics: vec4<f32>, // fx, fy, cx, cy in pixels
    counts: vec4<u32>,     // lights, panes, lamps, whether the frame is the mesh's own albedo
    ambient: vec4<f32>,    // filter where nothing of the frame is known; 1 / reference illuminance
    mean: vec4<f32>,       // mean light of the photos, see `PhotoLight.mean`
}
