#version 450
// Shades asphalt, road paint, slabs and grass.

// include common/view.glsl
// include common/finish.glsl
// include common/noise.glsl
// include common/sample.glsl
// include common/shade.glsl

const uint SIDEWALK = 2u;
const uint PAINT = 3u;
const uint GRASS = 4u;

// Returns the tone of asphalt, around 1: grain, patches, stains, cracks.
float asphalt(Sample s, vec2 p) {
    float grain = (random(ivec2(floor(p * 90.0)), 11u) - 0.5) * detail(s, 0.022);
    float coarse = (noise(p * 31.0, 12u) - 0.5) * detail(s, 0.06);
    float patches = rough(p * 0.55, 13u) - 0.5;
    float stains = noise(p * vec2(0.16, 0.13), 14u) - 0.5;
    float wander = noise(p * 0.62 + 0.35 * coarse, 15u) - 0.5;
    float crack = 1.0 - smoothstep(0.0, 0.006 + 0.4 * s.sample_m, abs(wander));
    crack *= smoothstep(0.52, 0.62, noise(p * 0.11, 16u)) * detail(s, 0.10);
    return 1.0 + 0.40 * grain + 0.22 * coarse + 0.26 * patches + 0.24 * stains - 0.5 * crack;
}

float slabs(Sample s, vec2 uv) {
    vec2 slab = uv / vec2(0.8, 0.8);
    slab.x += 0.5 * float(int(floor(slab.y)) & 1);
    ivec2 cell = ivec2(floor(slab));
    vec2 border = min(fract(slab), 1.0 - fract(slab)) * 0.8;
    float width = 0.008 + 0.35 * s.sample_m;
    float joint = 1.0 - smoothstep(width * 0.6, width, min(border.x, border.y));
    float tone = (random(cell, 21u + s.seed) - 0.5) * detail(s, 0.8);
    return 1.0 + 0.2 * tone - 0.42 * joint * detail(s, 0.06 + 0.05);
}

vec3 grass(Sample s, vec3 color, vec2 p) {
    float blades = (noise(p * vec2(38.0, 31.0), 31u) - 0.5) * detail(s, 0.05);
    float tufts = (noise(p * 6.1, 32u) - 0.5) * detail(s, 0.3);
    float patches = rough(p * 0.35, 33u);
    vec3 dry = mix(color, vec3(color.g * 0.95, color.g * 0.82, color.b * 0.7), 0.55);
    return mix(color, dry, smoothstep(0.45, 0.75, patches)) * (1.0 + 0.9 * blades + 0.5 * tufts);
}

void main() {
    Sample s = sample_here();
    vec2 p = s.place.xy;
    bool stands = abs(s.normal.z) < 0.5;
    p = stands ? s.uv : p;
    float road = asphalt(s, p);
    float worn = smoothstep(0.30, 0.46, rough(p * 2.3, 41u) + 0.35 * (noise(p * 47.0, 42u) - 0.5) * detail(s, 0.04));
    vec3 paint = mix(vec3(0.09), s.color, 0.30 + 0.70 * worn) * (0.55 + 0.45 * road);
    float dirt = 0.86 + 0.28 * rough(p * 0.9, 43u);
    float grit = 1.0 + 0.22 * (noise(p * 60.0, 44u) - 0.5) * detail(s, 0.03);
    vec3 slab = s.color * slabs(s, stands ? vec2(s.uv.x, 0.4) : s.uv) * dirt * grit;
    vec3 color = s.color * road;
    color = s.surface == SIDEWALK ? slab : color;
    color = s.surface == PAINT ? paint : color;
    color = s.surface == GRASS ? grass(s, s.color, p) : color;
    // At grazing angles a road reflects some of the sky.
    float cosine = max(dot(s.normal, s.to_eye), 0.0);
    vec3 sheen = 0.22 * fresnel(cosine, 0.0) * (s.surface == GRASS ? 0.0 : s.sky) * view.horizon.rgb;
    finish(s, matt(s, max(color, vec3(0.0)), s.normal) + sheen);
}
