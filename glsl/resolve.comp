#version 450
// Visibility buffer to maps: resolves the winner of every pixel of a tile. One dispatch per page of points.

layout(local_size_x = 64) in;

struct Piece {
    uint number_bias; // point within the page + 1 + this (wrapping) = point number in the job + 1
    uint instance;
    uint page;
    uint pad;
};

layout(set = 0, binding = 0) uniform utexture2D visibility;
layout(set = 0, binding = 1) uniform texture2D depth;
layout(set = 0, binding = 2) readonly buffer Pieces {
    Piece pieces[];
};
layout(set = 0, binding = 3) buffer Planes {
    uint planes[];
};
layout(set = 1, binding = 0) readonly buffer Page {
    uvec4 points[];
};

layout(push_constant) uniform ResolvePush {
    uint width;  // width of the tile, pixels
    uint page;   // bound page
    uint first;  // 1 in the first dispatch, which also writes the planes that need no page
    uint point_at; // offset of each plane in `planes`, or NOT_WANTED
    uint depth_at;
    uint rgb_class_at;
    uint instance_at;
} push;

const uint NOT_WANTED = 0xffffffffu;
const float M_FROM_DEPTH = 1073741824.0; // 2^30, exact
const uint INFINITY_BITS = 0x7f800000u;

void main() {
    uvec2 at = gl_GlobalInvocationID.xy;
    if (at.x >= push.width) {
        return;
    }
    uvec2 owner = texelFetch(visibility, ivec2(at), 0).xy;
    uint pixel = at.y * push.width + at.x;
    Piece piece = Piece(0u, 0u, 0u, 0u);
    if (owner.x != 0u) {
        piece = pieces[owner.y];
    }
    if (push.first == 1u) {
        if (push.point_at != NOT_WANTED) {
            planes[push.point_at + pixel] = owner.x == 0u ? 0u : owner.x + piece.number_bias;
        }
        if (push.depth_at != NOT_WANTED) {
            uint bits = floatBitsToUint(texelFetch(depth, ivec2(at), 0).x * M_FROM_DEPTH);
            planes[push.depth_at + pixel] = owner.x == 0u ? INFINITY_BITS : bits;
        }
        if (push.instance_at != NOT_WANTED) {
            planes[push.instance_at + pixel] = piece.instance;
        }
        if (push.rgb_class_at != NOT_WANTED && owner.x == 0u) {
            planes[push.rgb_class_at + pixel] = 0u;
        }
    }
    if (push.rgb_class_at != NOT_WANTED && owner.x != 0u && piece.page == push.page) {
        planes[push.rgb_class_at + pixel] = points[owner.x - 1u].w;
    }
}
