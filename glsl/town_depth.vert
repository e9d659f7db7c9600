#version 450
// Corners to a depth map: orthographic, as the sun or the sky sees them.

layout(push_constant) uniform TownDraw {
    vec4 clip_x; // clip_from_mesh, row by row
    vec4 clip_y;
    vec4 clip_z;
} push;

layout(location = 0) in vec3 position;

void main() {
    vec4 p = vec4(position, 1.0);
    gl_Position = vec4(dot(push.clip_x, p), dot(push.clip_y, p), dot(push.clip_z, p), 1.0);
}
