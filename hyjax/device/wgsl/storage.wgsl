// How pictures are stored between passes; all arithmetic is in single precision.
alias Stored = $stored;
fn load(value: Stored) -> vec4<f32> { return vec4<f32>(value); }
fn store(value: vec4<f32>) -> Stored { return Stored(clamp(value, vec4<f32>(-$largest), vec4<f32>($largest))); }
