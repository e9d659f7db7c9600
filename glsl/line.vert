#version 450
// One segment to a rectangle that holds all its pixels with some to spare; the fragment stage decides exactly.

const float SPARE_PX = 1.5;

layout(push_constant) uniform LinePush {
    vec2 tile_origin; // pixels
    vec2 tile_size;   // pixels
} push;

layout(location = 0) in vec2 from;
layout(location = 1) in vec2 along;
layout(location = 2) in vec2 length_half_width;
layout(location = 3) in uint rgb;

layout(location = 0) flat out vec2 line_from;
layout(location = 1) flat out vec2 line_along;
layout(location = 2) flat out vec2 line_length_half_width;
layout(location = 3) flat out uint line_rgb;

void main() {
    line_from = from;
    line_along = along;
    line_length_half_width = length_half_width;
    line_rgb = rgb;

    uint corner = uint(gl_VertexIndex);
    float forward = (corner & 1u) == 0u ? -SPARE_PX : length_half_width.x + SPARE_PX;
    float sideways = length_half_width.y + SPARE_PX;
    if ((corner & 2u) == 0u) {
        sideways = -sideways;
    }
    vec2 across = vec2(-along.y, along.x);
    vec2 at = from + along * forward + across * sideways - push.tile_origin;
    gl_Position = vec4(2.0 * at / push.tile_size - 1.0, 0.0, 1.0);
}
