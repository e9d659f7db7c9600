#version 450
// Writes the owner of a pixel; the depth test selects the nearest.

layout(location = 0) flat in uvec2 owner;
layout(location = 0) out uvec2 visibility;

void main() {
    visibility = owner;
}
