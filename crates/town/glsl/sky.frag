#version 450
// Renders sky, clouds and sun.

// include common/view.glsl
// include common/finish.glsl
// include common/noise.glsl
// include common/sky.glsl
layout(location = 0) out vec4 color_out;

void main() {
    vec3 grid = vec3(gl_FragCoord.xy, 1.0);
    vec3 dir = normalize(vec3(dot(view.ray_x.xyz, grid), dot(view.ray_y.xyz, grid), dot(view.ray_z.xyz, grid)));
    vec3 color = cloudy(clear_sky(dir), dir, clouds(dir, 5));
    float disc = smoothstep(0.99985, 0.99993, dot(dir, view.sun.xyz));
    color += view.sunlight.rgb * 12.0 * disc;
    color_out = vec4(mix(developed(color), vec3(0.0), view.sun.w), 1.0);
}
