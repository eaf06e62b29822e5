#version 300 es
precision highp float;
in vec2 place;
flat in vec4 colour;
out vec4 pixel;

void main()
{
    float alpha = min(0.99, colour.a * exp(-0.5 * dot(place, place)));
    if (alpha < 1.0 / 255.0) discard;
    pixel = vec4(colour.rgb * alpha, alpha);
}
