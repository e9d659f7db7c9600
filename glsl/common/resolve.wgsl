// Common part of the resolve shaders: tables, keys, and the lookup of a key's color, number and instance.

struct ResolveBand {
    width: u32,   // of the result, pixels
    height: u32,  // rows of the result in this band
    key_row: u32, // key row where the gather for source row 0 (full size: the band's first row) begins, wrapping
    pixel: u32,   // offset of the band in the results, pixels
    columns: u32, // index of the tap of column 0
    rows: u32,    // index of the tap of the band's first row
    pair: u32,    // number of pairs of key columns to the left of those that are read
    pad_1: u32,
}

struct ResolvePush {
    reach_1: u32, // bits of the depth up to which a point covers its neighbors
    reach_2: u32, // the same for the pixels beyond them
    rows: u32,    // result rows per invocation
    wants: u32,   // WANT_ bits
    key_rows: u32,
}

@group(0) @binding(0) var<storage, read> bands: array<ResolveBand>;
@group(0) @binding(1) var keys: texture_2d<u32>;         // two pixels per texel, in tiles of 16 texels
@group(0) @binding(2) var blocks: texture_2d<u32>;       // by number / 4096: offsets to color, to point; instance
@group(0) @binding(3) var colors: texture_2d_array<u32>; // by color index

const PAD = 2u;
const EMPTY = 0x7fffffff7fffffffli;
const INFINITY_BITS = 0x7f800000u;
const WANT_COLOR = 1u;
const WANT_CLASS = 2u;
const WANT_DEPTH = 4u;
const WANT_INSTANCE = 8u;
const WANT_POINT = 16u; // selects the variants with point numbers

fn lower(a: i64, b: i64) -> i64 {
    return select(a, b, b < a);
}

fn key_from(hi: u32, lo: u32) -> i64 {
    return i64((u64(hi) << 32u) | u64(lo));
}

fn depth_bits(key: i64) -> u32 {
    return select(u32(u64(key) >> 32u), INFINITY_BITS, key == EMPTY);
}

// Offset of a pair of columns in row 0 of the keys.
fn key_column(pair: u32) -> u32 {
    return (pair >> 4u) * push.key_rows * 16u + (pair & 15u);
}

// Two keys; `column` from key_column.
fn keys_at(column: u32, row: u32) -> vec4<u32> {
    let at = column + row * 16u;
    return textureLoad(keys, vec2<u32>(at & 4095u, at >> 12u), 0);
}

// Returns 0 for an empty pixel.
fn number_of(key: i64) -> u32 {
    return select(u32(u64(key) & 0xfffffffflu), 0u, key == EMPTY);
}

fn block_of(number: u32) -> vec4<u32> {
    return textureLoad(blocks, vec2<u32>((number >> 12u) & 4095u, number >> 24u), 0);
}

fn color_of(index: u32) -> u32 {
    return textureLoad(colors, vec2<u32>(index & 4095u, (index >> 12u) & 16383u), index >> 26u, 0).x;
}
