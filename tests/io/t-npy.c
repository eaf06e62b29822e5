/* .npy arrays and .npz archives.  K: io npy hostile golden */
#include <time.h>

#include "tests/check.h"
#include "tests/tap.h"

static char path[512];

/* An .npy in an exactly sized block, so that reading past its end is seen. */
static unsigned char *npy(int version, const char *header, const void *data, size_t n_data,
                          size_t *n)
{
    size_t n_header = strlen(header), prefix = version == 1 ? 10 : 12;
    unsigned char *bytes = malloc(prefix + n_header + n_data + 1);

    memcpy(bytes, "\x93NUMPY", 6);
    bytes[6] = (unsigned char)version;
    bytes[7] = 0;
    for (size_t i = 8; i < prefix; i++)
        bytes[i] = (unsigned char)(n_header >> 8 * (i - 8));
    memcpy(bytes + prefix, header, n_header);
    if (n_data > 0)
        memcpy(bytes + prefix + n_header, data, n_data);
    *n = prefix + n_header + n_data;
    return realloc(bytes, *n);
}

static spin_status parse(const char *header, size_t n_data)
{
    static const unsigned char zeros[256];
    struct spin_array a;
    size_t n;
    unsigned char *bytes = npy(1, header, zeros, n_data, &n);
    spin_status status = spin_npy_parse("x", bytes, n, &a);

    free(bytes);
    return status;
}

static void refused(const char *header, size_t n_data, spin_status want, const char *words)
{
    spin_status got = parse(header, n_data);

    if (!ok(got == want && strstr(spin_last_error(), words) &&
                strstr(spin_last_error(), "array 'x'"),
            "refuses %s", header))
        printf("#   status %d '%s'\n", got, got ? spin_last_error() : "");
}

