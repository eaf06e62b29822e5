#version 300 es
// Computes one corner of the quad around the ellipse of a splat, which project.frag has computed.
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D ellipses, paints;
uniform int first; // first row of the batch
uniform float most; // largest reach, in standard deviations
out vec2 place;
flat out vec4 colour;

void main()
{
    int row = first + (gl_VertexID >> 2);
    ivec2 at = ivec2(row & 2047, row >> 11);
    uvec4 e = texelFetch(ellipses, at, 0);
    uvec2 paint = texelFetch(paints, at, 0).rg;

    colour = vec4(unpackHalf2x16(paint.x), unpackHalf2x16(paint.y));
    gl_Position = vec4(0, 0, 2, 1);
    place = vec2(0);
    if (colour.a == 0.0) return;
    // The quad ends where the opacity falls to 1/255, or at `most` standard deviations.
    float reach = min(most, sqrt(2.0 * log(max(255.0 * colour.a, 1.0))));
    place = reach * vec2((gl_VertexID & 1) * 2 - 1, (gl_VertexID & 2) - 1);
    gl_Position = vec4(uintBitsToFloat(e.xy) + place.x * unpackHalf2x16(e.z) + place.y * unpackHalf2x16(e.w), 0, 1);
}
