#version 450
// Projects one point to a square of pixels, with the operations of `project` in src/raster/reference.rs in the same order.

const float Z_NEAR_M = 1e-5;
const float DEPTH_FROM_M = 1.0 / 1073741824.0; // 2^-30, exact

struct Step {
    float z_max_m;
    uint radius;
    uint pad_0;
    uint pad_1;
};

layout(set = 0, binding = 0) uniform SplatFrame {
    Step steps[16];
    vec2 tile_origin;  // pixels
    vec2 tile_size;    // pixels
    float viewport_pad; // padding on each side, pixels: the maximum radius
    uint step_count;
} frame;

layout(push_constant) uniform SplatPush {
    vec4 image_x;
    vec4 image_y;
    vec4 image_z;
    vec4 crop_x;
    vec4 crop_y;
    float crop_radius_m;
    uint piece;
} push;

layout(location = 0) in vec3 position;
layout(location = 0) flat out uvec2 owner; // point within the page + 1, piece

float dot_row(vec4 row, vec3 p) {
    return row.x * p.x + row.y * p.y + row.z * p.z + row.w;
}

// As in common/quotient.wgsl.
float floor_quotient(float a, float b) {
    float quotient = a / b;
    float whole = roundEven(quotient);
    if (whole == 0.0 || abs(quotient - whole) > 1e-6 * abs(quotient)) {
        return floor(quotient);
    }
    float whole_high = uintBitsToFloat(floatBitsToUint(whole) & 0xfffff000u);
    float whole_low = whole - whole_high;
    float b_high = uintBitsToFloat(floatBitsToUint(b) & 0xfffff000u);
    float b_low = b - b_high;
    float product = whole * b;
    float lost = ((whole_high * b_high - product) + whole_low * b_high + whole_high * b_low) + whole_low * b_low;
    float residual = (a - product) - lost;
    uint downward = whole > 0.0 ? 0xffffffffu : 1u;
    float below = uintBitsToFloat(floatBitsToUint(whole) + downward);
    return residual > -0.5 * (whole - below) * b ? whole : whole - 1.0;
}

void main() {
    // Discarded points are placed outside the clip volume.
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    gl_PointSize = 1.0;
    owner = uvec2(uint(gl_VertexIndex) + 1u, push.piece);

    float z = dot_row(push.image_z, position);
    uint radius = 0u;
    bool drawn = false;
    for (uint i = frame.step_count; i > 0u; i--) {
        if (z <= frame.steps[i - 1u].z_max_m) {
            radius = frame.steps[i - 1u].radius;
            drawn = z > Z_NEAR_M;
        }
    }
    float crop_x = dot_row(push.crop_x, position);
    float crop_y = dot_row(push.crop_y, position);
    bool in_crop = abs(crop_x) <= push.crop_radius_m && abs(crop_y) <= push.crop_radius_m;

    vec2 center = vec2(floor_quotient(dot_row(push.image_x, position), z), floor_quotient(dot_row(push.image_y, position), z));
    vec2 at = center - frame.tile_origin;
    float reach = float(radius);
    bool reaches = at.x >= -reach && at.x < frame.tile_size.x + reach && at.y >= -reach && at.y < frame.tile_size.y + reach;

    if (drawn && in_crop && reaches) {
        vec2 padded = frame.tile_size + 2.0 * frame.viewport_pad;
        vec2 ndc = 2.0 * (at + frame.viewport_pad + 0.5) / padded - 1.0;
        gl_Position = vec4(ndc, z * DEPTH_FROM_M, 1.0);
        gl_PointSize = 2.0 * reach + 1.0;
    }
}
