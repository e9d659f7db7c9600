#version 450
// Shades house windows: reflection of the street, and a room or curtains behind.

// include common/view.glsl
// include common/finish.glsl
// include common/noise.glsl
// include common/sample.glsl
// include common/shade.glsl
// include common/sky.glsl

const float ROOM_M = 3.2;
const float CEILING_M = 1.9; // above the pane's first corner
const float FLOOR_M = -1.0;

// Returns the color where a straight ray hits a box-shaped room behind the pane.
vec3 room(Sample s, vec3 inward, vec3 along, float lit, float shop) {
    vec2 slope = vec2(dot(-s.to_eye, along), -s.to_eye.z) / max(dot(-s.to_eye, inward), 0.05);
    float width = ROOM_M * 0.5;
    float u = shop > 0.5 ? (fract(s.uv.x / 3.2) - 0.5) * 3.2 : s.uv.x - 0.6;
    float to_side = ((slope.x > 0.0 ? width : -width) - u) / (abs(slope.x) < 1e-3 ? 1e-3 : slope.x);
    float to_level = ((slope.y > 0.0 ? CEILING_M : FLOOR_M) - s.uv.y) / (abs(slope.y) < 1e-3 ? 1e-3 : slope.y);
    float back = shop > 0.5 ? 1.1 : ROOM_M;
    float deep = min(back, min(max(to_side, 0.0), max(to_level, 0.0)));
    vec2 hit = vec2(u, s.uv.y) + slope * deep;
    float tone = 0.35 + 0.5 * unit(hash(ivec2(3, 5), s.seed));
    vec3 wall = mix(vec3(0.75, 0.66, 0.52), vec3(0.55, 0.60, 0.66), unit(hash(ivec2(4, 1), s.seed))) * tone;
    float shelf = step(0.55, noise(hit * vec2(1.7, 1.2), s.seed + 1u)) * step(hit.y, 0.9);
    wall *= 1.0 - 0.55 * shelf * (1.0 - shop);
    // The goods of a shop are in rows.
    vec2 row = hit * vec2(2.6, 2.1);
    uint thing = hash(ivec2(floor(row)), s.seed);
    vec2 border = abs(fract(row) - 0.5);
    bool goods = unit(thing) < 0.75 && border.x < 0.36 && border.y < 0.40 && hit.y < 1.6;
    vec3 dye = vec3(float(thing & 255u), float((thing >> 8) & 255u), float((thing >> 16) & 255u)) / 255.0;
    dye = mix(vec3(dot(dye, vec3(0.33))), dye, 0.45);
    wall = shop > 0.5 && goods ? 0.05 + 0.6 * dye * dye : wall;
    bool ceiling = to_level < min(to_side, back) && slope.y > 0.0;
    wall = ceiling ? vec3(0.8) : wall;
    vec3 daylight = skylight(vec3(0.0, 0.0, 0.3)) * 0.42 * s.sky * exp(-0.30 * deep);
    vec3 lamp = vec3(1.0, 0.64, 0.30) * (lit + 0.30 * shop) * (0.45 + 0.45 * exp(-abs(hit.y - 1.4)));
    return wall * (daylight + lamp);
}

void main() {
    Sample s = sample_here();
    vec3 along = normalize(vec3(-s.normal.y, s.normal.x, 0.0) + vec3(1e-5, 0.0, 0.0));
    uint kind = hash(ivec2(7, 7), s.seed);
    float chance = unit(kind);
    float lit = unit(kind * 747796405u) < 0.42 ? view.ground.w : 0.0;
    // Panes with their lower edge near the ground belong to shops and doors.
    float shop = s.place.z - s.uv.y < 0.75 ? 1.0 : 0.0;
    lit = shop > 0.5 ? 0.55 * view.ground.w : lit;
    vec3 inside = room(s, -s.normal, along, lit, shop);

    // Some windows have curtains at both sides or a blind from above.
    float folds = 0.75 + 0.25 * cos(s.uv.x * 55.0) * detail(s, 0.12);
    float drawn = 0.12 + 0.35 * unit(kind * 2891336453u);
    bool at_side = s.uv.x < drawn || (s.uv.x > 1.2 - drawn && s.uv.x < 1.35);
    bool curtain = chance < 0.45 && at_side && shop < 0.5;
    bool blind = chance > 0.80 && s.uv.y > 0.3 + unit(kind * 3266489917u) && shop < 0.5;
    vec3 cloth = mix(vec3(0.62, 0.58, 0.50), vec3(0.50, 0.30, 0.26), unit(kind * 1181783497u) * 0.6);
    vec3 behind = cloth * folds * (skylight(s.normal) * 0.45 * s.sky + vec3(1.0, 0.60, 0.30) * lit * 0.4);
    inside = curtain || blind ? behind : inside;

    // Panes are not perfectly flat or vertical.
    vec2 wave = vec2(noise(s.place.xy * 1.3 + s.place.z, 81u), noise(s.place.yx * 1.1 - s.place.z, 82u)) - 0.5;
    float lean = (unit(kind * 277803737u) - 0.5) * 0.03;
    vec3 normal = normalize(s.normal + along * (wave.x * 0.02 + lean) + vec3(0.0, 0.0, wave.y * 0.02 + lean));
    vec3 dir = reflect(-s.to_eye, normal);
    float share = fresnel(dot(normal, s.to_eye), 0.17);
    vec3 mirror = mirrored(dir, 0.02) * mix(0.6, 1.0, s.sky);
    vec3 sun = view.sunlight.rgb * gleam(s, normal, 900.0) * 6.0;
    finish(s, inside * (1.0 - share) * mix(vec3(1.0), s.color, 0.25) + mirror * share + sun);
}
