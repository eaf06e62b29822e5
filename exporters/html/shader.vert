#version 300 es
// One corner of the ellipse that a splat makes on the screen (Kerbl et al. 2023; Zwicker et al. 2001).
precision highp float;
precision highp int;
precision highp usampler2D;
layout(location = 0) in uint splat;
uniform usampler2D splats; // two texels a splat: place, red and green; covariance, blue and opacity
uniform usampler2D harmonics;
uniform mat3 turn; // columns: right, down, forward
uniform vec3 eye;
uniform vec2 focal, half_size; // pixels
uniform float near;
uniform int degree, words, antialias;
out vec2 place;
out vec4 colour;

float sh_half(int k)
{
    int at = int(splat) * words + (k >> 1);
    vec2 two = unpackHalf2x16(texelFetch(harmonics, ivec2(at & 2047, at >> 11), 0).r);
    return (k & 1) == 0 ? two.x : two.y;
}

vec3 sh(int k) { return vec3(sh_half(3 * k), sh_half(3 * k + 1), sh_half(3 * k + 2)); }

vec3 by_direction(vec3 d)
{
    float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
    vec3 c = vec3(0);
    if (degree < 1) return c;
    c += 0.48860251 * (-y * sh(0) + z * sh(1) - x * sh(2));
    if (degree < 2) return c;
    c += 1.09254843 * (x * y * sh(3) - y * z * sh(4) - x * z * sh(6)) +
         0.31539157 * (2.0 * zz - xx - yy) * sh(5) + 0.54627422 * (xx - yy) * sh(7);
    if (degree < 3) return c;
    c += -0.59004359 * (y * (3.0 * xx - yy) * sh(8) + x * (xx - 3.0 * yy) * sh(14)) +
         2.89061144 * x * y * z * sh(9) + 1.44530572 * z * (xx - yy) * sh(13) -
         0.45704580 * (4.0 * zz - xx - yy) * (y * sh(10) + x * sh(12)) +
         0.37317633 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * sh(11);
    return c;
}

void main()
{
    ivec2 at = ivec2((int(splat) & 1023) * 2, int(splat) >> 10);
    uvec4 a = texelFetch(splats, at, 0), b = texelFetch(splats, at + ivec2(1, 0), 0);
    vec3 away = uintBitsToFloat(a.xyz) - eye, p = away * turn;
    float opacity = float(b.w >> 16) / 65535.0;

    gl_Position = vec4(0, 0, 2, 1);
    place = vec2(0);
    colour = vec4(0);
    if (p.z < near || opacity < 1.0 / 255.0) return;
    // The slope of the projection is taken no farther out than 1.3 times the picture.
    vec2 flat_at = p.xy / p.z, limit = 1.3 * half_size / focal, t = clamp(flat_at, -limit, limit);
    vec2 m01 = unpackHalf2x16(b.x), m23 = unpackHalf2x16(b.y), m45 = unpackHalf2x16(b.z);
    mat3 sigma = mat3(m01.x, m01.y, m23.x, m01.y, m23.y, m45.x, m23.x, m45.x, m45.y) / 1024.0;
    vec3 jx = focal.x / p.z * (turn[0] - t.x * turn[2]);
    vec3 jy = focal.y / p.z * (turn[1] - t.y * turn[2]);
    vec3 sx = sigma * jx, sy = sigma * jy;
    float xx = dot(jx, sx) + 0.3, xy = dot(jx, sy), yy = dot(jy, sy) + 0.3;
    // Trained antialiased: what the 0.3 adds in width is taken from the opacity.
    if (antialias != 0) {
        float area = (xx - 0.3) * (yy - 0.3) - xy * xy, det = xx * yy - xy * xy;
        opacity *= sqrt(max(area / det, 2.5e-5));
        if (opacity < 1.0 / 255.0) return;
    }
    float mid = 0.5 * (xx + yy), off = length(vec2(0.5 * (xx - yy), xy));
    float large = mid + off, small = max(mid - off, 0.1);
    vec2 axis = abs(xy) > 1e-6 * mid ? normalize(vec2(xy, large - xx)) : xx >= yy ? vec2(1, 0) : vec2(0, 1);
    // Where the opacity falls to 1/255 the ellipse ends.
    float reach = sqrt(2.0 * log(255.0 * opacity));
    place = reach * vec2((gl_VertexID & 1) * 2 - 1, (gl_VertexID >> 1) * 2 - 1);
    vec2 corner = focal * flat_at + place.x * sqrt(large) * axis + place.y * sqrt(small) * vec2(-axis.y, axis.x);
    vec3 base = vec3(uvec3(a.w, a.w >> 16, b.w) & 65535u) * (4.0 / 65535.0) - 1.0;
    colour = vec4(max(base + by_direction(normalize(away)), 0.0), opacity);
    gl_Position = vec4(corner / half_size * vec2(1, -1), 0, 1);
}
