// Nearest triangle on a ray. The tree is complete and has no pointers: node n has children 2n + 1 and 2n + 2, its
// leaves are runs of LEAF triangles in the order of `faces`. `boxes` holds the lowest and highest corner of each node.
const LEAVES = ${leaves}u; // a power of two
const LEAF = ${leaf}u;
const FACES = ${faces}u;
const FAR = 1e30;

@group(0) @binding(0) var<storage, read> vertices: array<f32>;
@group(0) @binding(1) var<storage, read> faces: array<u32>;
@group(0) @binding(2) var<storage, $boxes_access> boxes: array<vec4<f32>>;

fn vertex(k: u32) -> vec3<f32> { return vec3<f32>(vertices[3u * k], vertices[3u * k + 1u], vertices[3u * k + 2u]); }
