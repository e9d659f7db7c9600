#version 450
// Shades plaster, brick, bark, roof tiles, concrete and wood.

// include common/view.glsl
// include common/finish.glsl
// include common/noise.glsl
// include common/sample.glsl
// include common/shade.glsl

const uint BRICK = 6u;
const uint BARK = 13u;
const uint TILES = 14u;
const uint CONCRETE = 15u;
const uint WOOD = 18u;

vec3 plaster(Sample s, vec2 uv) {
    float stains = rough(uv * vec2(0.55, 0.28), s.seed) - 0.5;
    float streaks = (noise(uv * vec2(3.1, 0.22), s.seed + 3u) - 0.5) * detail(s, 0.3);
    float grain = (noise(uv * 55.0, 51u) - 0.5) * detail(s, 0.035);
    float foot = 1.0 - 0.22 * (1.0 - smoothstep(0.0, 0.9, s.place.z + 0.5 * stains));
    return s.color * (1.0 + 0.22 * stains + 0.10 * streaks + 0.20 * grain) * foot;
}

vec3 bricks(Sample s, vec2 uv) {
    vec2 size = vec2(0.25, 0.083);
    vec2 brick = uv / size;
    brick.x += 0.5 * float(int(floor(brick.y)) & 1);
    ivec2 cell = ivec2(floor(brick));
    vec2 border = min(fract(brick), 1.0 - fract(brick)) * size;
    float width = 0.007 + 0.3 * s.sample_m;
    float joint = 1.0 - smoothstep(width * 0.55, width, min(border.x, border.y));
    float left = detail(s, 0.085);
    float tone = random(cell, s.seed + 61u) - 0.5;
    float warm = random(cell, s.seed + 62u) - 0.5;
    float stains = rough(uv * vec2(0.5, 0.35), s.seed + 5u) - 0.5;
    vec3 color = s.color * (1.0 + 0.5 * tone * left) * mix(vec3(1.0), vec3(1.12, 0.98, 0.88), warm * left);
    vec3 mortar = mix(s.color, vec3(0.42, 0.40, 0.37), 0.6);
    float mean_joint = 0.22;
    color = mix(color, mortar, mix(mean_joint, joint, left) * 0.85);
    return color * (1.0 + 0.26 * stains + 0.25 * (noise(uv * 90.0, 63u) - 0.5) * detail(s, 0.02));
}

// Returns the color of tile rows in rgb, and the tilt of the normal along uv.x in w.
vec4 tiles(Sample s, vec2 uv) {
    vec2 size = vec2(0.24, 0.32);
    vec2 tile = uv / size;
    ivec2 cell = ivec2(floor(tile));
    vec2 t = fract(tile);
    float left = detail(s, 0.24);
    float tone = random(cell, s.seed + 64u) - 0.5;
    float moss = rough(uv * 0.5, s.seed + 7u) - 0.5;
    float edge = smoothstep(0.0, 0.16, t.y);
    vec3 color = s.color * (1.0 + 0.36 * tone * left + 0.25 * moss) * mix(0.82, 0.55 + 0.45 * edge, left);
    return vec4(color, (t.x - 0.5) * 1.1 * left);
}

vec3 concrete(Sample s, vec2 uv) {
    float stains = rough(uv * 0.45, s.seed + 8u) - 0.5;
    float streaks = (noise(uv * vec2(2.6, 0.3), s.seed + 9u) - 0.5) * detail(s, 0.3);
    float pores = (noise(uv * 42.0, 65u) - 0.5) * detail(s, 0.04);
    return s.color * (1.0 + 0.20 * stains + 0.14 * streaks + 0.20 * pores);
}

vec3 wood(Sample s, vec2 uv) {
    float plank = uv.x / 0.16;
    float border = min(fract(plank), 1.0 - fract(plank)) * 0.16;
    float gap = 1.0 - smoothstep(0.003, 0.006 + 0.3 * s.sample_m, border);
    float tone = random(ivec2(int(floor(plank)), 3), s.seed + 66u) - 0.5;
    float fibre = (noise(uv * vec2(70.0, 2.2), 67u) - 0.5) * detail(s, 0.03);
    return s.color * (1.0 + 0.30 * tone * detail(s, 0.2) + 0.35 * fibre) * (1.0 - 0.55 * gap * detail(s, 0.1));
}

vec3 bark(Sample s, vec2 uv) {
    float ridges = (noise(vec2(uv.x * 24.0, uv.y * 4.0), 68u) - 0.5) * detail(s, 0.08);
    return s.color * (1.0 + 0.9 * ridges + 0.3 * (rough(uv * 2.0, 69u) - 0.5));
}

void main() {
    Sample s = sample_here();
    vec3 color = plaster(s, s.uv);
    vec3 normal = s.normal;
    vec4 tile = tiles(s, s.uv);
    color = s.surface == BRICK ? bricks(s, s.uv) : color;
    color = s.surface == CONCRETE ? concrete(s, s.uv) : color;
    color = s.surface == WOOD ? wood(s, s.uv) : color;
    color = s.surface == BARK ? bark(s, s.uv) : color;
    vec3 along = normalize(vec3(-s.normal.y, s.normal.x, 0.0) + vec3(1e-5, 0.0, 0.0));
    normal = s.surface == TILES ? normalize(normal + along * tile.w) : normal;
    color = s.surface == TILES ? tile.rgb : color;
    finish(s, matt(s, max(color, vec3(0.0)), normal));
}