static void headers(void)
{
    size_t n;
    struct spin_array a;
    unsigned char *bytes;
    static const char plain[] = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }   \n";
    int good = 1, cut = 1;

    for (int version = 1; version <= 3; version++) {
        bytes = npy(version, plain, "abcdefghijklmnopqrstuvwx", 24, &n);
        good = good && spin_npy_parse("x", bytes, n, &a) == SPIN_OK && a.kind == 'f' &&
               a.item_size == 4 && !a.big_endian && spin_array_is_contiguous(&a) && a.n_dims == 2 &&
               a.shape[0] == 2 && a.shape[1] == 3 && a.count == 6 && a.n_bytes == 24 &&
               a.data == bytes + n - 24;
        free(bytes);
    }
    ok(good, "versions 1, 2 and 3");
    for (n = 0; n < 10 + sizeof plain - 1 + 24; n++) {
        size_t whole;
        unsigned char *all = npy(1, plain, "abcdefghijklmnopqrstuvwx", 24, &whole);
        unsigned char *part = malloc(n ? n : 1);

        memcpy(part, all, n);
        free(all);
        part = realloc(part, n ? n : 1);
        cut = cut && spin_npy_parse("x", part, n, &a) == SPIN_E_MALFORMED;
        free(part);
    }
    ok(cut, "every truncation is malformed");

    ok(parse("{\"shape\": (), \"fortran_order\": True, \"descr\": \">i2\"}", 2) == SPIN_OK,
       "any order of keys, double quotes, no padding, no dimension");
    ok(parse("{'descr':'|b1','fortran_order':False,'shape':(5,)}\n", 5) == SPIN_OK, "no spaces");
    ok(parse("{'descr': '|u1', 'fortran_order': False, 'shape': (2L, 3L,)}", 6) == SPIN_OK,
       "counts as Python 2 wrote them");
    ok(parse("{'descr': '<f8', 'fortran_order': False, 'shape': (0, 99999999999999999)}", 0) ==
           SPIN_OK,
       "no rows of whatever width");
    ok(parse("{'descr': '<f4', 'fortran_order': False, 'shape': (1,)}", 9) == SPIN_OK,
       "bytes behind the data are for the caller to judge");

    refused("", 0, SPIN_E_MALFORMED, "header");
    refused("{", 0, SPIN_E_MALFORMED, "header");
    refused("{}", 0, SPIN_E_MALFORMED, "header");
    refused("{'descr': '<f4', 'fortran_order': False}", 4, SPIN_E_MALFORMED, "header");
    refused("{'descr': '<f4', 'fortran_order': 0, 'shape': ()}", 4, SPIN_E_MALFORMED, "header");
    refused("{'descr': '<f4', 'descr': '<f4', 'fortran_order': False, 'shape': ()}", 4,
            SPIN_E_MALFORMED, "header");
    refused("{'descr': '<f4', 'fortran_order': False, 'shape': (), 'x': ()}", 4, SPIN_E_MALFORMED,
            "header");
    refused("{'descr': '<f4', 'fortran_order': False, 'shape': ()} + 1", 4, SPIN_E_MALFORMED,
            "header");
    refused("{'descr': '<f4' 'fortran_order': False, 'shape': ()}", 4, SPIN_E_MALFORMED, "header");
    refused("{'descr': '<f4', 'fortran_order': False, 'shape': (1 2)}", 8, SPIN_E_MALFORMED,
            "header");
    refused("{'descr': '<f4', 'fortran_order': False, 'shape': (1)}", 4, SPIN_E_MALFORMED,
            "header");
    refused("{'descr': '<f4', 'fortran_order': False, 'shape': (-1,)}", 4, SPIN_E_MALFORMED,
            "tuple of integers");
    refused("{'descr': '<f4', 'fortran_order': False, 'shape': (,)}", 4, SPIN_E_MALFORMED,
            "tuple of integers");
    refused("{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999999999999,)}", 4,
            SPIN_E_MALFORMED, "tuple of integers");
    refused("{'descr': '<f4', 'fortran_order': False, 'shape': (4294967296, 4294967296)}", 64,
            SPIN_E_MALFORMED, "cut short");
    refused("{'descr': '<f4', 'fortran_order': False, 'shape': (4611686018427387904,)}", 64,
            SPIN_E_MALFORMED, "cut short");
    refused("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3)}", 23, SPIN_E_MALFORMED,
            "shape [2, 3] of 4-byte items, but only 23 bytes");
    refused("{'descr': '<f4', 'fortran_order': False, 'shape': (1,1,1,1,1,1,1,1,1)}", 4,
            SPIN_E_UNSUPPORTED, "more than 8 dimensions");
    refused("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", 64, SPIN_E_UNSUPPORTED,
            "'|O'");
    refused("{'descr': '<U5', 'fortran_order': False, 'shape': (1,)}", 64, SPIN_E_UNSUPPORTED,
            "'<U5'");
    refused("{'descr': '|S4', 'fortran_order': False, 'shape': (1,)}", 64, SPIN_E_UNSUPPORTED,
            "'|S4'");
    refused("{'descr': '<c8', 'fortran_order': False, 'shape': (1,)}", 64, SPIN_E_UNSUPPORTED,
            "'<c8'");
    refused("{'descr': '<f16', 'fortran_order': False, 'shape': (1,)}", 64, SPIN_E_UNSUPPORTED,
            "f16");
    refused("{'descr': '<f1', 'fortran_order': False, 'shape': (1,)}", 64, SPIN_E_UNSUPPORTED,
            "f1");
    refused("{'descr': '|f4', 'fortran_order': False, 'shape': (1,)}", 64, SPIN_E_UNSUPPORTED,
            "|f4");
    refused("{'descr': '', 'fortran_order': False, 'shape': (1,)}", 64, SPIN_E_UNSUPPORTED, "''");
    refused("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1,)}", 64,
            SPIN_E_UNSUPPORTED, "structured dtype: [('a', '<f4')]");

    bytes = npy(4, plain, "", 0, &n);
    ok(spin_npy_parse("x", bytes, n, &a) == SPIN_E_UNSUPPORTED, "refuses version 4");
    bytes[6] = 2;
    bytes[11] = 0xff;
    ok(spin_npy_parse("x", bytes, n, &a) == SPIN_E_MALFORMED, "refuses a header of 4 GB");
    bytes[0] = 'x';
    ok(spin_npy_parse("x", bytes, n, &a) == SPIN_E_MALFORMED, "refuses other bytes");
    free(bytes);
}

