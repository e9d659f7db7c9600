// Keys of points to keys of squares, for radii that are too large to gather: the minimum key of a window around each
// pixel, in passes of growing windows. A pass takes the minimum of nine windows of the previous pass, `step` pixels
// apart, which together cover the larger window. A window whose radius is in the schedule contains the squares of the
// points up to the depth of that radius: keys of such a window within `bound` are merged into `squares`.
//
// The first pass reads the keys of points from the buffer of `squares`, so it must not write there. The last pass
// writes no windows.
//
// variant widen: FOLD=0 LAST=0
// variant fold: FOLD=1 LAST=0
// variant last: FOLD=1 LAST=1

override FOLD: bool; // whether windows of the previous pass are merged into `squares`
override LAST: bool; // whether those of this pass are

// As in project.wgsl.
struct SpreadBand {
    columns: f32,
    rows: f32,
    first_row: f32,
    key_row: u32,
}

struct SpreadPush {
    step: u32,       // pixels
    pad: u32,        // padding around each band, pixels
    key_rows: u32,   // rows of a tile of keys
    rows: u32,       // rows per invocation
    bound: u32,      // bits of the depth up to which windows of the previous pass are squares; 0 if they are not
    last_bound: u32, // the same for the windows of the last pass
    keep: u32,       // 1 if `squares` already contains squares
}

@group(0) @binding(0) var<storage, read> bands: array<SpreadBand>;
@group(0) @binding(1) var<storage, read> windows: array<u64>;
@group(0) @binding(2) var<storage, read_write> wider: array<u64>;
@group(0) @binding(3) var<storage, read_write> squares: array<u64>;

var<immediate> push: SpreadPush;

const EMPTY = 0x7fffffff7ffffffflu;

fn lower(a: u64, b: u64) -> u64 {
    return select(a, b, b < a);
}

fn within(key: u64, bound: u32) -> u64 {
    return select(EMPTY, key, u32(key >> 32u) <= bound);
}

// Index of a column in row 0 of its tile.
fn key_column(column: u32) -> u32 {
    return (column >> 5u) * push.key_rows * 32u + (column & 31u);
}

// Minimum of three windows in a row.
fn three(columns: vec3<u32>, row: u32) -> u64 {
    return lower(lower(windows[columns.x + row * 32u], windows[columns.y + row * 32u]), windows[columns.z + row * 32u]);
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let band = bands[group.z];
    let x = group.x * 64u + lane;
    let width = u32(band.columns) + 2u * push.pad;
    let height = u32(band.rows) + 2u * push.pad;
    let first = group.y * push.rows;
    let end = min(first + push.rows, height);
    if x >= width || first >= end {
        return;
    }
    // There are no windows beyond the border. The one at the border replaces them: it lies within the larger window.
    let left = key_column(x - min(x, push.step));
    let middle = key_column(x);
    let right = key_column(min(x + push.step, width - 1u));
    let columns = vec3(left, middle, right);
    for (var y = first; y < end; y++) {
        let above = band.key_row + y - min(y, push.step);
        let row = band.key_row + y;
        let below = band.key_row + min(y + push.step, height - 1u);
        let window = lower(lower(three(columns, above), three(columns, row)), three(columns, below));
        let at = middle + row * 32u;
        if FOLD {
            var key = within(windows[at], push.bound);
            if LAST {
                key = lower(key, within(window, push.last_bound));
            }
            if push.keep != 0u {
                key = lower(key, squares[at]);
            }
            squares[at] = key;
        }
        if !LAST {
            wider[at] = window;
        }
    }
}
