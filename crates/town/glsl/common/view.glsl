// View of the town and its light; matches `ViewBlock` in src/town/view/shade.rs.
layout(set = 0, binding = 0) uniform TownView {
    vec4 ray_x; // town ray of a sample with camera z 1, from (sample x, sample y, 1); w: the camera's position, m
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
    vec4 sun; // unit direction towards the sun; w: 1 to show bare colors
    vec4 sunlight; // w: exposure
    vec4 zenith; // w: share of clouds
    vec4 horizon; // w: haze per meter
    vec4 ground; // light from below; w: brightness of lamps
    vec4 scale; // near plane m, meters per sample at 1 m, shift of the cloud pattern, unused
} view;
