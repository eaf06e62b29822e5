#include "formats/glb.h"

#include <stdio.h>
#include <string.h>

#include "math/portable.h"

#define EXTENSION SPIN_GS_GLB_EXTENSION
enum { POSITION, ROTATION, SCALE, OPACITY, SH };
enum { HEADER = 12, CHUNK_HEADER = 8, POINTS = 0, TRIANGLES = 4 };

static const char *const names[SH] = {"POSITION", EXTENSION ":ROTATION", EXTENSION ":SCALE",
                                      EXTENSION ":OPACITY"};

const char *const spin_gs_glb_values[] = {"kernel", "ellipse", "colorSpace", "srgb_rec709_display",
                                          NULL};

static void name_sh(int degree, int order, char name[64])
{
    snprintf(name, 64, EXTENSION ":SH_DEGREE_%d_COEF_%d", degree, order);
}

/* ---- Writing --------------------------------------------------------------------------------- */

static void add_attribute(struct spin_gs_glb_layout *l, const char *name, int n_components,
                          enum spin_gltf_component component)
{
    l->width[l->n] = (size_t)n_components * (component == SPIN_GLTF_F32 ? 4 : 2);
    l->row += l->width[l->n];
    l->attribute[l->n++] =
        (struct spin_gltf_attribute){name, n_components, component, component != SPIN_GLTF_F32};
}

void spin_gs_glb_begin(struct spin_gs_glb_layout *l, int sh_degree, bool fallback)
{
    static const int n_components[SH] = {3, 4, 3, 1};
    int k = 0;

    *l = (struct spin_gs_glb_layout){.sh_degree = sh_degree, .fallback = fallback};
    for (int a = 0; a < SH; a++)
        add_attribute(l, names[a], n_components[a], SPIN_GLTF_F32);
    for (int degree = 0; degree <= sh_degree; degree++) {
        for (int m = 0; m < 2 * degree + 1; m++, k++) {
            name_sh(degree, m, l->name[k]);
            add_attribute(l, l->name[k], 3, SPIN_GLTF_F32);
        }
    }
    if (fallback)
        add_attribute(l, "COLOR_0", 4, SPIN_GLTF_U16);
}

static float clamp(float x) { return spin_minf(spin_maxf(x, 0), 1); }

static uint16_t u16_of(float x) { return (uint16_t)(clamp(x) * 65535 + 0.5f); }

/* The curve of sRGB (IEC 61966-2-1), undone. */
static float linear_of(float x)
{
    return x <= 0.04045f ? x / 12.92f : powf((x + 0.055f) / 1.055f, 2.4f);
}

void spin_gs_glb_code(const struct spin_gs_glb_layout *l, const struct spin_gaussian *row,
                      const float *sh, int n_sh, unsigned char *const column[], size_t at)
{
    float *rotation = (float *)(void *)column[ROTATION] + 4 * at;
    float *scale = (float *)(void *)column[SCALE] + 3 * at;
    uint16_t *colour = (uint16_t *)(void *)column[l->n - 1] + 4 * at;

    memcpy(column[POSITION] + 12 * at, row->place, sizeof row->place);
    for (int k = 0; k < 4; k++)
        rotation[k] = row->rotation[(k + 1) % 4];
    for (int c = 0; c < 3; c++)
        scale[c] = expf(row->log_scale[c]);
    memcpy(column[OPACITY] + 4 * at, &row->opacity, sizeof row->opacity);
    for (int k = 0; k < spin_sh_count(l->sh_degree); k++) {
        float *out = (float *)(void *)column[SH + k] + 3 * at;

        for (int c = 0; c < 3; c++)
            out[c] = k < n_sh ? sh[3 * k + c] : 0;
    }
    if (!l->fallback)
        return;
    for (int c = 0; c < 3; c++)
        colour[c] = u16_of(linear_of(clamp(row->colour[c])));
    colour[3] = u16_of(row->opacity);
}

void spin_gs_glb_order(const struct spin_gs_glb_layout *l, unsigned char *const column[], size_t n)
{
#if __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    for (int a = 0; a < l->n; a++) {
        uint16_t *half = (uint16_t *)(void *)column[a];

        if (l->attribute[a].component == SPIN_GLTF_F32)
            spin_little_endian(column[a], n * l->width[a] / 4);
        for (size_t i = 0; l->attribute[a].component == SPIN_GLTF_U16 && i < n * l->width[a] / 2;
             i++)
            half[i] = __builtin_bswap16(half[i]);
    }
#else
    (void)l;
    (void)column;
    (void)n;
#endif
}

/* ---- The container --------------------------------------------------------------------------- */

