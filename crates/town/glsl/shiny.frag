#version 450
// Shades car paint with a clear coat, vehicle windows and metal.

// include common/view.glsl
// include common/finish.glsl
// include common/noise.glsl
// include common/sample.glsl
// include common/shade.glsl
// include common/sky.glsl

const uint GLASS = 8u;
const uint PAINT = 9u;

void main() {
    Sample s = sample_here();
    vec3 dir = reflect(-s.to_eye, s.normal);
    float cosine = dot(s.normal, s.to_eye);
    vec3 mirror = mirrored(dir, s.surface == PAINT || s.surface == GLASS ? 0.03 : 0.35) * mix(0.35, 1.0, s.sky);

    // Paint: a matt base, partly metal flakes, with the clear coat on top.
    float flakes = (random(ivec2(floor(s.uv * 400.0)), s.seed) - 0.5) * detail(s, 0.004);
    float metallic = 0.15 + 0.45 * unit(hash(ivec2(1, 2), s.seed));
    float dirt = smoothstep(0.75, 0.1, s.place.z) * (0.25 + 0.3 * noise(s.place.xy * 3.0 + s.place.z, 83u));
    vec3 base = s.color * (1.0 + 0.15 * flakes);
    vec3 ground = mix(matt(s, base, s.normal), base * mirror * 1.6, metallic * 0.35);
    ground += base * view.sunlight.rgb * gleam(s, s.normal, 24.0) * metallic * 0.6;
    float coat = fresnel(cosine, 0.045);
    vec3 paint = ground * (1.0 - coat) + mirror * coat + view.sunlight.rgb * gleam(s, s.normal, 700.0) * 2.5;
    paint = mix(paint, matt(s, vec3(0.16, 0.145, 0.125), s.normal), dirt * 0.5);

    // Glass: dark seats behind it.
    float seats = 0.5 + 0.5 * noise(s.uv * 2.1, s.seed + 84u);
    vec3 inside = (0.25 * s.color + 0.012) * seats * skylight(s.normal) * s.sky;
    float share = fresnel(cosine, 0.07);
    vec3 glass = inside * (1.0 - share) + mirror * share + view.sunlight.rgb * gleam(s, s.normal, 900.0) * 4.0;

    // Metal: its reflection is blurred and colored.
    float brushed = 1.0 + 0.25 * (noise(s.uv * vec2(9.0, 30.0), 85u) - 0.5) * detail(s, 0.05);
    vec3 metal = s.color * (0.45 * mirror + 0.55 * matt(s, vec3(1.0), s.normal)) * brushed;
    metal += s.color * view.sunlight.rgb * gleam(s, s.normal, 40.0) * 0.5;

    vec3 light = s.surface == PAINT ? paint : metal;
    finish(s, s.surface == GLASS ? glass : light);
}
