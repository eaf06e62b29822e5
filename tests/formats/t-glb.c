/* K: gltf formats export */
#include "tests/formats/glb_files.h"

static spin_status read_glb(const unsigned char *bytes, size_t n_bytes, struct spin_splats *out)
{
    struct spin_gs_glb_scene scene = {0};
    spin_status status = spin_gs_glb_scene_open(bytes, n_bytes, &scene);

    if (status == SPIN_OK)
        status = spin_gs_glb_scene_read(&scene, 0, ALL, out);
    spin_gs_glb_scene_close(&scene);
    return status;
}

/* The document of n rows of a layout; `more` goes into the view of the places, `place` into their
 * accessor. */
static char *describe(const struct spin_glb_clip *l, size_t n, const char *more, const char *place)
{
    static const char *const types[] = {"", "SCALAR", "", "VEC3", "VEC4"};
    char *text = NULL;
    size_t length = 0, at = 0;
    FILE *f = open_memstream(&text, &length);

    fprintf(f, "{\"nodes\":[{\"mesh\":0},{}],\"meshes\":[{\"primitives\":[{\"mode\":0,"
               "\"extensions\":{\"" SPIN_GLB_SPLATS "\":{}},\"attributes\":{");
    for (int a = 0; a < l->n_attributes; a++) {
        char name[SPIN_GLB_NAME] = "COLOR_0";

        if (a + 1 < l->n_attributes)
            spin_glb_attribute_name(a, name);
        fprintf(f, "%s\"%s\":%d", a ? "," : "", name, a);
    }
    fprintf(f, "}}]}],\"accessors\":[");
    for (int a = 0; a < l->n_attributes; a++)
        fprintf(f, "%s{\"bufferView\":%d,\"componentType\":%d,\"count\":%zu,\"type\":\"%s\"%s}",
                a ? "," : "", a, a + 1 < l->n_attributes ? SPIN_GLB_F32 : SPIN_GLB_U16, n,
                types[l->width[a] / (a + 1 < l->n_attributes ? 4 : 2)], a == 0 ? place : "");
    fprintf(f, "],\"bufferViews\":[");
    for (int a = 0; a < l->n_attributes; a++, at += n * l->width[a - 1])
        fprintf(f, "%s{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu%s}", a ? "," : "", at,
                n * l->width[a], a == 0 ? more : "");
    fprintf(f, "]}");
    fclose(f);
    return text;
}

/* n rows, column after column. */
static unsigned char *make_bytes(const struct spin_glb_clip *l, size_t n, struct spin_gaussian *row)
{
    unsigned char *bytes = calloc(n, l->row), *column[SPIN_GLB_MAX_ATTRIBUTES];
    uint32_t seed = 6;
    float sh[48];

    column[0] = bytes;
    for (int a = 1; a < l->n_attributes; a++)
        column[a] = column[a - 1] + n * l->width[a - 1];
    for (size_t i = 0; i < n; i++) {
        row[i] = make_row(&seed);
        for (int k = 0; k < 48; k++)
            sh[k] = k < 3 ? (row[i].colour[k] - 0.5f) / 0.28209479f : (float)k;
        spin_glb_code(l, &row[i], sh, 9, column, i);
    }
    spin_glb_order(l, column, n);
    return bytes;
}

