#version 300 es
// Projects a splat to the screen (Kerbl et al. 2023; Zwicker et al. 2001) and computes its colour.
// Fragment i is the i-th splat in drawing order; shader.vert reads it for each corner of the splat.
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D order; // far to near
uniform usampler2D splats; // two texels per splat: position, red, green; covariance, blue, opacity
uniform usampler2D harmonics;
uniform mat3 turn; // columns: right, down, forward
uniform vec3 eye;
uniform vec2 focal, half_size; // pixels
uniform float near;
uniform int degree, words, antialias, count;
layout(location = 0) out uvec4 ellipse; // centre (floats), half axes of 1 sigma (halves)
layout(location = 1) out uvec2 paint; // red, green, blue, opacity (halves); opacity 0: not drawn

float sh_half(int splat, int k)
{
    int at = splat * words + (k >> 1);
    vec2 two = unpackHalf2x16(texelFetch(harmonics, ivec2(at & 2047, at >> 11), 0).r);
    return (k & 1) == 0 ? two.x : two.y;
}

vec3 sh(int splat, int k) { return vec3(sh_half(splat, 3 * k), sh_half(splat, 3 * k + 1), sh_half(splat, 3 * k + 2)); }

vec3 by_direction(int splat, vec3 d)
{
    float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
    vec3 c = vec3(0);
    if (degree < 1) return c;
    c += 0.48860251 * (-y * sh(splat, 0) + z * sh(splat, 1) - x * sh(splat, 2));
    if (degree < 2) return c;
    c += 1.09254843 * (x * y * sh(splat, 3) - y * z * sh(splat, 4) - x * z * sh(splat, 6)) +
         0.31539157 * (2.0 * zz - xx - yy) * sh(splat, 5) + 0.54627422 * (xx - yy) * sh(splat, 7);
    if (degree < 3) return c;
    c += -0.59004359 * (y * (3.0 * xx - yy) * sh(splat, 8) + x * (xx - 3.0 * yy) * sh(splat, 14)) +
         2.89061144 * x * y * z * sh(splat, 9) + 1.44530572 * z * (xx - yy) * sh(splat, 13) -
         0.45704580 * (4.0 * zz - xx - yy) * (y * sh(splat, 10) + x * sh(splat, 12)) +
         0.37317633 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * sh(splat, 11);
    return c;
}

void main()
{
    ellipse = uvec4(0);
    paint = uvec2(0);
    int row = int(gl_FragCoord.y) * 2048 + int(gl_FragCoord.x);
    if (row >= count) return;
    int splat = int(texelFetch(order, ivec2(row & 2047, row >> 11), 0).r);
    ivec2 at = ivec2((splat & 1023) * 2, splat >> 10);
    uvec4 a = texelFetch(splats, at, 0), b = texelFetch(splats, at + ivec2(1, 0), 0);
    vec3 away = uintBitsToFloat(a.xyz) - eye, p = away * turn;
    float opacity = float(b.w >> 16) / 65535.0;

    if (p.z < near || opacity < 1.0 / 255.0) return;
    // For splats outside 1.3 times the field of view, the Jacobian of the projection is computed at
    // this limit, as in the reference implementation.
    vec2 flat_at = p.xy / p.z, limit = 1.3 * half_size / focal, t = clamp(flat_at, -limit, limit);
    vec2 m01 = unpackHalf2x16(b.x), m23 = unpackHalf2x16(b.y), m45 = unpackHalf2x16(b.z);
    mat3 sigma = mat3(m01.x, m01.y, m23.x, m01.y, m23.y, m45.x, m23.x, m45.x, m45.y) / 1024.0;
    vec3 jx = focal.x / p.z * (turn[0] - t.x * turn[2]);
    vec3 jy = focal.y / p.z * (turn[1] - t.y * turn[2]);
    vec3 sx = sigma * jx, sy = sigma * jy;
    float xx = dot(jx, sx) + 0.3, xy = dot(jx, sy), yy = dot(jy, sy) + 0.3;
    // If the clip was trained with antialiasing, the opacity is divided by the factor by which the
    // dilation by 0.3 enlarges the area of the ellipse.
    if (antialias != 0) {
        float area = (xx - 0.3) * (yy - 0.3) - xy * xy, det = xx * yy - xy * xy;
        opacity *= sqrt(max(area / det, 2.5e-5));
        if (opacity < 1.0 / 255.0) return;
    }
    float mid = 0.5 * (xx + yy), off = length(vec2(0.5 * (xx - yy), xy));
    float large = mid + off, small = max(mid - off, 0.1);
    vec2 axis = abs(xy) > 1e-6 * mid ? normalize(vec2(xy, large - xx)) : xx >= yy ? vec2(1, 0) : vec2(0, 1);
    vec2 u = sqrt(large) * axis, v = sqrt(small) * vec2(-axis.y, axis.x), to_clip = vec2(1, -1) / half_size;
    u = clamp(u * to_clip, -6e4, 6e4);
    v = clamp(v * to_clip, -6e4, 6e4);
    vec3 base = vec3(uvec3(a.w, a.w >> 16, b.w) & 65535u) * (4.0 / 65535.0) - 1.0;
    vec3 colour = max(base + by_direction(splat, normalize(away)), 0.0);
    ellipse = uvec4(floatBitsToUint(focal * flat_at * to_clip), packHalf2x16(u), packHalf2x16(v));
    paint = uvec2(packHalf2x16(colour.rg), packHalf2x16(vec2(colour.b, opacity)));
}
