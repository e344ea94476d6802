// Conductances of a level (Eq. 3 and 4): x to the cell below, y to the cell on the right, 0 across the border.
// From the guide's cell means (`$pooling` "guide"), or from the largest distance between fine pixels ("edges").
@group(0) @binding(0) var<storage, read> guide: array<Stored>;
@group(0) @binding(1) var<storage, read_write> edges: array<vec2<f32>>;

const GUIDE = vec2<u32>($guide); // size of the guide that is bound: the level's cells, or the full picture
const CELLS = vec2<u32>($cells);
const GROUPS = ${groups}u;
const FACTOR = ${factor}u;
const SCALE = f32($scale); // 1 / kappa^2

$distance

fn at(pixel: vec2<u32>, group: u32) -> vec4<f32> {
    return load(guide[(group * GUIDE.y + pixel.y) * GUIDE.x + pixel.x]);
}

fn between(a: vec2<u32>, b: vec2<u32>) -> f32 {
    var total = 0.0;
    for (var group = 0u; group < GROUPS; group++) { total += difference(at(a, group) - at(b, group)); }
    return distance_of(total);
}

fn conductance(squared: f32) -> f32 { return 1.0 / (1.0 + squared * SCALE); }

// Largest distance along one axis between two neighbouring cells' centres, over the cells' whole width.
fn largest(cell: vec2<u32>, down: bool) -> f32 {
    let along = select(0u, 1u, down);
    let across = 1u - along;
    let first = FACTOR * cell[along] + (FACTOR - 1u) / 2u;
    let last = min(first + FACTOR - (FACTOR & 1u), GUIDE[along] - 2u);
    let side = FACTOR * cell[across];
    var most = 0.0;
    for (var k = first; k <= last; k++) {
        for (var s = side; s < min(side + FACTOR, GUIDE[across]); s++) {
            var a = vec2<u32>(k, s);
            var b = vec2<u32>(k + 1u, s);
            if (down) { a = a.yx; b = b.yx; }
            most = max(most, between(a, b));
        }
    }
    return most;
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= CELLS)) { return; }
    var result = vec2<f32>(0.0);
    if (id.y + 1u < CELLS.y) { result.x = conductance($down); }
    if (id.x + 1u < CELLS.x) { result.y = conductance($right); }
    edges[id.y * CELLS.x + id.x] = result;
}
