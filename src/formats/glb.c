#include "formats/glb.h"

#include <string.h>

enum { HEADER = 12, CHUNK_HEADER = 8, MAX_STRIDE = 252 };
#define LINEAR "lin_rec709_display"
#define OPACITY_SLACK 1e-3f /* tolerance for opacities below 0 or above 1, from rounding */

void spin_glb_attribute_name(int attribute, char name[SPIN_GLB_NAME])
{
    static const char *const names[] = {"POSITION", SPIN_GLB_SPLATS ":ROTATION",
                                        SPIN_GLB_SPLATS ":SCALE", SPIN_GLB_SPLATS ":OPACITY"};
    int k = attribute - SPIN_GLB_SH, degree = 0;

    while ((degree + 1) * (degree + 1) <= k)
        degree++;
    if (k < 0)
        snprintf(name, SPIN_GLB_NAME, "%s", names[attribute]);
    else
        snprintf(name, SPIN_GLB_NAME, SPIN_GLB_SPLATS ":SH_DEGREE_%d_COEF_%d", degree,
                 k - degree * degree);
}

/* ---- The container --------------------------------------------------------------------------- */

/* Finds the JSON chunk and the binary chunk of a GLB, and checks their lengths. *chunk and *n_chunk
 * receive the content of the binary chunk and its length; without a binary chunk, the length is 0.
 */
static spin_status find_chunks(const unsigned char *file, size_t size, uint64_t *n_json,
                               const unsigned char **chunk, uint64_t *n_chunk)
{
    const size_t json_at = HEADER + CHUNK_HEADER;
    uint64_t at;

    *chunk = file;
    *n_chunk = 0;
    if (size < json_at || memcmp(file, "glTF", 4) != 0 || spin_u32_at(file + 4) != 2 ||
        spin_u32_at(file + 8) != size || memcmp(file + 16, "JSON", 4) != 0)
        return spin_malformed("the GLB header is missing, or its length differs from the file");
    *n_json = spin_u32_at(file + 12);
    at = json_at + *n_json;
    if (at > size)
        return spin_malformed("the JSON chunk extends beyond the file");
    if (at == size)
        return SPIN_OK;
    if (at + CHUNK_HEADER > size || memcmp(file + at + 4, "BIN", 4) != 0 ||
        at + CHUNK_HEADER + spin_u32_at(file + at) > size)
        return spin_malformed("the second chunk is not binary or extends beyond the file");
    *chunk = file + at + CHUNK_HEADER;
    *n_chunk = spin_u32_at(file + at);
    return SPIN_OK;
}

spin_status spin_glb_open(const unsigned char *file, size_t size, struct spin_glb_file *out)
{
    uint64_t n_json = 0;

    SPIN_TRY(find_chunks(file, size, &n_json, &out->bytes, &out->n_bytes));
    return spin_json_parse("JSON", (const char *)file + HEADER + CHUNK_HEADER, (size_t)n_json,
                           &out->json);
}

void spin_glb_close(struct spin_glb_file *glb)
{
    spin_json_free(glb->json);
    *glb = (struct spin_glb_file){0};
}

/* ---- The document ---------------------------------------------------------------------------- */

const spin_json *spin_glb_item(const struct spin_glb_file *glb, const char *list,
                               const spin_json *index)
{
    int64_t i = -1;

    if (!spin_json_integer(index, &i) || i < 0)
        return NULL;
    return spin_json_at(spin_json_get(glb->json, list), (size_t)i);
}

int64_t spin_glb_integer(const spin_json *object, const char *key, int64_t fallback)
{
    int64_t value = fallback;

    spin_json_integer(spin_json_get(object, key), &value);
    return value;
}

