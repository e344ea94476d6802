// A picture of a finer level, by interpolation.
@group(0) @binding(0) var<storage, read> coarse: array<Stored>;
@group(0) @binding(1) var<storage, read_write> fine: array<Stored>;
$guide_bindings

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= FINE)) { return; }
    fine[(id.z * FINE.y + id.y) * FINE.x + id.x] = store(interpolated(corners_of(id.xy), id.z));
}