static void test_round_trip(int degree)
{
    struct spin_glb_clip layout = {.sh_degree = degree};
    struct spin_gaussian row[4];
    struct spin_splats s = {0};
    size_t size, n_sh = 3 + spin_n_rest(degree);
    unsigned char *bytes, *file;
    int good = 1, sh = 1;
    char *json;

    spin_glb_begin(&layout);
    bytes = make_bytes(&layout, 4, row);
    json = describe(&layout, 4, "", "");
    file = make_glb(json, bytes, 4 * layout.row, &size);
    ok(layout.row == 4 * (11 + n_sh) + 8, "bytes of a row");
    if (!ok(read_glb(file, size, &s) == SPIN_OK && s.n == 4 && s.sh_degree == degree,
            "degree %d is read back", degree))
        return;
    for (size_t i = 0; i < 4; i++) {
        good &= is_row(&s, i, &row[i], 0, 1e-6, 1e-6);
        for (size_t k = 3; k < n_sh; k++)
            sh &= s.sh[n_sh * i + k] == (k < 27 ? (float)k : 0);
    }
    ok(good, "rows are as they were");
    ok(sh, "coefficients are at their places, those that were not there are 0");
    free(file);
    free(json);
    free(bytes);
    spin_splats_free(&s);
}

/* Malformed documents. */
static void test_documents(void)
{
    static const struct {
        const char *view, *place;
        spin_status status;
        const char *what;
    } cases[] = {
        {",\"byteStride\":12", ",\"byteOffset\":0", SPIN_OK, "a stride of its width"},
        {",\"byteStride\":16", "", SPIN_E_MALFORMED, "a stride that leads behind the view"},
        {",\"byteStride\":0", "", SPIN_E_MALFORMED, "no stride"},
        {",\"byteStride\":-12", "", SPIN_E_MALFORMED, "a stride backwards"},
        {",\"byteLength\":999999", "", SPIN_E_MALFORMED, "a view behind the file"},
        {",\"byteOffset\":4294967295", "", SPIN_E_MALFORMED, "a view that begins behind it"},
        {",\"byteOffset\":-4", "", SPIN_E_MALFORMED, "or before it"},
        {",\"buffer\":1", "", SPIN_E_MALFORMED, "another buffer"},
        {"", ",\"byteOffset\":4", SPIN_E_MALFORMED, "an accessor that ends behind its view"},
        {"", ",\"byteOffset\":9223372036854775807", SPIN_E_MALFORMED, "or begins there"},
        {"", ",\"count\":4000000000", SPIN_E_MALFORMED, "billions of splats"},
        {"", ",\"count\":-1", SPIN_E_MALFORMED, "a negative number of splats"},
        {"", ",\"count\":3", SPIN_E_MALFORMED, "attributes of different lengths"},
        {"", ",\"sparse\":{}", SPIN_E_MALFORMED, "a sparse accessor"},
        {"", ",\"componentType\":5125", SPIN_E_MALFORMED, "numbers of a type that is not allowed"},
        {"", ",\"type\":\"VEC4\"", SPIN_E_MALFORMED, "four numbers in place of three"},
    };
    struct spin_glb_clip layout = {.sh_degree = 1};
    struct spin_gaussian row[4];
    struct spin_splats s = {0};
    unsigned char *bytes, *file;
    const float bad = INFINITY;
    size_t size;
    char *json;

    spin_glb_begin(&layout);
    bytes = make_bytes(&layout, 4, row);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        json = describe(&layout, 4, cases[i].view, cases[i].place);
        file = make_glb(json, bytes, 4 * layout.row, &size);
        if (!ok(read_glb(file, size, &s) == cases[i].status, "%s", cases[i].what))
            printf("#   %s\n", spin_last_error());
        free(file);
        free(json);
    }
    json = describe(&layout, 4, "", "");
    file = make_glb(json, bytes, 4 * layout.row, &size);
    check_hostile(read_glb, file, size, 0);
    free(file);
    memcpy(bytes + 4 * 28 + 20, &bad, sizeof bad);
    file = make_glb(json, bytes, 4 * layout.row, &size);
    ok(read_glb(file, size, &s) == SPIN_E_MALFORMED && strstr(spin_last_error(), "SCALE") &&
           strstr(spin_last_error(), "row 1"),
       "an infinite scale, with its row");
    free(file);
    free(json);
    free(bytes);
    spin_splats_free(&s);
}

TAP_MAIN
{
    test_round_trip(0);
    test_round_trip(2);
    test_round_trip(3);
    test_documents();
}
