// Views of the lights' shadow maps, as the host has worked them out. Needs `views`: of each, origin and three axes.
struct View {
    origin: vec3<f32>,
    axes: mat3x3<f32>, // columns are the view's axes, unit
}

fn view_of(light: Light, k: u32) -> View {
    let at = 4u * (u32(light.shadow.w) + k);
    return View(views[at].xyz, mat3x3<f32>(views[at + 1u].xyz, views[at + 2u].xyz, views[at + 3u].xyz));
}
