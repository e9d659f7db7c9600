// Converts linear light to display values in [0, 1], not yet sRGB. The tone curve is from Narkowicz (2015), "ACES
// filmic tone mapping curve".
vec3 developed(vec3 light) {
    vec3 x = max(light, vec3(0.0)) * view.sunlight.w;
    vec3 shown = clamp(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), vec3(0.0), vec3(1.0));
    // The curve saturates strong colors, unlike cameras of cars.
    return mix(vec3(dot(shown, vec3(0.25, 0.65, 0.10))), shown, 0.82);
}
