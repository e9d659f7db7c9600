#version 450
// Resolves samples at half-pixel steps to pixels: color with the tent filter 1-2-1, triangle and draw from the sample
// at the pixel's centre.

layout(set = 0, binding = 7) uniform utexture2D owners;
layout(set = 0, binding = 8) uniform texture2D colors;

layout(location = 0) out uvec2 shown; // provoking vertex; draw index + 1
layout(location = 1) out uint color; // sRGB

vec3 srgb_from_linear(vec3 c) {
    vec3 power = 1.055 * pow(max(c, vec3(1e-6)), vec3(1.0 / 2.4)) - 0.055;
    return mix(power, c * 12.92, vec3(lessThanEqual(c, vec3(0.0031308))));
}

void main() {
    ivec2 middle = 2 * ivec2(gl_FragCoord.xy) + 1;
    vec3 sum = vec3(0.0);
    for (int y = -1; y <= 1; y++) {
        for (int x = -1; x <= 1; x++) {
            float weight = float((2 - abs(x)) * (2 - abs(y)));
            sum += weight * texelFetch(colors, middle + ivec2(x, y), 0).xyz;
        }
    }
    uvec3 rgb = uvec3(floor(clamp(srgb_from_linear(sum / 16.0), vec3(0.0), vec3(1.0)) * 255.0 + 0.5));
    shown = texelFetch(owners, middle, 0).xy;
    color = rgb.x | (rgb.y << 8) | (rgb.z << 16);
}
