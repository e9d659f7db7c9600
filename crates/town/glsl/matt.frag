#version 450
// Shades plain colors, rubber, lamps, signs and cloth.

// include common/view.glsl
// include common/finish.glsl
// include common/noise.glsl
// include common/sample.glsl
// include common/shade.glsl

const uint RUBBER = 10u;
const uint LAMP = 16u;
const uint SIGN = 17u;
const uint CLOTH = 19u;

// Returns 1 inside pseudo-letters in rows, else 0.
float letters(Sample s) {
    vec2 size = vec2(0.17, 0.26);
    vec2 at = (s.uv - vec2(0.10, 0.12)) / size;
    ivec2 cell = ivec2(floor(at));
    uint glyph = hash(cell, s.seed);
    vec2 dot_at = fract(at) * vec2(5.0, 7.0);
    ivec2 d = ivec2(floor(dot_at));
    bool margin = d.x >= 4 || d.y < 1 || d.y >= 6;
    // Vertical strokes at the sides, bars between.
    uint row = uint(clamp(d.y - 1, 0, 4));
    bool stroke = (d.x == 0 && (glyph & 3u) != 0u) || (d.x == 3 && ((glyph >> 2) & 3u) > 1u);
    bool bar = ((glyph >> (4u + row)) & 1u) == 1u && (row & 1u) == 0u;
    bool blank = ((glyph >> 12) & 7u) == 0u || cell.y < 0 || cell.x < 0;
    return margin || blank || !(stroke || bar) ? 0.0 : 1.0;
}

void main() {
    Sample s = sample_here();
    vec3 color = s.color;
    float bright = dot(color, vec3(0.3, 0.6, 0.1));
    vec3 ink = bright > 0.25 ? color * 0.12 : vec3(0.85, 0.83, 0.76);
    float lettered = s.seed == 0u ? 0.0 : mix(0.25, letters(s), detail(s, 0.05));
    vec3 sign = mix(color, ink, lettered);
    float weave = (noise(s.uv * 140.0, 86u) - 0.5) * detail(s, 0.012);
    float folds = rough(s.place.xy * 7.0 + s.place.z * 5.0, s.seed + 87u) - 0.5;
    vec3 cloth = color * (1.0 + 0.3 * weave + 0.28 * folds * detail(s, 0.15));
    color = s.surface == SIGN ? sign : color;
    color = s.surface == CLOTH ? cloth : color;
    vec3 light = matt(s, max(color, vec3(0.0)), s.normal);
    light += s.surface == RUBBER ? 0.04 * view.sunlight.rgb * gleam(s, s.normal, 12.0) : vec3(0.0);
    // Signs reflect a little light, and are lit at dusk.
    vec3 sheen = 0.05 * view.horizon.rgb * fresnel(dot(s.normal, s.to_eye), 0.1);
    light += s.surface == SIGN ? sheen + sign * view.ground.w * 0.35 : vec3(0.0);
    vec3 lamp = s.color * (0.55 + 5.5 * view.ground.w) + 0.2 * light;
    finish(s, s.surface == LAMP ? lamp : light);
}
