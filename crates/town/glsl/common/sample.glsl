// Data of a sample, written by `surface.frag`.
layout(set = 0, binding = 1) uniform utexture2D surfaces;
layout(set = 0, binding = 2) uniform texture2D depths;

// Decodes an octahedral normal (Cigolle et al. 2014) to a unit vector.
vec3 unpacked_normal(uint word) {
    vec2 folded = unpackSnorm2x16(word);
    vec3 n = vec3(folded, 1.0 - abs(folded.x) - abs(folded.y));
    float under = max(-n.z, 0.0);
    n.x += n.x >= 0.0 ? -under : under;
    n.y += n.y >= 0.0 ? -under : under;
    return normalize(n);
}

// Returns the vector from the camera to the surface of the sample, town axes, m; depth is NEAR / z.
vec3 from_camera(float depth) {
    vec3 grid = vec3(gl_FragCoord.xy, 1.0);
    vec3 ray = vec3(dot(view.ray_x.xyz, grid), dot(view.ray_y.xyz, grid), dot(view.ray_z.xyz, grid));
    return ray * (view.scale.x / max(depth, 1e-7));
}
