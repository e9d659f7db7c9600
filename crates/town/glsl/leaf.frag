#version 450
// Shades tree crowns: clusters of leaves with random orientation, dark gaps, bright where the sun shines through.

// include common/view.glsl
// include common/finish.glsl
// include common/noise.glsl
// include common/sample.glsl
// include common/shade.glsl

// Returns the offset to the nearest of jittered centres, one per unit cell, and a hash of it in w.
vec4 cluster(vec3 p, uint seed) {
    vec3 cell = floor(p - 0.5);
    vec4 best = vec4(0.0, 0.0, 0.0, 0.0);
    float nearest = 9.0;
    for (int i = 0; i < 8; i++) {
        vec3 corner = cell + vec3(float(i & 1), float((i >> 1) & 1), float(i >> 2));
        uint h = hash(ivec2(corner.xy), seed + uint(int(corner.z)) * 7919u);
        vec3 jitter = vec3(float(h & 1023u), float((h >> 10) & 1023u), float((h >> 20) & 1023u)) / 1023.0;
        vec3 away = corner + jitter - p;
        float distance2 = dot(away, away);
        bool closer = distance2 < nearest;
        best = closer ? vec4(away, jitter.x) : best;
        nearest = closer ? distance2 : nearest;
    }
    return best;
}

void main() {
    Sample s = sample_here();
    vec4 twig = cluster(s.place * 2.2, s.seed);
    vec4 leaf = cluster(s.place * 9.0, s.seed + 5u);
    float twigs = detail(s, 0.35);
    float leaves = detail(s, 0.09);
    vec3 normal = normalize(s.normal - 0.55 * twigs * twig.xyz - 0.75 * leaves * leaf.xyz);
    float gaps = 1.0 - 0.55 * twigs * smoothstep(0.20, 0.75, dot(twig.xyz, twig.xyz));
    gaps *= 1.0 - 0.50 * leaves * smoothstep(0.15, 0.6, dot(leaf.xyz, leaf.xyz));
    float tone = 1.0 + 0.45 * leaves * (leaf.w - 0.5) + 0.25 * twigs * (twig.w - 0.5);
    vec3 warm = mix(s.color, s.color * vec3(1.25, 1.08, 0.6), clamp(twig.w * 0.7, 0.0, 1.0));
    vec3 color = warm * tone * gaps;
    // Lower leaves see less of the sky.
    float open = 0.62 + 0.38 * smoothstep(-0.8, 0.9, s.normal.z);
    vec3 light = matt(s, color, normal) * open;
    float through = max(dot(-s.normal, view.sun.xyz) * 0.5 + 0.4, 0.0) * max(dot(-s.to_eye, view.sun.xyz), 0.0);
    light += color * vec3(1.1, 1.25, 0.35) * view.sunlight.rgb * 0.35 * through * gaps;
    finish(s, light);
}
