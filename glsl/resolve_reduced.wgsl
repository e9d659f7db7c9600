// Keys to maps of a reduced size: class, depth, instance and point from the nearest source pixel, color bilinear
// with OpenCV's fixed-point arithmetic. One invocation walks down the source rows of one result column, and
// resolves points only where the result reads them.
//
// The taps of rows and columns must never decrease: nearest <= low, low + 1 <= the next nearest (each without the
// other for the variants of one kind), and for `both` low - nearest <= 3 in every column.
//
// variant both: COLOR=1 GEOMETRY=1 POINT=0
// variant both_point: COLOR=1 GEOMETRY=1 POINT=1
// variant color: COLOR=1 GEOMETRY=0 POINT=0
// variant geometry: COLOR=0 GEOMETRY=1 POINT=0
// variant geometry_point: COLOR=0 GEOMETRY=1 POINT=1

override COLOR: bool;
override GEOMETRY: bool;
override POINT: bool;

// include common/resolve.wgsl

struct ResolveTap {
    nearest: u32,
    low: u32,           // first of the two that color interpolates
    weights: vec2<i32>, // 1/2048
}

@group(0) @binding(4) var<storage, read_write> rgb_class: array<u32>;
@group(0) @binding(5) var<storage, read_write> depth: array<u32>;
@group(0) @binding(6) var<storage, read_write> instance: array<u32>;
@group(0) @binding(7) var<storage, read_write> point: array<u32>;
@group(0) @binding(8) var<storage, read> taps: array<ResolveTap>;

var<immediate> push: ResolvePush;

// Per column (nearest, left, right): winners of the rows y-2 .. y+2 so far.
var<private> winners: array<array<i64, 5>, 3>;
var<private> row: u32; // next row of keys to fold
var<private> columns: array<u32, 5>; // offsets of the pairs of columns to read
var<private> odd: bool;
var<private> shift: u32;
var<private> reach_1: i64;
var<private> reach_2: i64;

fn fold(column: u32, k0: i64, k1: i64, k2: i64, k3: i64, k4: i64) {
    let three = lower(lower(k1, k2), k3);
    let five = lower(three, lower(k0, k4));
    let m2 = select(EMPTY, five, five <= reach_2);
    let m1 = lower(m2, select(EMPTY, three, three <= reach_1));
    let m0 = lower(m1, k2);
    winners[column][0] = lower(winners[column][1], m2);
    winners[column][1] = lower(winners[column][2], m1);
    winners[column][2] = lower(winners[column][3], m0);
    winners[column][3] = lower(winners[column][4], m1);
    winners[column][4] = m2;
}

// Folds one more row of keys.
fn advance() {
    let t0 = keys_at(columns[0], row);
    let t1 = keys_at(columns[1], row);
    let t2 = keys_at(columns[2], row);
    let t3 = keys_at(columns[3], row);
    let t4 = keys_at(columns[4], row);
    var k = array<i64, 10>(
        key_from(t0.y, t0.x), key_from(t0.w, t0.z), key_from(t1.y, t1.x), key_from(t1.w, t1.z),
        key_from(t2.y, t2.x), key_from(t2.w, t2.z), key_from(t3.y, t3.x), key_from(t3.w, t3.z),
        key_from(t4.y, t4.x), key_from(t4.w, t4.z),
    );
    for (var j = 0u; j < 9u; j++) {
        k[j] = select(k[j], k[j + 1u], odd);
    }
    if GEOMETRY {
        fold(0u, k[0], k[1], k[2], k[3], k[4]);
    }
    if COLOR {
        for (var j = 0u; j < 8u; j++) {
            k[j] = select(k[j], k[j + 1u], (shift & 1u) != 0u);
        }
        for (var j = 0u; j < 6u; j++) {
            k[j] = select(k[j], k[j + 2u], (shift & 2u) != 0u);
        }
        fold(1u, k[0], k[1], k[2], k[3], k[4]);
        fold(2u, k[1], k[2], k[3], k[4], k[5]);
    }
    row += 1u;
}

// Red, green and blue between two neighboring pixels of a complete row, as in OpenCV's first pass.
fn across(weights: vec2<i32>) -> vec3<i32> {
    let left = rgb_of(winners[1][0]) * weights.x;
    let right = rgb_of(winners[2][0]) * weights.y;
    return (left + right) >> vec3(4u);
}

fn rgb_of(key: i64) -> vec3<i32> {
    let number = number_of(key);
    let packed = select(color_of(number + block_of(number).x), 0u, key == EMPTY);
    return vec3(i32(packed & 0xffu), i32((packed >> 8u) & 0xffu), i32((packed >> 16u) & 0xffu));
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let band = bands[group.z];
    let x = group.x * 64u + lane;
    let first = group.y * push.rows;
    let end = min(first + push.rows, band.height);
    if x >= band.width || first >= end {
        return;
    }
    let column = taps[band.columns + x];
    // Leftmost key column that is read: the source column plus two of padding, minus two for the gather.
    let start = select(column.low, column.nearest, GEOMETRY);
    for (var i = 0u; i < 5u; i++) {
        columns[i] = key_column(band.pair + start / 2u + i);
    }
    odd = (start & 1u) != 0u;
    shift = column.low - start;
    reach_1 = key_from(push.reach_1, 0xffffffffu);
    reach_2 = key_from(push.reach_2, 0xffffffffu);
    for (var c = 0u; c < 3u; c++) {
        for (var j = 0u; j < 5u; j++) {
            winners[c][j] = EMPTY;
        }
    }
    let first_tap = taps[band.rows + first];
    row = band.key_row + select(first_tap.low, first_tap.nearest, GEOMETRY);
    for (var i = 0u; i < 2u * PAD; i++) {
        advance();
    }
    for (var y = first; y < end; y++) {
        let tap = taps[band.rows + y];
        let pixel = band.pixel + y * band.width + x;
        var class_bits = 0u;
        if GEOMETRY {
            // A row is complete after the two rows below it are folded.
            while row < band.key_row + tap.nearest + 2u * PAD + 1u {
                advance();
            }
            let key = winners[0][0];
            let number = number_of(key);
            let block = block_of(number);
            class_bits = select(color_of(number + block.x) & 0xff000000u, 0u, key == EMPTY);
            // Maps are cleared: empty pixels need no write.
            if key != EMPTY && (push.wants & WANT_DEPTH) != 0u {
                depth[pixel] = depth_bits(key);
            }
            if key != EMPTY && block.z != 0u && (push.wants & WANT_INSTANCE) != 0u {
                instance[pixel] = block.z;
            }
            if POINT && key != EMPTY {
                point[pixel] = number + block.y;
            }
        }
        if COLOR {
            while row < band.key_row + tap.low + 2u * PAD + 1u {
                advance();
            }
            let upper = (tap.weights.x * across(column.weights)) >> vec3(16u);
            while row < band.key_row + tap.low + 2u * PAD + 2u {
                advance();
            }
            let lower = (tap.weights.y * across(column.weights)) >> vec3(16u);
            let rgb = vec3<u32>((upper + lower + 2) >> vec3(2u));
            let packed = rgb.x | (rgb.y << 8u) | (rgb.z << 16u);
            let both = select(packed, packed | class_bits, (push.wants & WANT_CLASS) != 0u);
            if both != 0u {
                rgb_class[pixel] = both;
            }
        } else if class_bits != 0u && (push.wants & WANT_CLASS) != 0u {
            // The color, or zero, is already there.
            rgb_class[pixel] |= class_bits;
        }
    }
}