/* Four items of each type, in both byte orders, to all three. */
static void types(void)
{
    static const struct {
        const char *descr;
        size_t size;
        uint64_t bits[4];
        double f64[4];
        int64_t i64[4];
    } type[] = {
        {"f2", 2, {0x3c00, 0xc200, 0x0001, 0x7bff}, {1, -3, 0x1p-24, 65504}, {1, -3, 0, 65504}},
        {"f2",
         2,
         {0x0000, 0x8000, 0xfc00, 0x03ff},
         {0, -0.0, -INFINITY, 1023 * 0x1p-24},
         {0, 0, INT64_MIN, 0}},
        {"f4",
         4,
         {0x3f800000, 0xc0500000, 0x7f800000, 0x00000001},
         {1, -3.25, INFINITY, 0x1p-149},
         {1, -3, INT64_MAX, 0}},
        {"f8",
         8,
         {0x3ff0000000000000, 0xc00a000000000000, 0x43e0000000000000, 0xc3e0000000000000},
         {1, -3.25, 0x1p63, -0x1p63},
         {1, -3, INT64_MAX, INT64_MIN}},
        {"i1", 1, {0, 1, 0x80, 0xff}, {0, 1, -128, -1}, {0, 1, -128, -1}},
        {"u1", 1, {0, 1, 0x80, 0xff}, {0, 1, 128, 255}, {0, 1, 128, 255}},
        {"b1", 1, {0, 1, 0, 1}, {0, 1, 0, 1}, {0, 1, 0, 1}},
        {"i2", 2, {0, 1, 0x8000, 0xffff}, {0, 1, -32768, -1}, {0, 1, -32768, -1}},
        {"u2", 2, {0, 1, 0x8000, 0xffff}, {0, 1, 32768, 65535}, {0, 1, 32768, 65535}},
        {"i4", 4, {0, 1, 0x80000000, 0xffffffff}, {0, 1, -0x1p31, -1}, {0, 1, -2147483648LL, -1}},
        {"u4",
         4,
         {0, 1, 0x80000000, 0xffffffff},
         {0, 1, 0x1p31, 4294967295.0},
         {0, 1, 2147483648LL, 4294967295LL}},
        {"i8", 8, {0, 1, 1ULL << 63, UINT64_MAX}, {0, 1, -0x1p63, -1}, {0, 1, INT64_MIN, -1}},
        {"u8",
         8,
         {0, 1, 1ULL << 62, UINT64_MAX},
         {0, 1, 0x1p62, 0x1p64},
         {0, 1, 1LL << 62, INT64_MAX}},
    };

    for (size_t t = 0; t < sizeof type / sizeof type[0]; t++) {
        int good = 1;

        for (int big = 0; big < 2; big++) {
            unsigned char data[32], *bytes;
            char header[128];
            struct spin_array a;
            float f32[4];
            double f64[4];
            int64_t i64[4];
            size_t n, size = type[t].size;

            for (size_t i = 0; i < 4 * size; i++)
                data[i] = (unsigned char)(type[t].bits[i / size] >>
                                          8 * (big ? size - 1 - i % size : i % size));
            snprintf(header, sizeof header,
                     "{'descr': '%c%s', 'fortran_order': False, 'shape': (4,)}", big ? '>' : '<',
                     type[t].descr);
            bytes = npy(1, header, data, 4 * size, &n);
            if (spin_npy_parse("x", bytes, n, &a) == SPIN_OK) {
                spin_array_to_f32(&a, 0, 4, f32);
                spin_array_to_f64(&a, 1, 3, f64 + 1);
                spin_array_to_f64(&a, 0, 1, f64);
                spin_array_to_i64(&a, 2, 2, i64 + 2);
                spin_array_to_i64(&a, 0, 2, i64);
                for (int i = 0; i < 4; i++)
                    good = good && f64[i] == type[t].f64[i] && i64[i] == type[t].i64[i] &&
                           f32[i] == (float)type[t].f64[i] &&
                           signbit(f64[i]) == signbit(type[t].f64[i]);
            } else {
                good = 0;
            }
            free(bytes);
        }
        ok(good, "%s in both byte orders, %zu", type[t].descr, t);
    }
}

static void not_numbers(void)
{
    struct spin_array a = {.kind = 'f', .item_size = 4, .n_dims = 1, .shape = {1}, .count = 1};
    float f32 = 0;
    int64_t i64 = 1;

    a.data = (const unsigned char *)"\x00\x00\xc0\x7f";
    spin_array_to_f32(&a, 0, 1, &f32);
    spin_array_to_i64(&a, 0, 1, &i64);
    ok(isnan(f32) && i64 == 0, "NaN stays NaN, and is 0 as an integer");
    a.item_size = 2;
    a.data = (const unsigned char *)"\x01\x7c";
    spin_array_to_f32(&a, 0, 1, &f32);
    ok(isnan(f32), "so does half a NaN");
}