/* Finds the bytes of a buffer view. */
static spin_status find_view(const struct spin_glb_file *glb, const spin_json *view,
                             const unsigned char **bytes, uint64_t *n_bytes)
{
    int64_t at = spin_glb_integer(view, "byteOffset", 0);
    int64_t length = spin_glb_integer(view, "byteLength", -1);
    const spin_json *buffer = spin_glb_item(glb, "buffers", spin_json_get(view, "buffer"));

    if (!view || spin_glb_integer(view, "buffer", 0) != 0 || spin_json_get(buffer, "uri"))
        return spin_malformed("the buffer view is missing, or its data are in another file");
    if (at < 0 || length < 0 || (uint64_t)at > glb->n_bytes ||
        (uint64_t)length > glb->n_bytes - (uint64_t)at)
        return spin_malformed("the buffer view extends beyond the binary chunk");
    *bytes = glb->bytes + at;
    *n_bytes = (uint64_t)length;
    return SPIN_OK;
}

/* ---- Numbers --------------------------------------------------------------------------------- */

static size_t component_bytes(int component)
{
    return component == SPIN_GLB_F32 ? 4 : component >= SPIN_GLB_I16 ? 2 : 1;
}

spin_status spin_glb_find(const struct spin_glb_file *glb, const spin_json *accessor, size_t width,
                          unsigned allowed, struct spin_glb_numbers *out)
{
    static const char *const types[] = {"", "SCALAR", "", "VEC3", "VEC4"};
    const spin_json *view =
        spin_glb_item(glb, "bufferViews", spin_json_get(accessor, "bufferView"));
    const char *type = spin_json_string(spin_json_get(accessor, "type"));
    int64_t component = spin_glb_integer(accessor, "componentType", 0);
    int64_t n = spin_glb_integer(accessor, "count", -1), row, stride;
    int64_t offset = spin_glb_integer(accessor, "byteOffset", 0);
    unsigned kind =
        component >= SPIN_GLB_I8 && component <= SPIN_GLB_F32 ? SPIN_GLB_IS(component) : 0;
    uint64_t length;

    *out = (struct spin_glb_numbers){.width = width, .component = (int)component};
    spin_json_bool(spin_json_get(accessor, "normalized"), &out->normalised);
    out->normalised = out->normalised && component != SPIN_GLB_F32;
    if (!type || strcmp(type, types[width]) != 0 || spin_json_get(accessor, "sparse") ||
        !((out->normalised ? SPIN_GLB_NORMALISED(kind) : kind) & allowed))
        return spin_malformed("the accessor is missing or has an unsupported type");
    SPIN_TRY(find_view(glb, view, &out->at, &length));
    row = (int64_t)(width * component_bytes(out->component));
    stride = spin_glb_integer(view, "byteStride", row);
    if (n < 0 || offset < 0 || stride < row || stride > MAX_STRIDE || offset > (int64_t)length ||
        (n > 0 &&
         ((int64_t)length - offset < row || ((int64_t)length - offset - row) / stride < n - 1)))
        return spin_malformed("the accessor extends beyond its buffer view");
    out->at += offset;
    out->n = (size_t)n;
    out->stride = (size_t)stride;
    return SPIN_OK;
}

void spin_glb_row(const struct spin_glb_numbers *f, size_t i, float *out)
{
    static const float most[] = {127, 255, 32767, 65535};
    const unsigned char *at = f->at + i * f->stride;

    if (f->component == SPIN_GLB_F32) {
        memcpy(out, at, f->width * sizeof *out);
        spin_little_endian(out, f->width);
        return;
    }
    for (size_t k = 0; k < f->width; k++, at += component_bytes(f->component)) {
        float largest = most[f->component - SPIN_GLB_I8];

        out[k] = f->component == SPIN_GLB_I8    ? (float)(int8_t)at[0]
                 : f->component == SPIN_GLB_U8  ? (float)at[0]
                 : f->component == SPIN_GLB_I16 ? (float)(int16_t)(at[0] | at[1] << 8)
                                                : (float)(at[0] | at[1] << 8);
        if (f->normalised) /* -128 and -32768 decode to -1, like -127 and -32767 */
            out[k] = out[k] < -largest ? -1 : out[k] / largest;
    }
}

