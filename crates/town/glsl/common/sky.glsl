// Returns the light from a direction of the clear sky.
vec3 clear_sky(vec3 dir) {
    float up = clamp(dir.z, 0.0, 1.0);
    float low = 1.0 - up;
    float low2 = low * low;
    vec3 color = mix(view.zenith.rgb, view.horizon.rgb, low2 * low2 * (0.6 + 0.4 * low));
    float near_sun = max(dot(dir, view.sun.xyz), 0.0);
    float n2 = near_sun * near_sun;
    float n8 = n2 * n2 * n2 * n2;
    return color + view.sunlight.rgb * (0.035 * n8 + 0.16 * n8 * n8 * n8 * n8);
}

// Returns the cloud cover in [0, 1], and the density.
vec2 clouds(vec3 dir, int octaves) {
    vec2 at = dir.xy / (max(dir.z, 0.0) + 0.12) * 1.1 + view.scale.z;
    float sum = 0.0;
    float size = 0.5;
    for (int i = 0; i < octaves; i++) {
        sum += size * noise(at, 90u + uint(i));
        at = at * 2.17 + 3.7;
        size *= 0.5;
    }
    float share = view.zenith.w;
    float cover = smoothstep(0.66 - 0.42 * share, 0.92 - 0.42 * share, sum / (1.0 - 2.0 * size) + 0.08);
    return vec2(cover * smoothstep(0.0, 0.16, dir.z), sum);
}

vec3 cloudy(vec3 color, vec3 dir, vec2 cloud) {
    float near_sun = max(dot(dir, view.sun.xyz), 0.0);
    vec3 white = 0.75 * view.horizon.rgb + view.sunlight.rgb * (0.10 + 0.14 * near_sun * near_sun * near_sun);
    return mix(color, white * (1.18 - 0.5 * cloud.y), 0.85 * cloud.x);
}

// Returns the light that a mirror on the street reflects: sky above surrounding roofs, ground below.
vec3 mirrored(vec3 dir, float blur) {
    vec3 sky = cloudy(clear_sky(dir), dir, clouds(dir, 2));
    float length_xy = inversesqrt(dot(dir.xy, dir.xy) + 1e-4);
    vec2 around = dir.xy * length_xy;
    float roofs = 0.16 + 0.30 * noise(around * 5.0, 71u) + 0.10 * floor(3.0 * noise(around * 13.0, 72u)) / 3.0;
    float above = smoothstep(-0.02 - blur, 0.02 + blur, dir.z * length_xy - roofs);
    vec3 house = (0.30 * view.horizon.rgb + 0.05 * view.sunlight.rgb) * (0.45 + 0.6 * noise(around * 23.0, 73u));
    vec3 color = mix(house, sky, above);
    return mix(view.ground.rgb * 0.5, color, smoothstep(-0.04 - blur, 0.02 + blur, dir.z));
}
