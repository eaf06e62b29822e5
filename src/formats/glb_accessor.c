#include "formats/glb_accessor.h"

#include <string.h>

#include "formats/gaussian.h"

enum { HEADER = 12, CHUNK_HEADER = 8, MAX_STRIDE = 252 };

/* ---- The container --------------------------------------------------------------------------- */

/* The lengths of a GLB and of its chunks; nothing is parsed. chunk: the binary chunk. */
static spin_status find_chunks(const unsigned char *file, size_t size, uint64_t *n_json,
                               const unsigned char **chunk, uint64_t *n_chunk)
{
    const size_t json_at = HEADER + CHUNK_HEADER;
    uint64_t at;

    *chunk = file;
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
        at + CHUNK_HEADER + spin_u32_at(file + at) > size)
        return spin_fail(SPIN_E_MALFORMED, "no binary chunk in the file");
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

spin_status spin_glb_view(const struct spin_glb_file *glb, const spin_json *view,
                          const unsigned char **bytes, uint64_t *n_bytes)
{
    int64_t at = spin_glb_integer(view, "byteOffset", 0);
    int64_t length = spin_glb_integer(view, "byteLength", -1);
    const spin_json *buffer = spin_glb_item(glb, "buffers", spin_json_get(view, "buffer"));

    if (!view || spin_glb_integer(view, "buffer", 0) != 0 || spin_json_get(buffer, "uri"))
        return spin_fail(SPIN_E_MALFORMED, "it does not lie in the file");
    if (at < 0 || length < 0 || (uint64_t)at > glb->n_bytes ||
        (uint64_t)length > glb->n_bytes - (uint64_t)at)
        return spin_fail(SPIN_E_MALFORMED, "it ends behind the file");
    *bytes = glb->bytes + at;
    *n_bytes = (uint64_t)length;
    return SPIN_OK;
}

/* ---- Numbers --------------------------------------------------------------------------------- */

static size_t component_bytes(int component)
{
    return component == SPIN_GLB_F32 ? 4 : component & (SPIN_GLB_I16 | SPIN_GLB_U16) ? 2 : 1;
}

static spin_status find_kind(const spin_json *accessor, size_t width, unsigned allowed,
                             struct spin_glb_numbers *out)
{
    static const char *const types[] = {"", "SCALAR", "", "VEC3", "VEC4"};
    static const int kinds[] = {SPIN_GLB_I8, SPIN_GLB_U8, SPIN_GLB_I16, SPIN_GLB_U16,
                                0,           0,           SPIN_GLB_F32};
    const char *type = spin_json_string(spin_json_get(accessor, "type"));
    int64_t component = spin_glb_integer(accessor, "componentType", 0) - 5120;

    spin_json_bool(spin_json_get(accessor, "normalized"), &out->normalised);
    out->component = component >= 0 && component <= 6 ? kinds[component] : 0;
    out->normalised = out->normalised && out->component != SPIN_GLB_F32;
    if (!accessor || !type || strcmp(type, types[width]) != 0 ||
        spin_json_get(accessor, "sparse") ||
        !((unsigned)out->component << (out->normalised ? SPIN_GLB_NORMALISED : 0) & allowed))
        return spin_fail(SPIN_E_MALFORMED, "it is missing or of another kind");
    return SPIN_OK;
}

spin_status spin_glb_find(const struct spin_glb_file *glb, const spin_json *accessor, size_t width,
                          unsigned allowed, struct spin_glb_numbers *out)
{
    const spin_json *view =
        spin_glb_item(glb, "bufferViews", spin_json_get(accessor, "bufferView"));
    int64_t n = spin_glb_integer(accessor, "count", -1), row, stride;
    int64_t offset = spin_glb_integer(accessor, "byteOffset", 0);
    uint64_t length;

    *out = (struct spin_glb_numbers){.width = width};
    SPIN_TRY(find_kind(accessor, width, allowed, out));
    SPIN_TRY(spin_glb_view(glb, view, &out->at, &length));
    row = (int64_t)(width * component_bytes(out->component));
    stride = spin_glb_integer(view, "byteStride", row);
    if (n < 0 || offset < 0 || stride < row || stride > MAX_STRIDE || offset > (int64_t)length ||
        (n > 0 &&
         ((int64_t)length - offset < row || ((int64_t)length - offset - row) / stride < n - 1)))
        return spin_fail(SPIN_E_MALFORMED, "it ends behind the file");
    out->at += offset;
    out->n = (size_t)n;
    out->stride = (size_t)stride;
    return SPIN_OK;
}

static float integer_at(const struct spin_glb_numbers *f, const unsigned char *at)
{
    switch (f->component) {
    case SPIN_GLB_I8:
        return (float)(int8_t)at[0];
    case SPIN_GLB_U8:
        return (float)at[0];
    case SPIN_GLB_I16:
        return (float)(int16_t)(at[0] | at[1] << 8);
    default:
        return (float)(at[0] | at[1] << 8);
    }
}

void spin_glb_row(const struct spin_glb_numbers *f, size_t i, float *out)
{
    const unsigned char *at = f->at + i * f->stride;
    size_t bytes = component_bytes(f->component);
    float largest = f->component == SPIN_GLB_I8    ? 127
                    : f->component == SPIN_GLB_U8  ? 255
                    : f->component == SPIN_GLB_I16 ? 32767
                                                   : 65535;

    if (f->component == SPIN_GLB_F32) {
        memcpy(out, at, f->width * sizeof *out);
        spin_little_endian(out, f->width);
        return;
    }
    for (size_t k = 0; k < f->width; k++) {
        out[k] = integer_at(f, at + k * bytes);
        if (f->normalised) /* the least signed number stands for -1 too */
            out[k] = out[k] < -largest ? -1 : out[k] / largest;
    }
}