/* shape (2, 3, 4), item = its C index; laid out column-major: item (i, j, k) at i + 2 j + 6 k. */
static void fortran(void)
{
    static const char header[] = "{'descr': '<i2', 'fortran_order': True, 'shape': (2, 3, 4)}";
    int16_t data[24];
    struct spin_array a;
    float out[24];
    int good = 1;
    size_t n;
    unsigned char *bytes;

    for (int i = 0; i < 24; i++)
        data[i / 12 + 2 * (i / 4 % 3) + 6 * (i % 4)] = (int16_t)i;
    bytes = npy(1, header, data, sizeof data, &n);
    if (ok(spin_npy_parse("x", bytes, n, &a) == SPIN_OK && !spin_array_is_contiguous(&a),
           "parses fortran order")) {
        for (uint64_t first = 0; first < 24; first++) {
            spin_array_to_f32(&a, first, 24 - first, out);
            for (uint64_t i = first; i < 24; i++)
                good = good && out[i - first] == (float)i;
        }
        ok(good, "reads fortran order in C order, from any index on");
        ok(!spin_array_f32(&a), "and does not offer it in place");
    }
    free(bytes);
}

static void in_place(void)
{
    static const char header[] = "{'descr': '<f4', 'fortran_order': False, 'shape': (2,)}";
    float data[2] = {1.5f, -2.5f};
    size_t n;
    unsigned char *bytes = npy(1, header, data, sizeof data, &n), *moved = malloc(n + 8);
    struct spin_array a;
    int found = 0, refused_count = 0;

    for (int shift = 0; shift < 4; shift++) {
        memcpy(moved + shift, bytes, n);
        if (spin_npy_parse("x", moved + shift, n, &a) != SPIN_OK)
            continue;
        if (!spin_array_f32(&a))
            refused_count++;
        else
            found += spin_array_f32(&a)[1] == -2.5f;
    }
    ok(found == 1 && refused_count == 3, "in place only where floats are aligned");
    free(bytes);
    free(moved);
}

static void texts(void)
{
    const uint64_t shape[3] = {3, 500, 4};
    char text[40], small[6];

    spin_array_shape_text(3, shape, text, sizeof text);
    is_text(text, "[3, 500, 4]", "a shape in words");
    spin_array_shape_text(0, NULL, text, sizeof text);
    is_text(text, "[]", "no dimensions in words");
    spin_array_shape_text(3, shape, small, sizeof small);
    is_text(small, "[3, 5", "as much as there is room for");
}

static void archives(void)
{
    const uint64_t shape[2] = {3, 2}, one[1] = {4}, none[1] = {0};
    const float values[6] = {1, 2, 3, 4, 5, 6};
    const int64_t numbers[4] = {-1, 2, INT64_MIN, INT64_MAX};
    const int64_t any2[2] = {-1, 2}, bad[3] = {-1, -1, 3};
    struct spin_zip_writer w;
    struct spin_npz npz;
    struct spin_array a;
    int64_t back[4];

    spin_zip_writer_open(path, true, &w);
    ok(spin_npz_write(&w, "means", "<f4", 2, shape, values) == SPIN_OK &&
           spin_npz_write(&w, "frame/0/n", "<i8", 1, one, numbers) == SPIN_OK &&
           spin_npz_write(&w, "scalar", "|u1", 0, NULL, "\x07") == SPIN_OK &&
           spin_npz_write(&w, "empty", "<f8", 1, none, NULL) == SPIN_OK,
       "writes arrays");
    ok(spin_npz_write(&w, "bad", "O", 1, one, values) == SPIN_E_UNSUPPORTED, "but not of any type");
    spin_zip_member_begin(&w, "more.npy", 90);
    spin_zip_member_write(
        &w,
        "\x93NUMPY\1\0\x46\0{'descr': '<f4', 'fortran_order': False, 'shape': (2,), }"
        "             \n12345678yz",
        90);
    spin_zip_member_end(&w);
    if (!ok(spin_zip_writer_commit(&w) == SPIN_OK && spin_npz_open(path, &npz) == SPIN_OK,
            "and opens"))
        return;
    ok(spin_npz_has(&npz, "means") && !spin_npz_has(&npz, "mean") &&
           !spin_npz_has(&npz, "means.npy"),
       "knows its keys");
    ok(spin_npz_array_of(&npz, "means", true, 2, any2, &a) == SPIN_OK && spin_array_f32(&a) &&
           memcmp(spin_array_f32(&a), values, sizeof values) == 0,
       "floats come back in place");
    ok((uintptr_t)a.data % 64 == 0, "64-byte aligned");
    ok(spin_npz_array_of(&npz, "means", true, 3, bad, &a) == SPIN_E_MALFORMED, "checks the shape");
    is_text(spin_last_error(), "array 'means' has shape [3, 2], expected [*, *, 3]",
            "and says both");
    ok(spin_npz_array(&npz, "frame/0/n", true, &a) == SPIN_OK && a.count == 4, "a nested name");
    spin_array_to_i64(&a, 0, 4, back);
    ok(memcmp(back, numbers, sizeof back) == 0, "integers come back");
    ok(spin_npz_array(&npz, "scalar", true, &a) == SPIN_OK && a.n_dims == 0 && a.count == 1 &&
           a.data[0] == 7,
       "a scalar");
    ok(spin_npz_array(&npz, "empty", true, &a) == SPIN_OK && a.count == 0, "an empty array");
    ok(spin_npz_array(&npz, "none", true, &a) == SPIN_E_NOT_FOUND, "a missing array");
    is_text(spin_last_error(), "no array 'none'", "is named");
    ok(spin_npz_array(&npz, "more", true, &a) == SPIN_E_MALFORMED, "bytes too many are an error");
    is_text(spin_last_error(), "array 'more' has 2 bytes more than its header states",
            "that says so");
    spin_npz_close(&npz);
    ok(spin_npz_open("none.npz", &npz) == SPIN_E_NOT_FOUND &&
           strstr(spin_last_error(), "'none.npz'"),
       "a missing file is named");
}

