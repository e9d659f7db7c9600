#version 450
// Projects vertices to the samples of a view; depth is NEAR / z, 1 at the near plane and 0 at infinity.

layout(push_constant) uniform TownSurfaceDraw {
    vec4 clip_x; // clip_from_mesh, row by row: x, y, and camera z
    vec4 clip_y;
    vec4 camera_z;
    vec4 turn_x; // rotation of town_from_mesh, row by row; w unused
    vec4 turn_y;
    vec4 turn_z;
    uint draw; // draw index + 1
    float near_m;
} push;

layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 uv;
layout(location = 3) in uint rgba;
layout(location = 4) in uint surface;

layout(location = 0) out vec3 town_normal;
layout(location = 1) out vec2 surface_uv;
layout(location = 2) flat out uvec4 what; // color and surface, seed, vertex, draw

void main() {
    vec4 p = vec4(position, 1.0);
    gl_Position = vec4(dot(push.clip_x, p), dot(push.clip_y, p), push.near_m, dot(push.camera_z, p));
    town_normal = vec3(dot(push.turn_x.xyz, normal), dot(push.turn_y.xyz, normal), dot(push.turn_z.xyz, normal));
    surface_uv = uv;
    what = uvec4((rgba & 0xffffffu) | (surface << 24), surface >> 8, uint(gl_VertexIndex), push.draw);
}
