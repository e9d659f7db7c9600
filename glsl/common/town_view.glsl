// A view of the town and its light; `ViewBlock` in src/town/view/shade.rs is the same.
layout(set = 0, binding = 0) uniform TownView {
    vec4 ray_x; // town ray of a sample with camera z 1, from (sample x, sample y, 1); fourths: the camera's place, m
    vec4 ray_y;
    vec4 ray_z;
    vec4 near_x; // fine sun map from (place - camera, 1): texel x, texel y, depth
    vec4 near_y;
    vec4 near_z;
    vec4 far_x; // coarse sun map
    vec4 far_y;
    vec4 far_z;
    vec4 over_x; // map from above
    vec4 over_y;
    vec4 over_z;
    vec4 sun;     // unit, towards it; fourth: 1 to show bare colors
    vec4 sunlight; // fourth: exposure
    vec4 zenith;  // fourth: share of clouds
    vec4 horizon; // fourth: haze per metre
    vec4 ground;  // light from below; fourth: how much lamps are lit
    vec4 scale;   // near plane m, metres per sample at 1 m, pattern of clouds, nothing
} view;
