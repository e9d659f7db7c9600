// Keys to maps of the rendered size. One invocation walks down a strip of four columns; per row it reads eight keys
// and folds them into the five rows that they may reach. Two neighboring values are written at once.
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

@group(0) @binding(4) var<storage, read_write> rgb_class: array<u64>;
@group(0) @binding(5) var<storage, read_write> depth: array<u64>;
@group(0) @binding(6) var<storage, read_write> instance: array<u64>;
@group(0) @binding(7) var<storage, read_write> point: array<u64>;

var<immediate> push: ResolvePush;

fn pair(a: u32, b: u32) -> u64 {
    return u64(a) | (u64(b) << 32u);
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let band = bands[group.z];
    let x = (group.x * 64u + lane) * 4u;
    let first = group.y * push.rows;
    let end = min(first + push.rows, band.height);
    if x >= band.width || first >= end {
        return;
    }
    let width = (band.width + 3u) & 0xfffffffcu;
    let first_pair = band.pair + x / 2u;
    let c0 = key_column(first_pair);
    let c1 = key_column(first_pair + 1u);
    let c2 = key_column(first_pair + 2u);
    let c3 = key_column(first_pair + 3u);
    let reach_1 = key_from(push.reach_1, 0xffffffffu);
    let reach_2 = key_from(push.reach_2, 0xffffffffu);
    // Winners so far of the rows y-2 .. y+2, four columns each.
    var a0 = array<i64, 4>(EMPTY, EMPTY, EMPTY, EMPTY);
    var a1 = a0;
    var a2 = a0;
    var a3 = a0;
    var a4 = a0;
    for (var y = first; y < end + 2u * PAD; y++) {
        let row = band.key_row + y;
        let t0 = keys_at(c0, row);
        let t1 = keys_at(c1, row);
        let t2 = keys_at(c2, row);
        let t3 = keys_at(c3, row);
        let k = array<i64, 8>(
            key_from(t0.y, t0.x), key_from(t0.w, t0.z), key_from(t1.y, t1.x), key_from(t1.w, t1.z),
            key_from(t2.y, t2.x), key_from(t2.w, t2.z), key_from(t3.y, t3.x), key_from(t3.w, t3.z),
        );
        for (var c = 0u; c < 4u; c++) {
            let three = lower(lower(k[c + 1u], k[c + 2u]), k[c + 3u]);
            let five = lower(three, lower(k[c], k[c + 4u]));
            let m2 = select(EMPTY, five, five <= reach_2);
            let m1 = lower(m2, select(EMPTY, three, three <= reach_1));
            let m0 = lower(m1, k[c + 2u]);
            a0[c] = lower(a1[c], m2);
            a1[c] = lower(a2[c], m1);
            a2[c] = lower(a3[c], m0);
            a3[c] = lower(a4[c], m1);
            a4[c] = m2;
        }
        if y >= first + 2u * PAD {
            let at = (band.pixel + (y - 2u * PAD) * width + x) / 2u;
            var packed: array<u32, 4>;
            var blocks_of: array<vec4<u32>, 4>;
            for (var c = 0u; c < 4u; c++) {
                let number = number_of(a0[c]);
                blocks_of[c] = block_of(number);
                packed[c] = select(color_of(number + blocks_of[c].x), 0u, a0[c] == EMPTY);
                blocks_of[c].y = select(number + blocks_of[c].y, 0u, a0[c] == EMPTY);
                blocks_of[c].z = select(blocks_of[c].z, 0u, a0[c] == EMPTY);
            }
            // Maps are cleared: empty pixels, often most of an image, need no write.
            let left = a0[0] != EMPTY || a0[1] != EMPTY;
            let right = a0[2] != EMPTY || a0[3] != EMPTY;
            if GEOMETRY {
                if left && (push.wants & WANT_DEPTH) != 0u {
                    depth[at] = pair(depth_bits(a0[0]), depth_bits(a0[1]));
                }
                if right && (push.wants & WANT_DEPTH) != 0u {
                    depth[at + 1u] = pair(depth_bits(a0[2]), depth_bits(a0[3]));
                }
                let instances = vec2(pair(blocks_of[0].z, blocks_of[1].z), pair(blocks_of[2].z, blocks_of[3].z));
                if instances.x != 0lu && (push.wants & WANT_INSTANCE) != 0u {
                    instance[at] = instances.x;
                }
                if instances.y != 0lu && (push.wants & WANT_INSTANCE) != 0u {
                    instance[at + 1u] = instances.y;
                }
                if POINT && left {
                    point[at] = pair(blocks_of[0].y, blocks_of[1].y);
                }
                if POINT && right {
                    point[at + 1u] = pair(blocks_of[2].y, blocks_of[3].y);
                }
            }
            var low = pair(packed[0], packed[1]);
            var high = pair(packed[2], packed[3]);
            if COLOR && !GEOMETRY {
                low &= 0x00ffffff00fffffflu;
                high &= 0x00ffffff00fffffflu;
            }
            if GEOMETRY && !COLOR {
                // The color, or zero, is already there.
                let bits = select(0lu, 0xff000000ff000000lu, (push.wants & WANT_CLASS) != 0u);
                low &= bits;
                high &= bits;
                if low != 0lu {
                    rgb_class[at] |= low;
                }
                if high != 0lu {
                    rgb_class[at + 1u] |= high;
                }
            } else {
                if low != 0lu {
                    rgb_class[at] = low;
                }
                if high != 0lu {
                    rgb_class[at + 1u] = high;
                }
            }
        }
    }
}
