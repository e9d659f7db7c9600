#version 450
// Writes the surface of each sample for later shading.

layout(location = 0) in vec3 town_normal;
layout(location = 1) in vec2 surface_uv;
layout(location = 2) flat in uvec4 what;

layout(location = 0) out uvec4 surface; // normal, color and surface, seed, uv
layout(location = 1) out uvec2 owner; // provoking vertex of the triangle, draw index + 1

const float STEPS_PER_M = 512.0; // resolution of uv in 16 bits

void main() {
    vec3 n = gl_FrontFacing ? town_normal : -town_normal;
    n = n / (abs(n.x) + abs(n.y) + abs(n.z) + 1e-12);
    vec2 folded = vec2(1.0 - abs(n.y), 1.0 - abs(n.x));
    folded = vec2(n.x >= 0.0 ? folded.x : -folded.x, n.y >= 0.0 ? folded.y : -folded.y);
    vec2 octahedral = n.z >= 0.0 ? n.xy : folded;
    ivec2 uv = ivec2(floor(surface_uv * STEPS_PER_M));
    uint packed_uv = (uint(uv.x) & 0xffffu) | (uint(uv.y) << 16);
    surface = uvec4(packSnorm2x16(octahedral), what.x, what.y, packed_uv);
    owner = uvec2(what.z, what.w);
}