/* ---- Splats ---------------------------------------------------------------------------------- */

#define FLOATS SPIN_GLB_IS(SPIN_GLB_F32)
#define SIGNED (SPIN_GLB_IS(SPIN_GLB_I8) | SPIN_GLB_IS(SPIN_GLB_I16))
#define UNSIGNED (SPIN_GLB_IS(SPIN_GLB_U8) | SPIN_GLB_IS(SPIN_GLB_U16))

/* The component types that each attribute may have, as specified by KHR_mesh_quantization for
 * POSITION and by KHR_gaussian_splatting for the other attributes. */
static const unsigned allowed[SPIN_GLB_SH + 1] = {
    FLOATS | SIGNED | UNSIGNED | SPIN_GLB_NORMALISED(SIGNED | UNSIGNED),
    FLOATS | SPIN_GLB_NORMALISED(SIGNED),
    FLOATS | UNSIGNED | SPIN_GLB_NORMALISED(UNSIGNED),
    FLOATS | SPIN_GLB_NORMALISED(UNSIGNED),
    FLOATS,
};

bool spin_gs_glb_is_splats(const spin_json *primitive)
{
    return spin_json_get(spin_json_get(primitive, "extensions"), SPIN_GLB_SPLATS) != NULL;
}

/* Checks the value of `key` in an extension: it must be missing, or equal to `known` or `also`.
 * `also` may be NULL. */
static spin_status check_value(const spin_json *extension, const char *key, const char *known,
                               const char *also)
{
    const char *value = spin_json_string(spin_json_get(extension, key));

    if (value && strcmp(value, known) != 0 && (!also || strcmp(value, also) != 0))
        return spin_unsupported(SPIN_GLB_SPLATS ": '%s' is '%.40s', expected '%s'", key, value,
                                known);
    return SPIN_OK;
}

/* Finds the SPZ data that replace the attributes of the primitive. If there are none, *out stays
 * unchanged. */
static spin_status find_packed(const struct spin_glb_file *glb, const spin_json *extension,
                               struct spin_gs_glb_points *out)
{
    const spin_json *packed =
        spin_json_get(spin_json_get(extension, "extensions"), SPIN_GLB_SPLATS "_compression_spz_2");
    uint64_t n_bytes;

    if (!packed)
        return SPIN_OK;
    SPIN_TRY(find_view(glb, spin_glb_item(glb, "bufferViews", spin_json_get(packed, "bufferView")),
                       &out->packed, &n_bytes));
    out->n_packed = (size_t)n_bytes;
    SPIN_TRY(spin_spz_peek(out->packed, out->n_packed, &out->spz));
    if (out->spz.n != out->n)
        return spin_malformed("'POSITION' has %zu splats, the SPZ has %zu", out->n, out->spz.n);
    out->sh_degree = out->spz.sh_degree < 3 ? out->spz.sh_degree : 3;
    return SPIN_OK;
}

spin_status spin_gs_glb_find(const struct spin_glb_file *glb, const spin_json *primitive,
                             struct spin_gs_glb_points *out)
{
    const spin_json *extension =
        spin_json_get(spin_json_get(primitive, "extensions"), SPIN_GLB_SPLATS);
    const spin_json *attributes = spin_json_get(primitive, "attributes");
    const spin_json *place = spin_glb_item(glb, "accessors", spin_json_get(attributes, "POSITION"));
    const char *colours = spin_json_string(spin_json_get(extension, "colorSpace"));
    int64_t n = spin_glb_integer(place, "count", -1);
    char name[SPIN_GLB_NAME];