/* Returns the seconds of processor time that 20,000 searches take in an archive of n arrays, the
 * least of five attempts; NaN if an array is not found. */
static double search_seconds(int n)
{
    const uint64_t none[1] = {0};
    struct spin_zip_writer w;
    struct spin_npz npz;
    double best = HUGE_VAL;
    char key[32];
    bool good = spin_zip_writer_open(path, true, &w) == SPIN_OK;

    for (int i = 0; good && i < n; i++) {
        snprintf(key, sizeof key, "frame/%05d/means", i);
        good = spin_npz_write(&w, key, "<f4", 1, none, NULL) == SPIN_OK;
    }
    if (!good || spin_zip_writer_commit(&w) != SPIN_OK || spin_npz_open(path, &npz) != SPIN_OK)
        return NAN;
    for (int attempt = 0; attempt < 5; attempt++) {
        clock_t start = clock();
        double seconds;

        for (int i = 0; i < 20000; i++) {
            snprintf(key, sizeof key, "frame/%05d/means", i % n);
            good = good && spin_npz_has(&npz, key);
        }
        seconds = (double)(clock() - start) / CLOCKS_PER_SEC;
        best = seconds < best ? seconds : best;
    }
    spin_npz_close(&npz);
    return good ? best : (double)NAN;
}

/* A search that visits each member takes ten times as long in ten times as many. */
static void search_time(void)
{
    double few = search_seconds(2000), many = search_seconds(20000);

    ok(many < 5 * few, "a search among 20,000 members takes %.1f times as long as among 2,000",
       many / few);
}

/* Writes a deflated archive with the array "x" of 9,800 bytes, whose header ends after n bytes. */
static bool write_padded(int version, size_t n)
{
    size_t prefix = version == 1 ? 10 : 12, n_npy;
    char *header = malloc(n - prefix + 1), *data = malloc(9800);
    struct spin_zip_writer w;
    unsigned char *bytes;
    bool good;

    for (size_t i = 0; i < 9800; i++)
        data[i] = (char)(i * 2654435761u >> 13);
    snprintf(header, n - prefix + 1, "%-*s", (int)(n - prefix),
             "{'descr': '|u1', 'fortran_order': False, 'shape': (9800,), }");
    bytes = npy(version, header, data, 9800, &n_npy);
    good = spin_zip_writer_open(path, true, &w) == SPIN_OK &&
           spin_zip_member_begin_deflated(&w, "x.npy", n_npy) == SPIN_OK &&
           spin_zip_member_write(&w, bytes, n_npy) == SPIN_OK &&
           spin_zip_member_end(&w) == SPIN_OK && spin_zip_writer_commit(&w) == SPIN_OK;
    free(header);
    free(data);
    free(bytes);
    return good;
}