spin_status spin_glb_chunks(const unsigned char *file, size_t size, uint64_t *n_json,
                            uint64_t *n_chunk)
{
    const size_t json_at = HEADER + CHUNK_HEADER;
    uint64_t at;

    *n_chunk = 0;
    if (size < json_at || memcmp(file, "glTF", 4) != 0 || spin_u32_at(file + 4) != 2 ||
        spin_u32_at(file + 8) != size || memcmp(file + 16, "JSON", 4) != 0)
        return spin_fail(SPIN_E_MALFORMED, "not a GLB of its length");
    *n_json = spin_u32_at(file + 12);
    at = json_at + *n_json;
    if (at > size)
        return spin_fail(SPIN_E_MALFORMED, "the JSON ends behind the file");
    if (at == size)
        return SPIN_OK;
    if (at + CHUNK_HEADER > size || memcmp(file + at + 4, "BIN", 4) != 0 ||
        at + CHUNK_HEADER + spin_u32_at(file + at) != size)
        return spin_fail(SPIN_E_MALFORMED, "no binary chunk to the end of the file");
    *n_chunk = spin_u32_at(file + at);
    return SPIN_OK;
}

spin_status spin_gs_glb_open(const unsigned char *file, size_t size, struct spin_gs_glb *out)
{
    uint64_t n_json;

    SPIN_TRY(spin_glb_chunks(file, size, &n_json, &out->n_bytes));
    out->bytes = file + size - out->n_bytes;
    return spin_json_parse("JSON", (const char *)file + HEADER + CHUNK_HEADER, (size_t)n_json,
                           &out->json);
}

void spin_gs_glb_close(struct spin_gs_glb *glb)
{
    spin_json_free(glb->json);
    *glb = (struct spin_gs_glb){0};
}

size_t spin_gs_glb_n_nodes(const struct spin_gs_glb *glb)
{
    return spin_json_length(spin_json_get(glb->json, "nodes"));
}

/* ---- Reading --------------------------------------------------------------------------------- */

/* A node's mesh. */
struct points {
    const struct spin_gs_glb *glb;
    const spin_json *attributes; /* NULL: no splats */
    size_t n;                    /* splats */
    int sh_degree;
};

/* An attribute: n times `width` floats, `stride` bytes apart. */
struct floats {
    const unsigned char *at;
    size_t width, stride;
};

static const spin_json *item(const struct spin_gs_glb *glb, const char *list,
                             const spin_json *index)
{
    int64_t i = -1;

    if (!spin_json_integer(index, &i) || i < 0)
        return NULL;
    return spin_json_at(spin_json_get(glb->json, list), (size_t)i);
}

static int64_t integer_of(const spin_json *object, const char *key, int64_t fallback)
{
    int64_t value = fallback;

    spin_json_integer(spin_json_get(object, key), &value);
    return value;
}

static spin_status find_points(const struct spin_gs_glb *glb, size_t node, struct points *out)
{
    const spin_json *object = spin_json_at(spin_json_get(glb->json, "nodes"), node);
    const spin_json *mesh = item(glb, "meshes", spin_json_get(object, "mesh"));
    const spin_json *primitive = spin_json_at(spin_json_get(mesh, "primitives"), 0), *place;
    int64_t n;
    char name[64];

    *out = (struct points){.glb = glb};
    if (!object)
        return spin_fail(SPIN_E_MALFORMED, "no node %zu", node);
    if (!spin_json_get(object, "mesh"))
        return SPIN_OK;
    out->attributes = spin_json_get(primitive, "attributes");
    place = item(glb, "accessors", spin_json_get(out->attributes, names[POSITION]));
    if (!place || integer_of(primitive, "mode", TRIANGLES) != POINTS ||
        !spin_json_get(spin_json_get(primitive, "extensions"), EXTENSION))
        return spin_fail(SPIN_E_MALFORMED, "node %zu shows no points with " EXTENSION, node);
    n = integer_of(place, "count", 0);
    if (n < 0 || (uint64_t)n > glb->n_bytes / 12) /* of POSITION alone */
        return spin_fail(SPIN_E_MALFORMED, "node %zu: %lld splats in %llu bytes", node,
                         (long long)n, (unsigned long long)glb->n_bytes);
    out->n = (size_t)n;
    for (; out->sh_degree < 3; out->sh_degree++) {
        name_sh(out->sh_degree + 1, 0, name);
        if (!spin_json_get(out->attributes, name))
            break;
    }
    return SPIN_OK;
}

