#version 450
// Whether a pixel's centre lies in the segment's rectangle. The operations and their order are those of
// `LineTest::covers` in src/raster/line_test.rs.

layout(push_constant) uniform LinePush {
    vec2 tile_origin; // pixels
    vec2 tile_size;   // pixels
} push;

layout(location = 0) flat in vec2 line_from;
layout(location = 1) flat in vec2 line_along;
layout(location = 2) flat in vec2 line_length_half_width;
layout(location = 3) flat in uint line_rgb;

layout(location = 0) out uvec4 color;

void main() {
    vec2 at = gl_FragCoord.xy + push.tile_origin;
    float dx = at.x - line_from.x;
    float dy = at.y - line_from.y;
    float along = dx * line_along.x + dy * line_along.y;
    float across = dy * line_along.x - dx * line_along.y;
    float half_width = line_length_half_width.y;
    bool inside = along >= 0.0 && along < line_length_half_width.x && across >= -half_width && across < half_width;
    if (!inside) {
        discard;
    }
    color = uvec4(line_rgb & 255u, (line_rgb >> 8) & 255u, (line_rgb >> 16) & 255u, 255u);
}
