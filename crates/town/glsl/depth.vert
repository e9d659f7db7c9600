#version 450
// Projects vertices to a depth map, orthographically along the rays of the sun or from above.

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
