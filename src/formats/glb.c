#include "formats/glb.h"

#include <stdio.h>
#include <string.h>

#include "math/portable.h"

#define EXTENSION SPIN_GS_GLB_EXTENSION
enum { POSITION, ROTATION, SCALE, OPACITY, SH };
enum { POINTS = 0, TRIANGLES = 4 };
#define LINEAR "lin_rec709_display"
#define OPACITY_SLACK 1e-3f /* of opacities that were rounded */

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

/* ---- Reading --------------------------------------------------------------------------------- */

#define INTEGERS (SPIN_GLB_I8 | SPIN_GLB_U8 | SPIN_GLB_I16 | SPIN_GLB_U16)
#define NORMALISED(types) ((types) << SPIN_GLB_NORMALISED)

/* What each attribute may be made of: POSITION by KHR_mesh_quantization, the others by the extension. */
static const unsigned allowed[SH + 1] = {
    SPIN_GLB_F32 | INTEGERS | NORMALISED(INTEGERS),
    SPIN_GLB_F32 | NORMALISED(SPIN_GLB_I8 | SPIN_GLB_I16),
    SPIN_GLB_F32 | SPIN_GLB_U8 | SPIN_GLB_U16 | NORMALISED(SPIN_GLB_U8 | SPIN_GLB_U16),
    SPIN_GLB_F32 | NORMALISED(SPIN_GLB_U8 | SPIN_GLB_U16),
    SPIN_GLB_F32,
};

bool spin_gs_glb_is_splats(const spin_json *primitive)
{
    return spin_json_get(spin_json_get(primitive, "extensions"), EXTENSION) != NULL;
}

/* A value that the extension may give: `known`, which is also what its absence means. */
static spin_status check_value(const spin_json *extension, const char *key, const char *known,
                               const char *also)
{
    const char *value = spin_json_string(spin_json_get(extension, key));

    if (value && strcmp(value, known) != 0 && (!also || strcmp(value, also) != 0))
        return spin_fail(SPIN_E_UNSUPPORTED, EXTENSION " with the %s '%.40s', expected '%s'", key,
                         value, known);
    return SPIN_OK;
}

/* The SPZ that stands for all attributes of the primitive. */
static spin_status find_packed(const struct spin_glb_file *glb, const spin_json *extension,
                               struct spin_gs_glb_points *out)
{
    const spin_json *packed =
        spin_json_get(spin_json_get(extension, "extensions"), EXTENSION "_compression_spz_2");
    uint64_t n_bytes;

    if (!packed)
        return SPIN_OK;
    SPIN_TRY(spin_glb_view(glb,
                           spin_glb_item(glb, "bufferViews", spin_json_get(packed, "bufferView")),
                           &out->packed, &n_bytes));
    out->n_packed = (size_t)n_bytes;
    SPIN_TRY(spin_spz_peek(out->packed, out->n_packed, &out->spz));
    if (out->spz.n != out->n)
        return spin_fail(SPIN_E_MALFORMED, "%zu splats and SPZ of %zu", out->n, out->spz.n);
    out->sh_degree = out->spz.sh_degree < 3 ? out->spz.sh_degree : 3;
    return SPIN_OK;
}

spin_status spin_gs_glb_find(const struct spin_glb_file *glb, const spin_json *primitive,
                             struct spin_gs_glb_points *out)
{
    const spin_json *extension = spin_json_get(spin_json_get(primitive, "extensions"), EXTENSION);
    const spin_json *attributes = spin_json_get(primitive, "attributes");
    const spin_json *place =
        spin_glb_item(glb, "accessors", spin_json_get(attributes, names[POSITION]));
    const char *colours = spin_json_string(spin_json_get(extension, "colorSpace"));
    int64_t n = spin_glb_integer(place, "count", -1);
    char name[64];

    *out = (struct spin_gs_glb_points){.glb = glb, .attributes = attributes};
    if (!extension || spin_glb_integer(primitive, "mode", TRIANGLES) != POINTS)
        return spin_fail(SPIN_E_MALFORMED, "it shows no points with " EXTENSION);
    SPIN_TRY(check_value(extension, "kernel", "ellipse", NULL));
    SPIN_TRY(check_value(extension, "projection", "perspective", NULL));
    SPIN_TRY(check_value(extension, "colorSpace", "srgb_rec709_display", LINEAR));
    out->linear = colours && strcmp(colours, LINEAR) == 0;
    if (n < 0 || n > UINT32_MAX)
        return spin_fail(SPIN_E_MALFORMED, "it has no attribute 'POSITION' with a count");
    out->n = (size_t)n;
    SPIN_TRY(find_packed(glb, extension, out));
    if (out->packed)
        return SPIN_OK;
    if (out->n > glb->n_bytes / 3) /* of POSITION alone */
        return spin_fail(SPIN_E_MALFORMED, "%zu splats in %llu bytes", out->n,
                         (unsigned long long)glb->n_bytes);
    for (; out->sh_degree < 3; out->sh_degree++) {
        name_sh(out->sh_degree + 1, 0, name);
        if (!spin_json_get(attributes, name))
            break;
    }
    return SPIN_OK;
}

