#version 450
// Computes the visible share of the sun and of the sky for each sample, and writes the kind of its shader as depth.

// include common/view.glsl
// include common/sample.glsl
layout(set = 0, binding = 4) uniform texture2D sun_near;
layout(set = 0, binding = 5) uniform texture2D sun_far;
layout(set = 0, binding = 6) uniform texture2D over;
// The same maps of what moves.
layout(set = 0, binding = 9) uniform texture2D moving_near;
layout(set = 0, binding = 10) uniform texture2D moving_far;
layout(set = 0, binding = 11) uniform texture2D moving_over;

layout(location = 0) out vec2 light;

// `Kind` of each `Surface`, 4 bits each, in their order.
const uint KINDS_0 = 0x32211115u;
const uint KINDS_8 = 0x22264544u;
const uint KINDS_16 = 0x00005255u;

uint kind_of(uint surface) {
    uint low = surface < 8u ? KINDS_0 : KINDS_8;
    uint kinds = surface < 16u ? low : KINDS_16;
    return (kinds >> (4u * (surface & 7u))) & 15u;
}

vec3 on_map(vec4 x, vec4 y, vec4 z, vec3 p) {
    return vec3(dot(x.xyz, p) + x.w, dot(y.xyz, p) + y.w, dot(z.xyz, p) + z.w);
}

// Return the first depth of a texel.
float near_at(ivec2 texel) {
    return min(texelFetch(sun_near, texel, 0).x, texelFetch(moving_near, texel, 0).x);
}

float far_at(ivec2 texel) {
    return min(texelFetch(sun_far, texel, 0).x, texelFetch(moving_far, texel, 0).x);
}

float over_at(ivec2 texel) {
    return min(texelFetch(over, texel, 0).x, texelFetch(moving_over, texel, 0).x);
}

// Returns the share of 4 x 4 texels around a position that do not hide it, weighted by a box three texels wide.
float seen_near(vec3 at) {
    vec2 corner = at.xy - 0.5;
    vec2 t = fract(corner);
    ivec2 first = ivec2(floor(corner)) - 1;
    float sum = 0.0;
    for (int y = 0; y < 4; y++) {
        float wy = y == 0 ? 1.0 - t.y : (y == 3 ? t.y : 1.0);
        for (int x = 0; x < 4; x++) {
            float wx = x == 0 ? 1.0 - t.x : (x == 3 ? t.x : 1.0);
            sum += wx * wy * step(at.z, near_at(first + ivec2(x, y)));
        }
    }
    return sum / 9.0;
}

float seen_far(vec3 at) {
    vec2 corner = at.xy - 0.5;
    vec2 t = fract(corner);
    ivec2 first = ivec2(floor(corner));
    vec4 hides = vec4(far_at(first), far_at(first + ivec2(1, 0)), far_at(first + ivec2(0, 1)), far_at(first + ivec2(1, 1)));
    vec4 seen = step(vec4(at.z), hides);
    return mix(mix(seen.x, seen.y, t.x), mix(seen.z, seen.w, t.x), t.y);
}

// Returns the distance to the border of a map less 4, texels; below 0 near the border and outside.
float inside(vec2 at, ivec2 size) {
    vec2 least = min(at, vec2(size) - at);
    return min(least.x, least.y) - 4.0;
}

float sun_seen(vec3 p, vec3 n) {
    float facing = dot(n, view.sun.xyz);
    float tilt = sqrt(max(1.0 - facing * facing, 0.0));
    vec3 fine = on_map(view.near_x, view.near_y, view.near_z, p + n * (0.012 + 0.06 * tilt));
    vec3 coarse = on_map(view.far_x, view.far_y, view.far_z, p + n * (0.03 + 0.26 * tilt));
    // Clamped, so that no texel outside is read.
    ivec2 fine_size = textureSize(sun_near, 0);
    ivec2 coarse_size = textureSize(sun_far, 0);
    float in_fine = inside(fine.xy, fine_size);
    float in_coarse = inside(coarse.xy, coarse_size);
    fine.xy = clamp(fine.xy, vec2(2.5), vec2(fine_size) - 2.5);
    coarse.xy = clamp(coarse.xy, vec2(2.5), vec2(coarse_size) - 2.5);
    float far = in_coarse > 0.0 ? seen_far(coarse) : 1.0;
    float seen = mix(far, seen_near(fine), clamp(in_fine / 48.0, 0.0, 1.0));
    return facing > 0.0 ? seen : 0.0;
}

// Returns the visible share of the sky: occluders above and near the position come from the map from above.
float sky_seen(vec3 p, vec3 n, float height_m) {
    vec2 out_of = n.xy * 0.75;
    vec3 at = on_map(view.over_x, view.over_y, view.over_z, p + vec3(out_of, 0.04));
    float texel = view.over_x.x;
    float m_of_depth = -1.0 / view.over_z.z;
    ivec2 size = textureSize(over, 0);
    float hidden = 0.0;
    uvec2 grid = uvec2(gl_FragCoord.xy) & 3u;
    float turn = float((grid.x * 5u + grid.y * 11u) & 15u) * 0.0490874;
    vec2 axis = vec2(cos(turn), sin(turn));
    for (int i = 0; i < 12; i++) {
        // Three rings of four taps.
        float r = i < 4 ? 0.28 : (i < 8 ? 0.62 : 1.05);
        float s = (i & 4) == 0 ? 0.0 : 0.7071;
        vec2 side = (i & 1) == 0 ? vec2(1.0, 0.0) : vec2(0.0, 1.0);
        side = (i & 2) == 0 ? side : -side;
        side = mix(side, vec2(side.x - side.y, side.x + side.y), s);
        vec2 tap = at.xy + texel * r * vec2(axis.x * side.x - axis.y * side.y, axis.y * side.x + axis.x * side.y);
        tap = clamp(tap, vec2(0.5), vec2(size) - 0.5);
        float above = (at.z - over_at(ivec2(tap))) * m_of_depth;
        float close = clamp(above * 8.0, 0.0, 1.0) / (1.0 + 0.14 * max(above, 0.0));
        hidden += close * (i < 4 ? 1.4 : 0.8);
    }
    float open = max(1.0 - 0.95 * hidden / 12.0, 0.08);
    float share = clamp(inside(at.xy, size) / 64.0, 0.0, 1.0);
    float wall = 1.0 - abs(n.z);
    float low = mix(1.0, 0.66 + 0.34 * clamp(height_m / 1.6, 0.0, 1.0), wall);
    return mix(1.0, open, share) * low;
}

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    uvec4 surface = texelFetch(surfaces, texel, 0);
    float depth = texelFetch(depths, texel, 0).x;
    vec3 p = from_camera(depth);
    vec3 n = unpacked_normal(surface.x);
    light = vec2(sun_seen(p, n), sky_seen(p, n, p.z + view.ray_z.w));
    uint kind = depth > 0.0 ? kind_of(surface.y >> 24) : 0u;
    gl_FragDepth = float(kind + 1u) / 16.0;
}
