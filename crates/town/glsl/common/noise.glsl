// Pseudo-random numbers that depend only on a position and a seed.
uint hash(ivec2 p, uint seed) {
    uint h = uint(p.x) * 0x9e3779b1u ^ uint(p.y) * 0x85ebca77u ^ seed * 0xc2b2ae3du;
    h = (h ^ (h >> 15)) * 0x2c1b3c6du;
    h = (h ^ (h >> 13)) * 0x297a2d39u;
    return h ^ (h >> 16);
}

// Converts 24 bits to [0, 1).
float unit(uint h) {
    return float(h >> 8) * (1.0 / 16777216.0);
}

float random(ivec2 p, uint seed) {
    return unit(hash(p, seed));
}

// Returns smooth noise in [0, 1) with features of length 1.
float noise(vec2 p, uint seed) {
    vec2 cell = floor(p);
    ivec2 c = ivec2(cell);
    vec2 t = p - cell;
    t = t * t * (3.0 - 2.0 * t);
    float low = mix(random(c, seed), random(c + ivec2(1, 0), seed), t.x);
    float high = mix(random(c + ivec2(0, 1), seed), random(c + ivec2(1, 1), seed), t.x);
    return mix(low, high, t.y);
}

float rough(vec2 p, uint seed) {
    return 0.65 * noise(p, seed) + 0.35 * noise(3.1 * p + 7.3, seed + 1u);
}
