#version 450
// Covers all samples with one triangle at one depth.

layout(push_constant) uniform TownScreen {
    float depth;
} push;

void main() {
    uint corner = uint(gl_VertexIndex);
    float x = (corner & 1u) == 0u ? -1.0 : 3.0;
    float y = (corner & 2u) == 0u ? -1.0 : 3.0;
    gl_Position = vec4(x, y, push.depth, 1.0);
}
