/* Reads what gltf.c writes by the rules of glTF 2.0 and KHR_gaussian_splatting, not by where it put
 * things: node, mesh, accessors by attribute name. Floats only, as gltf.c writes no others. */
#include "exporters/lib/gltf_read.h"

#include <stdio.h>
#include <string.h>

#include "exporters/lib/roundtrip_check.h"
#include "io/json.h"

#define EXTENSION "KHR_gaussian_splatting"

struct glb {
    spin_json *json;
    const unsigned char *bytes; /* of the binary chunk */
    uint64_t n_bytes;
    const spin_json *attributes; /* of the frame's mesh; NULL: no splats */
    size_t n;                    /* splats */
};

static uint32_t u32_at(const unsigned char *at)
{
    return at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static spin_status open_glb(const struct spin_map *map, struct glb *g)
{
    const unsigned char *d = map->data;
    uint64_t n_json, at;

    if (map->size < 20 || memcmp(d, "glTF", 4) != 0 || u32_at(d + 4) != 2 ||
        u32_at(d + 8) != map->size || memcmp(d + 16, "JSON", 4) != 0)
        return spin_fail(SPIN_E_MALFORMED, "not a GLB of its length");
    n_json = u32_at(d + 12);
    at = 20 + n_json;
    if (at > map->size)
        return spin_fail(SPIN_E_MALFORMED, "the JSON ends behind the file");
    SPIN_TRY(spin_json_parse("JSON", (const char *)d + 20, (size_t)n_json, &g->json));
    if (at == map->size)
        return SPIN_OK;
    if (at + 8 > map->size || memcmp(d + at + 4, "BIN", 4) != 0 ||
        at + 8 + u32_at(d + at) != map->size)
        return spin_fail(SPIN_E_MALFORMED, "no binary chunk to the end of the file");
    g->bytes = d + at + 8;
    g->n_bytes = u32_at(d + at);
    return SPIN_OK;
}

static const spin_json *item(const struct glb *g, const char *list, const spin_json *index)
{
    int64_t i = -1;

    if (!spin_json_integer(index, &i) || i < 0)
        return NULL;
    return spin_json_at(spin_json_get(g->json, list), (size_t)i);
}

static int64_t integer_of(const spin_json *object, const char *key, int64_t fallback)
{
    int64_t value = fallback;

    spin_json_integer(spin_json_get(object, key), &value);
    return value;
}

static spin_status find_frame(struct glb *g, int frame)
{
    const spin_json *node = spin_json_at(spin_json_get(g->json, "nodes"), (size_t)frame);
    const spin_json *mesh = item(g, "meshes", spin_json_get(node, "mesh"));
    const spin_json *primitive = spin_json_at(spin_json_get(mesh, "primitives"), 0);
    const spin_json *place;

    if (!node)
        return spin_fail(SPIN_E_MALFORMED, "no node %d", frame);
    if (!spin_json_get(node, "mesh"))
        return SPIN_OK;
    g->attributes = spin_json_get(primitive, "attributes");
    place = item(g, "accessors", spin_json_get(g->attributes, "POSITION"));
    if (!place || integer_of(primitive, "mode", 4) != 0 ||
        !spin_json_get(spin_json_get(primitive, "extensions"), EXTENSION))
        return spin_fail(SPIN_E_MALFORMED, "node %d shows no points with " EXTENSION, frame);
    g->n = (size_t)integer_of(place, "count", 0);
    return SPIN_OK;
}

/* An attribute of the frame: g->n times `width` floats. */
static spin_status find_floats(const struct glb *g, const char *name, size_t width,
                               const unsigned char **out)
{
    static const char *const types[] = {"", "SCALAR", "", "VEC3", "VEC4"};
    const spin_json *a = item(g, "accessors", spin_json_get(g->attributes, name));
    const spin_json *view = item(g, "bufferViews", spin_json_get(a, "bufferView"));
    const char *type = spin_json_string(spin_json_get(a, "type"));
    int64_t at = integer_of(view, "byteOffset", 0), length = integer_of(view, "byteLength", -1);

    if (!view || !type || strcmp(type, types[width]) != 0 ||
        integer_of(a, "componentType", 0) != 5126 || integer_of(a, "count", -1) != (int64_t)g->n)
        return spin_fail(SPIN_E_MALFORMED, "attribute '%s' is missing or of another kind", name);
    if (at < 0 || length < 0 || (uint64_t)length / (4 * width) < g->n ||
        (uint64_t)at > g->n_bytes || (uint64_t)length > g->n_bytes - (uint64_t)at)
        return spin_fail(SPIN_E_MALFORMED, "attribute '%s' ends behind the file", name);
    *out = g->bytes + at;
    return SPIN_OK;
}

static void copy_floats(const unsigned char *from, size_t n, float *out)
{
    if (n > 0)
        memcpy(out, from, n * sizeof *out);
    spin_splat_filter_little_endian(out, n);
}

static spin_status read_sh(const struct glb *g, int degree, struct spin_splats *out)
{
    size_t n_sh = (size_t)spin_sh_count(degree), k = 0;

    for (int l = 0; l <= degree; l++) {
        for (int m = 0; m < 2 * l + 1; m++, k++) {
            const unsigned char *from;
            char name[64];

            snprintf(name, sizeof name, EXTENSION ":SH_DEGREE_%d_COEF_%d", l, m);
            SPIN_TRY(find_floats(g, name, 3, &from));
            for (size_t i = 0; i < g->n; i++)
                copy_floats(from + 12 * i, 3, out->sh + 3 * (n_sh * i + k));
        }
    }
    return SPIN_OK;
}

static spin_status read_rows(const struct glb *g, struct spin_splats *out)
{
    const unsigned char *place, *rotation, *scale, *opacity;

    SPIN_TRY(find_floats(g, "POSITION", 3, &place));
    SPIN_TRY(find_floats(g, EXTENSION ":ROTATION", 4, &rotation));
    SPIN_TRY(find_floats(g, EXTENSION ":SCALE", 3, &scale));
    SPIN_TRY(find_floats(g, EXTENSION ":OPACITY", 1, &opacity));
    copy_floats(place, 3 * g->n, out->means);
    copy_floats(scale, 3 * g->n, out->log_scales);
    copy_floats(opacity, g->n, out->logit_opacities);
    for (size_t i = 0; i < 3 * g->n; i++)
        out->log_scales[i] = logf(spin_maxf(out->log_scales[i], 1e-38f));
    for (size_t i = 0; i < g->n; i++) {
        float q[4];

        copy_floats(rotation + 16 * i, 4, q);
        for (size_t k = 0; k < 4; k++)
            out->quats[4 * i + (k + 1) % 4] = q[k];
        out->logit_opacities[i] = spin_roundtrip_check_logit(out->logit_opacities[i]);
    }
    return SPIN_OK;
}

static int degree_of(const struct glb *g)
{
    char name[64];
    int degree = 0;

    for (; degree < 3; degree++) {
        snprintf(name, sizeof name, EXTENSION ":SH_DEGREE_%d_COEF_0", degree + 1);
        if (!spin_json_get(g->attributes, name))
            break;
    }
    return degree;
}

spin_status spin_gltf_read(const struct spin_map *map, int frame, struct spin_splats *out)
{
    struct glb g = {0};
    spin_status status;

    SPIN_TRY_OUT(open_glb(map, &g));
    SPIN_TRY_OUT(find_frame(&g, frame));
    if ((uint64_t)g.n > g.n_bytes) {
        status = spin_fail(SPIN_E_MALFORMED, "%zu splats in %llu bytes", g.n,
                           (unsigned long long)g.n_bytes);
        goto out;
    }
    SPIN_TRY_OUT(
        spin_splats_reserve(out, g.n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, degree_of(&g)));
    if (g.attributes) {
        SPIN_TRY_OUT(read_rows(&g, out));
        SPIN_TRY_OUT(read_sh(&g, out->sh_degree, out));
    }
out:
    spin_json_free(g.json);
    return status;
}