/* Accessor, view and bytes of an attribute of `width` floats; all of it lies in the binary chunk. */
static spin_status find_floats(const struct points *p, const char *name, size_t width,
                               struct floats *out)
{
    static const char *const types[] = {"", "SCALAR", "", "VEC3", "VEC4"};
    const spin_json *a = item(p->glb, "accessors", spin_json_get(p->attributes, name));
    const spin_json *view = item(p->glb, "bufferViews", spin_json_get(a, "bufferView"));
    const char *type = spin_json_string(spin_json_get(a, "type"));
    int64_t at = integer_of(view, "byteOffset", 0), length = integer_of(view, "byteLength", -1);
    int64_t offset = integer_of(a, "byteOffset", 0), bytes = (int64_t)width * 4;
    int64_t stride = integer_of(view, "byteStride", bytes), n = (int64_t)p->n;

    if (!view || !type || strcmp(type, types[width]) != 0 ||
        integer_of(a, "componentType", 0) != SPIN_GLTF_F32 || integer_of(a, "count", -1) != n ||
        integer_of(view, "buffer", 0) != 0 || spin_json_get(a, "sparse"))
        return spin_fail(SPIN_E_MALFORMED, "attribute '%s' is missing or of another kind", name);
    if (at < 0 || length < 0 || offset < 0 || stride < bytes || stride > 252 ||
        (uint64_t)at > p->glb->n_bytes || (uint64_t)length > p->glb->n_bytes - (uint64_t)at ||
        offset > length ||
        (n > 0 && (length - offset < bytes || (length - offset - bytes) / stride < n - 1)))
        return spin_fail(SPIN_E_MALFORMED, "attribute '%s' ends behind the file", name);
    *out = (struct floats){p->glb->bytes + at + offset, width, (size_t)stride};
    return SPIN_OK;
}

static void copy_row(const struct floats *f, size_t i, float *out)
{
    memcpy(out, f->at + i * f->stride, f->width * sizeof *out);
    spin_little_endian(out, f->width);
}

static spin_status read_sh(const struct points *p, struct spin_splats *out)
{
    size_t n_sh = (size_t)spin_sh_count(p->sh_degree), k = 0;

    for (int degree = 0; degree <= p->sh_degree; degree++) {
        for (int m = 0; m < 2 * degree + 1; m++, k++) {
            struct floats from;
            char name[64];

            name_sh(degree, m, name);
            SPIN_TRY(find_floats(p, name, 3, &from));
            for (size_t i = 0; i < p->n; i++)
                copy_row(&from, i, out->sh + 3 * (n_sh * i + k));
        }
    }
    return SPIN_OK;
}

static spin_status read_rows(const struct points *p, unsigned columns, struct spin_splats *out)
{
    struct floats place, rotation, scale, opacity;

    SPIN_TRY(find_floats(p, names[POSITION], 3, &place));
    SPIN_TRY(find_floats(p, names[ROTATION], 4, &rotation));
    SPIN_TRY(find_floats(p, names[SCALE], 3, &scale));
    SPIN_TRY(find_floats(p, names[OPACITY], 1, &opacity));
    for (size_t i = 0; i < p->n && (columns & SPIN_COL_MEANS); i++)
        copy_row(&place, i, out->means + 3 * i);
    for (size_t i = 0; i < p->n && (columns & SPIN_COL_QUATS); i++) {
        float q[4];

        copy_row(&rotation, i, q);
        for (size_t k = 0; k < 4; k++)
            out->quats[4 * i + (k + 1) % 4] = q[k];
    }
    for (size_t i = 0; i < p->n && (columns & SPIN_COL_LOG_SCALES); i++) {
        float *to = out->log_scales + 3 * i;

        copy_row(&scale, i, to);
        for (int c = 0; c < 3; c++) /* NaN stays, to be found */
            to[c] = logf(to[c] < 1e-38f ? 1e-38f : to[c]);
    }
    for (size_t i = 0; i < p->n && (columns & SPIN_COL_LOGIT_OPACITIES); i++) {
        copy_row(&opacity, i, out->logit_opacities + i);
        out->logit_opacities[i] = spin_opacity_logit(out->logit_opacities[i]);
    }
    return columns & SPIN_COL_SH ? read_sh(p, out) : SPIN_OK;
}

spin_status spin_gs_glb_read(const struct spin_gs_glb *glb, size_t node, unsigned columns,
                             struct spin_splats *out)
{
    static const char *const what[5] = {"POSITION", "ROTATION", "SCALE", "OPACITY", "SH_DEGREE_*"};
    struct points p;

    SPIN_TRY(find_points(glb, node, &p));
    SPIN_TRY(spin_splats_reserve(out, p.n, columns, p.sh_degree));
    if (!p.attributes)
        return SPIN_OK;
    SPIN_TRY(read_rows(&p, columns, out));
    return spin_check_columns(what, columns, 0, p.n, out);
}
