// Surface and light of a sample.
layout(set = 0, binding = 3) uniform texture2D lights;

layout(location = 0) out vec4 color_out;

struct Sample {
    vec3 place;    // town, m
    vec3 to_eye;   // unit
    float away;    // m
    float sample_m; // width of the sample on the surface
    vec3 normal;
    vec3 color;    // linear
    uint surface;
    uint seed;
    vec2 uv;       // m
    float sun; // visible share of the sun
    float sky; // visible share of the sky
};

vec3 linear_from_srgb(vec3 c) {
    vec3 power = pow((c + 0.055) / 1.055, vec3(2.4));
    return mix(power, c / 12.92, vec3(lessThanEqual(c, vec3(0.04045))));
}

Sample sample_here() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    uvec4 surface = texelFetch(surfaces, at, 0);
    vec2 light = texelFetch(lights, at, 0).xy;
    float depth = texelFetch(depths, at, 0).x;
    vec3 seen = from_camera(depth);

    Sample s;
    s.place = vec3(view.ray_x.w, view.ray_y.w, view.ray_z.w) + seen;
    s.away = length(seen);
    s.to_eye = -seen / s.away;
    s.normal = unpacked_normal(surface.x);
    s.sample_m = view.scale.x / max(depth, 1e-7) * view.scale.y * inversesqrt(clamp(dot(s.normal, s.to_eye), 0.02, 1.0));
    vec3 rgb = vec3(float(surface.y & 255u), float((surface.y >> 8) & 255u), float((surface.y >> 16) & 255u));
    s.color = linear_from_srgb(rgb / 255.0);
    s.surface = surface.y >> 24;
    s.seed = surface.z;
    s.uv = vec2(float(int(surface.w << 16) >> 16), float(int(surface.w) >> 16)) / 512.0;
    s.sun = light.x;
    s.sky = light.y;
    return s;
}

// Returns the weight of a pattern with features of this length, m, at the sample's width; at 0 it fades to its mean.
float detail(Sample s, float feature_m) {
    return 1.0 - smoothstep(0.25, 0.9, s.sample_m / feature_m);
}

vec3 skylight(vec3 normal) {
    vec3 above = 0.62 * view.zenith.rgb + 0.38 * view.horizon.rgb;
    return mix(view.ground.rgb, above, 0.5 + 0.5 * normal.z);
}

// Returns the light that a matt surface reflects.
vec3 matt(Sample s, vec3 color, vec3 normal) {
    float facing = max(dot(normal, view.sun.xyz), 0.0) * s.sun;
    return color * (view.sunlight.rgb * facing + skylight(normal) * s.sky);
}

// Returns the share of light that a smooth surface reflects, after Schlick (1994).
float fresnel(float cosine, float least) {
    float x = 1.0 - clamp(cosine, 0.0, 1.0);
    float x2 = x * x;
    return least + (1.0 - least) * x2 * x2 * x;
}

// Returns the specular highlight of the sun; high powers are sharp.
float gleam(Sample s, vec3 normal, float power) {
    vec3 halfway = normalize(view.sun.xyz + s.to_eye);
    return pow(max(dot(normal, halfway), 0.0), power) * s.sun;
}

void finish(Sample s, vec3 light) {
    vec3 air = 0.8 * view.horizon.rgb + 0.06 * view.sunlight.rgb;
    vec3 seen = mix(air, light, exp(-view.horizon.w * s.away));
    // No branch here: lavapipe recompiles the shader for every image if a uniform decides on a branch.
    vec3 shown = mix(developed(seen), s.color, view.sun.w);
    color_out = vec4(shown, 1.0);
}
