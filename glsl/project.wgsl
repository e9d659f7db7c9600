// Points to keys: each point writes its pixel of a visibility buffer with an atomic minimum of `depth << 32 | number`.
// One workgroup draws an item into one band (row strip) of a view: up to 4096 points of a chunk. The operations and
// their order are those of `project` in src/raster/reference.rs.
//
// With SQUARE a point writes all pixels that it covers. Without, it writes only its center, and later shaders
// gather the neighborhood (resolve_full.wgsl, resolve_reduced.wgsl) or spread the keys (spread.wgsl). CROP tests
// the square crop, which chunks well inside do not need. LAYERED writes up to three buffers.
//
// LANES points are drawn in parallel: the vector width of a CPU, so that it reads memory in order, or enough
// to occupy a GPU. DEVICE_ROUNDS: the device rounds divisions correctly, as CPUs do.
//
// variant pixel: SQUARE=0 CROP=0 LAYERED=0 LANES=64 DEVICE_ROUNDS=0
// variant pixel_crop: SQUARE=0 CROP=1 LAYERED=0 LANES=64 DEVICE_ROUNDS=0
// variant layered: SQUARE=0 CROP=0 LAYERED=1 LANES=64 DEVICE_ROUNDS=0
// variant layered_crop: SQUARE=0 CROP=1 LAYERED=1 LANES=64 DEVICE_ROUNDS=0
// variant square: SQUARE=1 CROP=1 LAYERED=1 LANES=64 DEVICE_ROUNDS=0
// variant pixel_narrow: SQUARE=0 CROP=0 LAYERED=0 LANES=8 DEVICE_ROUNDS=1
// variant pixel_crop_narrow: SQUARE=0 CROP=1 LAYERED=0 LANES=8 DEVICE_ROUNDS=1
// variant layered_narrow: SQUARE=0 CROP=0 LAYERED=1 LANES=8 DEVICE_ROUNDS=1
// variant layered_crop_narrow: SQUARE=0 CROP=1 LAYERED=1 LANES=8 DEVICE_ROUNDS=1

override SQUARE: bool;
override CROP: bool;
override LAYERED: bool;
override LANES: u32;
override DEVICE_ROUNDS: bool;

const Z_NEAR_M = 1e-5;
const GROUPS_PER_ROW = 32768u;

struct Step {
    z_max_m: f32,
    radius: u32,
    pad_0: u32,
    pad_1: u32,
}

struct ProjectFrame {
    steps: array<Step, 16>,
    step_count: u32,
    z_far_m: f32,
    key_rows: u32,
    pad: u32, // padding around each band, pixels
}

struct ProjectDraw {
    image_x: vec4<f32>,
    image_y: vec4<f32>,
    image_z: vec4<f32>,
    crop_x: vec4<f32>,
    crop_y: vec4<f32>,
    crop_radius_m: f32,
    first_number: u32,
    band: u32,
    layers: u32, // bit mask
}

// Row strip of a view, rendered in one batch.
struct ProjectBand {
    columns: f32,
    rows: f32,
    first_row: f32, // in the view
    key_row: u32,   // where its padding begins
}

struct ProjectItem {
    draw: u32,
    row: u32,   // in the page
    first: u32, // column
    end: u32,
}

struct ProjectPush {
    first: u32,
    count: u32,
}

@group(0) @binding(0) var<uniform> frame: ProjectFrame;
@group(0) @binding(1) var<storage, read> draws: array<ProjectDraw>;
@group(0) @binding(2) var<storage, read> bands: array<ProjectBand>;
@group(0) @binding(3) var<storage, read> items: array<ProjectItem>;
@group(0) @binding(4) var<storage, read_write> keys_0: array<atomic<u64>>;
@group(0) @binding(5) var<storage, read_write> keys_1: array<atomic<u64>>;
@group(0) @binding(6) var<storage, read_write> keys_2: array<atomic<u64>>;
@group(1) @binding(0) var points: texture_2d<u32>; // bits of x, y and z, index within the cloud

var<immediate> push: ProjectPush;

fn dot_row(row: vec4<f32>, p: vec3<f32>) -> f32 {
    return row.x * p.x + row.y * p.y + row.z * p.z + row.w;
}

// include common/quotient.wgsl

fn pixel(a: f32, b: f32) -> f32 {
    if DEVICE_ROUNDS {
        return floor(a / b);
    }
    return floor_quotient(a, b);
}

fn put(layers: u32, at: u32, key: u64) {
    if LAYERED {
        if (layers & 1u) != 0u {
            atomicMin(&keys_0[at], key);
        }
        if (layers & 2u) != 0u {
            atomicMin(&keys_1[at], key);
        }
        if (layers & 4u) != 0u {
            atomicMin(&keys_2[at], key);
        }
    } else {
        atomicMin(&keys_0[at], key);
    }
}

// Keys are stored in tiles of 32 columns, each row by row, so that image neighbors are close in memory.
fn key_index(column: i32, row: i32, band: ProjectBand) -> u32 {
    let pad = i32(frame.pad);
    let at = vec2<u32>(u32(column + pad), band.key_row + u32(row + pad));
    return ((at.x >> 5u) * frame.key_rows + at.y) * 32u + (at.x & 31u);
}

fn radius_at(z: f32) -> i32 {
    var radius = 0u;
    for (var i = frame.step_count; i > 0u; i--) {
        if z <= frame.steps[i - 1u].z_max_m {
            radius = frame.steps[i - 1u].radius;
        }
    }
    return i32(radius);
}

@compute @workgroup_size(LANES)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let at = group.x + group.y * GROUPS_PER_ROW;
    if at >= push.count {
        return;
    }
    let item = items[push.first + at];
    let draw = draws[item.draw];
    let band = bands[draw.band];
    for (var i = item.first + lane; i < item.end; i += LANES) {
        let texel = textureLoad(points, vec2<u32>(i, item.row), 0);
        let p = bitcast<vec3<f32>>(texel.xyz);
        let z = dot_row(draw.image_z, p);
        var drawn = z > Z_NEAR_M && z <= frame.z_far_m;
        if CROP {
            let crop_x = dot_row(draw.crop_x, p);
            let crop_y = dot_row(draw.crop_y, p);
            drawn = drawn && abs(crop_x) <= draw.crop_radius_m && abs(crop_y) <= draw.crop_radius_m;
        }
        let x = pixel(dot_row(draw.image_x, p), z);
        let y = pixel(dot_row(draw.image_y, p), z) - band.first_row;
        var radius = i32(frame.pad);
        if SQUARE {
            radius = radius_at(z);
        }
        let reach = f32(radius);
        drawn = drawn && x >= -reach && x < band.columns + reach && y >= -reach && y < band.rows + reach;
        if drawn {
            let key = (u64(bitcast<u32>(z)) << 32u) | u64(draw.first_number + texel.w);
            let center = vec2<i32>(i32(x), i32(y));
            if SQUARE {
                let low = max(center - radius, vec2<i32>(0));
                let high = min(center + radius, vec2<i32>(i32(band.columns), i32(band.rows)) - 1);
                for (var row = low.y; row <= high.y; row++) {
                    for (var column = low.x; column <= high.x; column++) {
                        put(draw.layers, key_index(column, row, band), key);
                    }
                }
            } else {
                put(draw.layers, key_index(center.x, center.y, band), key);
            }
        }
    }
}