    *out = (struct spin_gs_glb_points){.glb = glb, .attributes = attributes};
    if (!extension || spin_glb_integer(primitive, "mode", SPIN_GLB_TRIANGLES) != SPIN_GLB_POINTS)
        return spin_malformed("the mesh primitive is not points with " SPIN_GLB_SPLATS);
    SPIN_TRY(check_value(extension, "kernel", "ellipse", NULL));
    SPIN_TRY(check_value(extension, "projection", "perspective", NULL));
    SPIN_TRY(check_value(extension, "colorSpace", "srgb_rec709_display", LINEAR));
    out->linear = colours && strcmp(colours, LINEAR) == 0;
    if (n < 0 || n > UINT32_MAX)
        return spin_malformed("attribute 'POSITION' is missing or has no valid 'count'");
    out->n = (size_t)n;
    SPIN_TRY(find_packed(glb, extension, out));
    if (out->packed)
        return SPIN_OK;
    if (out->n > glb->n_bytes / 3) /* a POSITION has at least 3 bytes */
        return spin_malformed("a file of %llu bytes cannot contain %zu splats",
                              (unsigned long long)glb->n_bytes, out->n);
    for (; out->sh_degree < 3; out->sh_degree++) {
        spin_glb_attribute_name(SPIN_GLB_SH + spin_sh_count(out->sh_degree), name);
        if (!spin_json_get(attributes, name))
            break;
    }
    return SPIN_OK;
}

static spin_status find_attribute(const struct spin_gs_glb_points *p, int attribute, size_t width,
                                  struct spin_glb_numbers *out)
{
    int kind = attribute < SPIN_GLB_SH ? attribute : SPIN_GLB_SH;
    char name[SPIN_GLB_NAME];
    spin_status status;

    spin_glb_attribute_name(attribute, name);
    status = spin_glb_find(p->glb,
                           spin_glb_item(p->glb, "accessors", spin_json_get(p->attributes, name)),
                           width, allowed[kind], out);
    if (status == SPIN_OK && out->n != p->n)
        status = spin_malformed("%zu rows, but 'POSITION' has %zu", out->n, p->n);
    return spin_fail_context(status, "attribute '%s'", name);
}

static spin_status read_rows(const struct spin_gs_glb_points *p, unsigned columns,
                             struct spin_splats *out)
{
    struct spin_glb_numbers place, rotation, scale, opacity, sh;
    size_t n_sh = (size_t)spin_sh_count(p->sh_degree);

    SPIN_TRY(find_attribute(p, SPIN_GLB_POSITION, 3, &place));
    SPIN_TRY(find_attribute(p, SPIN_GLB_ROTATION, 4, &rotation));
    SPIN_TRY(find_attribute(p, SPIN_GLB_SCALE, 3, &scale));
    SPIN_TRY(find_attribute(p, SPIN_GLB_OPACITY, 1, &opacity));
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
        for (int c = 0; c < 3; c++) { /* NaN stays NaN; the caller reports it */
            if (to[c] < 0)
                return spin_malformed("'SCALE' is %g in row %zu, expected 0 or more", (double)to[c],
                                      i);
            to[c] = logf(to[c] < 1e-38f ? 1e-38f : to[c]);
        }
    }
    for (size_t i = 0; i < p->n && (columns & SPIN_COL_LOGIT_OPACITIES); i++) {
        float value;

        spin_glb_row(&opacity, i, &value);
        if (value < -OPACITY_SLACK || value > 1 + OPACITY_SLACK)
            return spin_malformed("'OPACITY' is %g in row %zu, expected 0 to 1", (double)value, i);
        out->logit_opacities[i] = spin_opacity_logit(value);
    }
    for (size_t k = 0; k < n_sh && (columns & SPIN_COL_SH); k++) {
        SPIN_TRY(find_attribute(p, SPIN_GLB_SH + (int)k, 3, &sh));
        for (size_t i = 0; i < p->n; i++)
            spin_glb_row(&sh, i, out->sh + 3 * (n_sh * i + k));
    }
    return SPIN_OK;
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
