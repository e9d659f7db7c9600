#version 450
// Writes down whose pixel it is; the depth test does the rest.

layout(location = 0) flat in uvec2 owner;
layout(location = 0) out uvec2 visibility;

void main() {
    visibility = owner;
}