static spin_status find_attribute(const struct spin_gs_glb_points *p, const char *name, int kind,
                                  size_t width, struct spin_glb_numbers *out)
{
    const spin_json *accessor =
        spin_glb_item(p->glb, "accessors", spin_json_get(p->attributes, name));
    spin_status status = spin_glb_find(p->glb, accessor, width, allowed[kind], out);

    if (status == SPIN_OK && out->n != p->n)
        status = spin_fail(SPIN_E_MALFORMED, "%zu rows, 'POSITION' has %zu", out->n, p->n);
    return status == SPIN_OK ? SPIN_OK : spin_fail_context(status, "attribute '%s'", name);
}

static spin_status read_sh(const struct spin_gs_glb_points *p, struct spin_splats *out)
{
    size_t n_sh = (size_t)spin_sh_count(p->sh_degree), k = 0;

    for (int degree = 0; degree <= p->sh_degree; degree++) {
        for (int m = 0; m < 2 * degree + 1; m++, k++) {
            struct spin_glb_numbers from;
            char name[64];

            name_sh(degree, m, name);
            SPIN_TRY(find_attribute(p, name, SH, 3, &from));
            for (size_t i = 0; i < p->n; i++)
                spin_glb_row(&from, i, out->sh + 3 * (n_sh * i + k));
        }
    }
    return SPIN_OK;
}

static spin_status read_rows(const struct spin_gs_glb_points *p, unsigned columns,
                             struct spin_splats *out)
{
    struct spin_glb_numbers place, rotation, scale, opacity;

    SPIN_TRY(find_attribute(p, names[POSITION], POSITION, 3, &place));
    SPIN_TRY(find_attribute(p, names[ROTATION], ROTATION, 4, &rotation));
    SPIN_TRY(find_attribute(p, names[SCALE], SCALE, 3, &scale));
    SPIN_TRY(find_attribute(p, names[OPACITY], OPACITY, 1, &opacity));
    for (size_t i = 0; i < p->n && (columns & SPIN_COL_MEANS); i++)
        spin_glb_row(&place, i, out->means + 3 * i);
    for (size_t i = 0; i < p->n && (columns & SPIN_COL_QUATS); i++) {
        float q[4];

        spin_glb_row(&rotation, i, q);
        for (size_t k = 0; k < 4; k++)
            out->quats[4 * i + (k + 1) % 4] = q[k];
    }
    for (size_t i = 0; i < p->n && (columns & SPIN_COL_LOG_SCALES); i++) {
        float *to = out->log_scales + 3 * i;

        spin_glb_row(&scale, i, to);
        for (int c = 0; c < 3; c++) { /* NaN stays, to be found */
            if (to[c] < 0)
                return spin_fail(SPIN_E_MALFORMED, "'SCALE' is %g in row %zu, expected 0 or more",
                                 (double)to[c], i);
            to[c] = logf(to[c] < 1e-38f ? 1e-38f : to[c]);
        }
    }
    for (size_t i = 0; i < p->n && (columns & SPIN_COL_LOGIT_OPACITIES); i++) {
        float value;

        spin_glb_row(&opacity, i, &value);
        if (value < -OPACITY_SLACK || value > 1 + OPACITY_SLACK)
            return spin_fail(SPIN_E_MALFORMED, "'OPACITY' is %g in row %zu, expected 0 to 1",
                             (double)value, i);
        out->logit_opacities[i] = spin_opacity_logit(value);
    }
    return columns & SPIN_COL_SH ? read_sh(p, out) : SPIN_OK;
}

spin_status spin_gs_glb_read(const struct spin_gs_glb_points *p, unsigned columns,
                             struct spin_splats *out)
{
    static const char *const what[5] = {"POSITION", "ROTATION", "SCALE", "OPACITY", "SH_DEGREE_*"};

    if (p->packed)
        return spin_spz_read(p->packed, p->n_packed, columns, out);
    SPIN_TRY(spin_splats_reserve(out, p->n, columns, p->sh_degree));
    SPIN_TRY(read_rows(p, columns, out));
    return spin_check_columns(what, columns, 0, p->n, out);
}

spin_status spin_gs_glb_read_node(const struct spin_glb_file *glb, size_t node, unsigned columns,
                                  struct spin_splats *out)
{
    const spin_json *object = spin_json_at(spin_json_get(glb->json, "nodes"), node);
    const spin_json *mesh = spin_glb_item(glb, "meshes", spin_json_get(object, "mesh"));
    struct spin_gs_glb_points points;

    if (!object)
        return spin_fail(SPIN_E_MALFORMED, "no node %zu", node);
    if (!spin_json_get(object, "mesh"))
        return spin_splats_reserve(out, 0, columns, 0);
    SPIN_TRY(spin_gs_glb_find(glb, spin_json_at(spin_json_get(mesh, "primitives"), 0), &points));
    return spin_gs_glb_read(&points, columns, out);
}