/* Headers of all lengths around those that are read at once. */
static void head_lengths(void)
{
    static const size_t lengths[] = {80, 127, 128, 129, 192, 1000, 10012};

    for (int version = 1; version <= 2; version++)
        for (size_t i = 0; i < sizeof lengths / sizeof *lengths; i++) {
            struct spin_npz npz;
            struct spin_array a;

            if (!ok(write_padded(version, lengths[i]) && spin_npz_open(path, &npz) == SPIN_OK,
                    "an archive with a header of %zu bytes", lengths[i]))
                return;
            ok(spin_npz_head(&npz, "x", &a) == SPIN_OK && a.count == 9800 && a.kind == 'u',
               "version %d, %zu bytes: the header is read", version, lengths[i]);
            spin_npz_close(&npz);
        }
}

/* The header of a deflated array is read without most of its data. */
static void head_time(void)
{
    double best[2] = {HUGE_VAL, HUGE_VAL};
    struct spin_npz npz;
    bool good = write_padded(1, 128) && spin_npz_open(path, &npz) == SPIN_OK;

    if (!ok(good, "an archive of one array"))
        return;
    for (int attempt = 0; attempt < 10; attempt++) {
        clock_t start = clock();
        double seconds;

        for (int i = 0; i < 1000; i++) {
            const unsigned char *data;
            struct spin_array a;
            void *owned = NULL;

            good = good && (attempt % 2 == 0 ? spin_npz_head(&npz, "x", &a)
                                             : spin_zip_read(&npz.zip, &npz.zip.member[0], false,
                                                             1 << 20, &data, &owned)) == SPIN_OK;
            free(owned);
        }
        seconds = (double)(clock() - start) / CLOCKS_PER_SEC;
        best[attempt % 2] = fmin(best[attempt % 2], seconds);
    }
    ok(good && best[0] < 0.6 * best[1], "its header takes %.2f of the time of the array",
       best[0] / best[1]);
    spin_npz_close(&npz);
}

/* A file of numpy's, stored, and the same recompressed. */
static void fixtures(void)
{
    const char *plain = check_fixture("d3dgs/cloud/params.npz");
    const char *packed = check_fixture("d3dgs/variants/deflated.npz");
    const int64_t shape[3] = {-1, -1, 3};
    struct spin_npz npz;
    struct spin_array a;
    int good = 1;

    if (!plain) {
        skip("reads numpy's own files", "no fixture d3dgs/cloud/params.npz");
    } else if (ok(spin_npz_open(plain, &npz) == SPIN_OK, "opens numpy's own file")) {
        good = spin_npz_array_of(&npz, "means3D", true, 3, shape, &a) == SPIN_OK && a.shape[0] == 8;
        if (!ok(good, "reads means3D"))
            printf("#   %s\n", spin_last_error());
        spin_npz_close(&npz);
    }
    if (!packed) {
        skip("reads deflated arrays", "no fixture d3dgs/variants/deflated.npz");
    } else if (ok(spin_npz_open(packed, &npz) == SPIN_OK, "opens a deflated archive")) {
        for (size_t i = 0; i < npz.zip.n; i++) {
            char key[64];

            snprintf(key, sizeof key, "%.*s", (int)strlen(npz.zip.member[i].name) - 4,
                     npz.zip.member[i].name);
            good = good && spin_npz_array(&npz, key, true, &a) == SPIN_OK;
        }
        if (!ok(good && npz.n_owned > 0, "reads all %zu deflated arrays", npz.zip.n))
            printf("#   %s\n", spin_last_error());
        spin_npz_close(&npz);
    }
}

static void truncated_fixture(void)
{
    const char *whole = check_fixture("core/gelu.npz");
    struct spin_map map;
    struct spin_npz npz;
    size_t refused_count = 0, tried = 0;

    if (!whole || spin_map_open(whole, &map) != SPIN_OK) {
        skip("refuses every truncation of gelu.npz", "no fixture core/gelu.npz");
        return;
    }
    for (size_t n = 0; n < map.size; n += n + 64 < map.size ? 61 : 1) {
        tried++;
        refused_count += spin_npz_open(check_truncated(whole, n), &npz) == SPIN_E_MALFORMED;
    }
    ok(refused_count == tried, "refuses all of %zu truncations of gelu.npz", tried);
    spin_map_close(&map);
}

TAP_MAIN
{
    snprintf(path, sizeof path, "%s/t.npz", check_folder());
    headers();
    types();
    not_numbers();
    fortran();
    in_place();
    texts();
    archives();
    search_time();
    head_lengths();
    head_time();
    fixtures();
    truncated_fixture();
}
