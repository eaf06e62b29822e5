/* bundle_pack: packed arrays come back bit for bit, rounded ones within bounds; malformed files are
 * refused, in one line that names file and array.  K: bundle pack */
#include <float.h>

#include "base/err.h"
#include "base/log.h"
#include "scene/bundle.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { FRAMES = 4, N = 900 };
static const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
static const unsigned still = SPIN_COL_LOG_SCALES;
static char path[300];

/* ---- Round trips
 * --------------------------------------------------------------------------------- */

static size_t count_of(int frame) { return frame == 2 ? N - 100 : N + (size_t)frame; }

static float noise(void)
{
    static uint32_t state = 1;

    state = state * 1664525u + 1013904223u;
    return (float)(int32_t)state / 0x1p31f;
}

/* Frame 1 has the rows of frame 0 but for the last 100, which are plain; frame 2 moves all of them
 * a little; frame 3 shares nothing. */
static void fill(struct spin_splats frame[FRAMES])
{
    memset(frame, 0, FRAMES * sizeof *frame);
    for (int f = 0; f < FRAMES; f++) {
        if (spin_splats_reserve(&frame[f], N + FRAMES, columns, 1) != SPIN_OK)
            exit(1);
        frame[f].n = count_of(f);
        for (unsigned c = 1; c < SPIN_COLUMNS_END; c <<= 1) {
            size_t width = spin_column_width(c, 1);
            float *out = *spin_column_of(&frame[f], c), *key = *spin_column_of(&frame[0], c);

            for (size_t i = 0; (columns & c) && i < (N + FRAMES) * width; i++)
                out[i] = c == still || (f == 1 && i < (N - 100) * width) ? (f ? key[i] : noise())
                         : f == 1                                        ? 1
                         : f == 2                                        ? key[i] * 1.0001f
                                                                         : noise();
        }
    }
    frame[0].means[0] = frame[1].means[0] = NAN;
    frame[3].means[1] = -INFINITY;
    frame[3].sh[5] = -0.0f;
}

static spin_json *parse(const char *text)
{
    spin_json *json = NULL;

    if (spin_json_parse("test", text, strlen(text), &json) != SPIN_OK)
        exit(1);
    return json;
}

static void write_clip(struct spin_splats frame[FRAMES], bool packs, bool same_n)
{
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {.n_source_frames = FRAMES,
                                    .columns = same_n ? columns : columns & ~still,
                                    .static_columns = same_n ? still : 0,
                                    .sh_degree = 1};
    spin_json *extra =
        parse("{\"refined\": {\"columns\": [\"means\"], \"sh_degree\": -1, \"frames\": "
              "[{\"n\": 5}, {\"n\": 6}, {\"n\": 7}, {\"n\": 0}]}}");

    if (spin_bundle_meta_reserve(&meta, FRAMES) != SPIN_OK ||
        spin_bundle_writer_open(path, true, false, &w) != SPIN_OK)
        exit(1);
    w.packs = packs;
    for (int f = 0; f < FRAMES; f++) {
        struct spin_splats refined = {.n = f == 3 ? 0 : 5 + (size_t)f, .means = frame[f].means};

        meta.frame[f].number = f;
        frame[f].n = meta.frame[f].n = same_n ? N : count_of(f);
        if (spin_bundle_write_frame(&w, f, meta.columns, meta.static_columns, &frame[f]) !=
                SPIN_OK ||
            spin_bundle_write_refined(&w, f, SPIN_COL_MEANS, &refined) != SPIN_OK)
            exit(1);
    }
    if (!ok(spin_bundle_writer_finish(&w, &meta, extra) == SPIN_OK, "writes a clip"))
        printf("#   %s\n", spin_last_error());
    spin_bundle_meta_free(&meta);
}

static void same_frame(struct spin_bundle *b, int f, const struct spin_splats *want)
{
    struct spin_splats got = {0}, view = {0}, expected = *want;

    if (!ok(spin_bundle_frame(b, f, b->meta.columns, &got) == SPIN_OK && got.n == want->n &&
                spin_bundle_view(b, f, SPIN_FROM_SOURCE, b->meta.columns, &view) == SPIN_OK,
            "frame %d", f)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    for (unsigned c = 1; c < SPIN_COLUMNS_END; c <<= 1) {
        size_t bytes = want->n * spin_column_width(c, 1) * sizeof(float);

        if (!(b->meta.columns & c))
            continue;
        check_same_bits(*spin_column_of(&got, c), *spin_column_of(&expected, c), bytes,
                        spin_column_name(c));
        check_same_bits(*spin_column_of(&view, c), *spin_column_of(&expected, c), bytes, "a view");
    }
    spin_splats_free(&got);
    spin_splats_free(&view);
}

static int rows_of(const struct spin_bundle *b, const char *series, int frame)
{
    int64_t rows = -1;

    spin_json_integer(
        spin_json_at(spin_json_get(spin_json_get(b->json, "xor_rows"), series), (size_t)frame),
        &rows);
    return (int)rows;
}

static void test_round_trip(bool same_n)
{
    struct spin_splats frame[FRAMES], got = {0};
    uint32_t packed[FRAMES], stored[FRAMES];
    struct spin_bundle_bytes bytes, unpacked;
    struct spin_bundle b;

    fill(frame);
    write_clip(frame, true, same_n);
    if (!ok(spin_bundle_open(path, &b) == SPIN_OK, "a packed clip opens: %s", spin_last_error()))
        return;
    for (int f = FRAMES - 1; f >= 0; f--) { /* the last first: the key is found when it is needed */
        same_frame(&b, f, &frame[f]);
        ok(spin_bundle_checksum(&b, f, columns, &packed[f]) == SPIN_OK, "its checksum");
    }
    ok(spin_bundle_refined_frame(&b, 2, SPIN_COL_MEANS, &got) == SPIN_OK && got.n == 7 &&
           memcmp(got.means, frame[2].means, 7 * 3 * sizeof(float)) == 0 &&
           spin_bundle_refined_frame(&b, 3, SPIN_COL_MEANS, &got) == SPIN_OK && got.n == 0,
       "refined frames, one of no splats");
    ok(rows_of(&b, "source/means", 0) == 0 && rows_of(&b, "source/means", 1) == N - 100 &&
           rows_of(&b, "source/means", 2) == (int)b.meta.frame[2].n &&
           rows_of(&b, "source/means", 3) == 0,
       "rows that are differences: those that are the same, all, none (%d %d %d %d)",
       rows_of(&b, "source/means", 0), rows_of(&b, "source/means", 1),
       rows_of(&b, "source/means", 2), rows_of(&b, "source/means", 3));
    spin_bundle_sizes(&b, &bytes, &unpacked);
    ok(bytes.source < 3 * unpacked.source / 4 && unpacked.source > 2 * N * 14 * sizeof(float) &&
           bytes.file == b.npz.zip.map.size && unpacked.file > unpacked.source,
       "storage, packed and not");
    spin_bundle_close(&b);
    write_clip(frame, false, same_n);
    if (spin_bundle_open(path, &b) != SPIN_OK)
        exit(1);
    for (int f = 0; f < FRAMES; f++) {
        same_frame(&b, f, &frame[f]);
        if (spin_bundle_checksum(&b, f, columns, &stored[f]) != SPIN_OK)
            exit(1);
    }
    ok(memcmp(packed, stored, sizeof packed) == 0 && packed[0] != packed[1],
       "checksums are those of the values, however they lie");
    spin_bundle_close(&b);
    spin_splats_free(&got);
    for (int f = 0; f < FRAMES; f++)
        spin_splats_free(&frame[f]);
}

/* ---- Whole numbers
 * ------------------------------------------------------------------------------- */

static struct spin_array head_of(const struct spin_bundle *b, const char *name)
{
    struct spin_array a;

    if (spin_npz_head(&b->npz, name, &a) != SPIN_OK)
        exit(1);
    return a;
}

/* Frames 0, 1 and 3 are multiples of 1/64, 1/64 and 1/1024, frame 1 mostly those of frame 0; frame
 * 2 would be but for one value, which is `odd`. Colours are those of bytes. */
static void test_whole(float odd, const char *what)
{
    static const float per_unit[3] = {64, 64, 1024};
    static const float bytes[] = {0, 1 / 255.0f, 254 / 255.0f, 1};
    const unsigned both = SPIN_COL_MEANS | SPIN_COL_RGB;
    struct spin_splats frame[FRAMES];
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {.n_source_frames = FRAMES, .columns = both, .sh_degree = -1};
    const spin_json *units;
    struct spin_bundle_bytes stored, unpacked;
    struct spin_bundle b;
    double unit = 0;

    if (spin_bundle_meta_reserve(&meta, FRAMES) != SPIN_OK ||
        spin_bundle_writer_open(path, true, false, &w) != SPIN_OK)
        exit(1);
    w.packs = true;
    if (spin_packer_units(&w.packer, "source/means", 3, per_unit) != SPIN_OK)
        exit(1);
    memset(frame, 0, sizeof frame);
    for (int f = 0; f < FRAMES; f++) {
        if (spin_splats_reserve(&frame[f], N, both, 0) != SPIN_OK)
            exit(1);
        meta.frame[f].number = f;
        frame[f].n = meta.frame[f].n = N;
        for (size_t i = 0; i < N * 3; i++) {
            frame[f].means[i] = f == 1 && i < 3 * (N - 9) ? frame[0].means[i]
                                : i % 3 < 2               ? rintf(300 * noise()) / 64
                                                          : rintf(3000 * noise()) / 1024;
            frame[f].means[i] += 0.0f; /* no -0 */
            frame[f].rgb[i] = i < 4 ? bytes[i] : rintf(127 + 127 * noise()) / 255;
        }
    }
    frame[0].means[0] = -0x1.234p8f;
    frame[1].means[0] = 0x1.fffffep17f; /* of many planes, and frame 0 has it not */
    frame[0].means[5] = frame[1].means[5] = 0x1p20f;
    frame[2].means[100] = odd;
    for (int f = 0; f < FRAMES; f++)
        if (spin_bundle_write_frame(&w, f, both, 0, &frame[f]) != SPIN_OK)
            exit(1);
    ok(spin_bundle_writer_finish(&w, &meta, NULL) == SPIN_OK &&
           spin_bundle_open(path, &b) == SPIN_OK,
       "whole numbers, and %s: %s", what, spin_last_error());
    for (int f = FRAMES - 1; f >= 0; f--)
        same_frame(&b, f, &frame[f]);
    ok(head_of(&b, "source/means/00000").kind == 'i' &&
           head_of(&b, "source/means/00002").kind == 'u' &&
           head_of(&b, "source/means/00003").kind == 'i',
       "%s: only that frame is of the bits of values", what);
    ok(head_of(&b, "source/rgb/00002").kind == 'i' &&
           head_of(&b, "source/rgb/00002").shape[0] == 2 &&
           head_of(&b, "source/rgb/00002").shape[2] == N,
       "colours have two planes, and rows go last");
    spin_bundle_sizes(&b, &stored, &unpacked);
    ok(unpacked.source > FRAMES * N * 6 * 4 && unpacked.source < FRAMES * N * 6 * 4 + 2000 &&
           unpacked.file > unpacked.source && stored.source < unpacked.source / 2,
       "unpacked they would be words of four bytes (%llu)", (unsigned long long)unpacked.source);
    units = spin_json_get(spin_json_get(b.json, "per_unit"), "source/means");
    ok(spin_json_length(units) == 3 && spin_json_number(spin_json_at(units, 2), &unit) &&
           unit == 1024 && rows_of(&b, "source/means", 1) > 0 &&
           rows_of(&b, "source/means", 2) == 0,
       "meta.json says the units, and which rows are differences (%d %d)",
       rows_of(&b, "source/means", 1), rows_of(&b, "source/means", 2));
    spin_bundle_close(&b);
    spin_bundle_meta_free(&meta);
    for (int f = 0; f < FRAMES; f++)
        spin_splats_free(&frame[f]);
}

static void test_words(void)
{
    static const int32_t k[] = {0, -1, 1, -2, 2, INT32_MAX, INT32_MIN};
    static const uint32_t word[] = {0, 1, 2, 3, 4, UINT32_MAX - 1, UINT32_MAX};
    bool good = true;

    for (size_t i = 0; i < sizeof k / sizeof *k; i++)
        good = good && spin_word_of(k[i]) == word[i] && spin_word_to(word[i]) == k[i];
    ok(good, "words of whole numbers, and back");
}

/* ---- Rounding
 * ------------------------------------------------------------------------------------ */

static void test_rounding(void)
{
    float v[1000], r[1000];
    double worst = 0, worst_small = 0;
    bool bits_ok = true, step_ok = true;
    float odd[] = {NAN, INFINITY, -INFINITY, FLT_MAX, -0.0f, 1, 0x1.ffep0f, 0x1.fffp0f, 0x1.001p0f};

    for (int i = 0; i < 1000; i++)
        v[i] = r[i] = noise() * exp2f((float)(i % 40) - 20);
    spin_round_values(r, 1000, 11, 0);
    for (int i = 0; i < 1000; i++) {
        uint32_t u;

        memcpy(&u, &r[i], sizeof u);
        bits_ok = bits_ok && !(u & 0x1fff);
        worst = larger(worst, fabs((double)r[i] - (double)v[i]) / fabs((double)v[i]));
        r[i] = v[i];
    }
    ok(bits_ok && worst <= 0x1p-11 && worst > 0x1p-12, "11 bits: an error of %.3g of a value",
       worst);
    spin_round_values(r, 1000, 11, 0x1p-11f);
    for (int i = 0; i < 1000; i++) {
        step_ok = step_ok && fmod((double)r[i], 0x1p-11) == 0;
        if (fabsf(v[i]) < 1)
            worst_small = larger(worst_small, fabs((double)r[i] - (double)v[i]));
    }
    ok(step_ok && worst_small <= 0x1p-11, "and a step: %.3g of small values", worst_small);
    spin_round_values(odd, 9, 11, 0);
    ok(isnan(odd[0]) && odd[1] == INFINITY && odd[2] == -INFINITY && odd[3] == FLT_MAX &&
           odd[4] == 0 && !signbit(odd[4]) && odd[5] == 1,
       "what is not finite stays, and nothing becomes infinite");
    ok(odd[6] == 2 && odd[7] == 2 && odd[8] == 1,
       "to the nearest, halfway to even, also into the next power of two");
}

/* ---- Lies
 * ---------------------------------------------------------------------------------------- */

#define META(more)                                                                                 \
    "{\"format\":\"spin bundle\",\"version\":2,\"from\":\"x\",\"numbered\":false,"                 \
    "\"columns\":[\"means\"],\"static_columns\":[],\"sh_degree\":-1,\"data\":null,"                \
    "\"source_frames\":2,\"frames\":[{\"number\":0,\"time\":0,\"n\":2,\"source_index\":0},"        \
    "{\"number\":1,\"time\":1,\"n\":2,\"source_index\":1}]" more "}"

struct lie {
    const char *meta, *word, *what;
    const char *descr;
    uint64_t shape[3];
};

/* A clip of two frames of two points, of which the second is as the lie has it. */
static void write_lie(const struct lie *lie)
{
    static const unsigned char zeros[64];
    struct spin_zip_writer w;
    uint64_t shape[3] = {4, 2, 3};

    if (spin_zip_writer_open(path, true, &w) != SPIN_OK ||
        spin_npz_write(&w, "source/means/00000", "|u1", 3, shape, zeros) != SPIN_OK ||
        spin_npz_write(&w, "source/means/00001", lie->descr, 3, lie->shape, zeros) != SPIN_OK ||
        spin_zip_member_begin_deflated(&w, "meta.json", strlen(lie->meta)) != SPIN_OK ||
        spin_zip_member_write(&w, lie->meta, strlen(lie->meta)) != SPIN_OK ||
        spin_zip_member_end(&w) != SPIN_OK || spin_zip_writer_commit(&w) != SPIN_OK)
        exit(1);
}

/* Opens and reads all of it. */
static spin_status read_everything(void)
{
    struct spin_splats s = {0};
    struct spin_bundle b;
    spin_status status = spin_bundle_open(path, &b);

    if (status != SPIN_OK)
        return status;
    for (int f = b.meta.n_frames - 1; f >= 0 && status == SPIN_OK; f--) {
        status = spin_bundle_frame(&b, f, b.meta.columns, &s);
        if (status == SPIN_OK && b.refined.columns)
            status = spin_bundle_refined_frame(&b, f, b.refined.columns, &s);
    }
    spin_bundle_close(&b);
    spin_splats_free(&s);
    return status;
}

#define UNITS(list, more) META(",\"per_unit\":{\"source/means\":" list "}" more)

static void test_lies(void)
{
    static const struct lie lies[] = {
        {META(""), "source/means/00001", "five planes of columns", "|i1", {5, 3, 2}},
        {META(""), "source/means/00001", "no plane", "|i1", {0, 3, 2}},
        {META(",\"per_unit\":[]"), "per_unit", "units in a list", "|i1", {1, 3, 2}},
        {UNITS("1", ""), "per_unit", "a number for a list of units", "|i1", {1, 3, 2}},
        {UNITS("[1,1]", ""), "per_unit", "a unit too few", "|i1", {1, 3, 2}},
        {UNITS("[1,1,0]", ""), "per_unit", "a unit of nothing", "|i1", {1, 3, 2}},
        {UNITS("[1,-1,1]", ""), "per_unit", "a negative unit", "|i1", {1, 3, 2}},
        {UNITS("[1,1e39,1]", ""), "per_unit", "a unit that no float holds", "|i1", {1, 3, 2}},
        {UNITS("[1,null,1]", ""), "per_unit", "a unit that is no number", "|i1", {1, 3, 2}},
        {UNITS("[1,1,1]", ",\"xor_rows\":{\"source/means\":[0,1]}"),
         "source/means/00001",
         "whole numbers as differences from bits",
         "|i1",
         {1, 3, 2}},
        {META(""), "source/means/00001", "three planes", "|u1", {3, 2, 3}},
        {META(""), "source/means/00001", "a point too few", "|u1", {4, 1, 3}},
        {META(""), "source/means/00001", "planes of signed bytes", "|i1", {4, 2, 3}},
        {META(",\"xor_rows\":[]"), "xor_rows", "xor_rows in a list", "|u1", {4, 2, 3}},
        {META(",\"xor_rows\":{\"source/means\":3}"),
         "source/means/00000",
         "a number for a list",
         "|u1",
         {4, 2, 3}},
        {META(",\"xor_rows\":{\"source/means\":[0]}"),
         "source/means/00001",
         "a list too short",
         "|u1",
         {4, 2, 3}},
        {META(",\"xor_rows\":{\"source/means\":[0,3]}"),
         "source/means/00001",
         "more differences than rows",
         "|u1",
         {4, 2, 3}},
        {META(",\"xor_rows\":{\"source/means\":[0,-1]}"),
         "source/means/00001",
         "a negative number of them",
         "|u1",
         {4, 2, 3}},
        {META(",\"xor_rows\":{\"source/means\":[0,1.5]}"),
         "source/means/00001",
         "half a row",
         "|u1",
         {4, 2, 3}},
        {META(",\"xor_rows\":{\"source/means\":[0,1e99]}"),
         "source/means/00001",
         "an absurd number of them",
         "|u1",
         {4, 2, 3}},
        {META(",\"xor_rows\":{\"source/means\":[1,0]}"),
         "source/means/00000",
         "a frame 0 of differences",
         "|u1",
         {4, 2, 3}},
    };

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        write_lie(&lies[i]);
        ok(read_everything() == SPIN_E_MALFORMED && strstr(spin_last_error(), lies[i].word) &&
               strstr(spin_last_error(), path) && !strchr(spin_last_error(), '\n'),
           "%s: %s", lies[i].what, spin_last_error());
    }
}

/* A file of version 2, all of unsigned bytes: the first row of frame 1 is a difference from that of
 * frame 0. */
static void test_version_2(void)
{
    static const char meta[] = META(",\"xor_rows\":{\"source/means\":[0,1]}");
    static const uint32_t first[6] = {0x3f800000, 0xc0490fdb, 1, 0x40000000, 0, 0x7f7fffff};
    static const uint32_t second[6] = {0x3f800001, 0xc0490fdb, 2, 0x41000000, 0x80000000, 3};
    unsigned char planes[2][24];
    uint64_t shape[3] = {4, 2, 3};
    struct spin_splats s = {0};
    struct spin_zip_writer w;
    struct spin_bundle b;

    for (int i = 0; i < 6; i++)
        for (int k = 0; k < 4; k++) {
            planes[0][6 * k + i] = (unsigned char)(first[i] >> 8 * k);
            planes[1][6 * k + i] = (unsigned char)((second[i] ^ (i < 3 ? first[i] : 0)) >> 8 * k);
        }
    if (spin_zip_writer_open(path, true, &w) != SPIN_OK ||
        spin_npz_write(&w, "source/means/00000", "|u1", 3, shape, planes[0]) != SPIN_OK ||
        spin_npz_write(&w, "source/means/00001", "|u1", 3, shape, planes[1]) != SPIN_OK ||
        spin_zip_member_begin(&w, "meta.json", strlen(meta)) != SPIN_OK ||
        spin_zip_member_write(&w, meta, strlen(meta)) != SPIN_OK ||
        spin_zip_member_end(&w) != SPIN_OK || spin_zip_writer_commit(&w) != SPIN_OK ||
        spin_bundle_open(path, &b) != SPIN_OK)
        exit(1);
    if (ok(spin_bundle_frame(&b, 1, SPIN_COL_MEANS, &s) == SPIN_OK, "version 2 is read"))
        check_same_bits(s.means, second, sizeof second, "version 2, a difference and a value");
    if (ok(spin_bundle_frame(&b, 0, SPIN_COL_MEANS, &s) == SPIN_OK, "and its frame 0"))
        check_same_bits(s.means, first, sizeof first, "version 2, frame 0");
    spin_bundle_close(&b);
    spin_splats_free(&s);
}

/* Frames of different counts: more rows of differences than frame 0 has. */
static void test_short_key(void)
{
    static const unsigned char zeros[256];
    static const char meta[] =
        "{\"format\":\"spin bundle\",\"version\":2,\"from\":\"x\",\"numbered\":false,"
        "\"columns\":[\"means\"],\"static_columns\":[],\"sh_degree\":-1,\"data\":null,"
        "\"source_frames\":2,\"frames\":[{\"number\":0,\"time\":0,\"n\":1,\"source_index\":0},"
        "{\"number\":1,\"time\":1,\"n\":2,\"source_index\":1}],"
        "\"xor_rows\":{\"source/means\":[0,2]}}";
    struct spin_zip_writer w;
    uint64_t one[3] = {4, 1, 3}, two[3] = {4, 2, 3};

    if (spin_zip_writer_open(path, true, &w) != SPIN_OK ||
        spin_npz_write(&w, "source/means/00000", "|u1", 3, one, zeros) != SPIN_OK ||
        spin_npz_write(&w, "source/means/00001", "|u1", 3, two, zeros) != SPIN_OK ||
        spin_zip_member_begin(&w, "meta.json", strlen(meta)) != SPIN_OK ||
        spin_zip_member_write(&w, meta, strlen(meta)) != SPIN_OK ||
        spin_zip_member_end(&w) != SPIN_OK || spin_zip_writer_commit(&w) != SPIN_OK)
        exit(1);
    ok(read_everything() == SPIN_E_MALFORMED && strstr(spin_last_error(), "source/means/00001") &&
           strstr(spin_last_error(), path),
       "differences from rows that frame 0 has not: %s", spin_last_error());
}

static bool reads(const char *of)
{
    (void)of;
    return read_everything() == SPIN_OK;
}

static void test_damage(void)
{
    struct spin_splats frame[FRAMES];

    fill(frame);
    write_clip(frame, true, true);
    for (int f = 0; f < FRAMES; f++)
        spin_splats_free(&frame[f]);
    check_damage(path, reads);
}

TAP_MAIN
{
    spin_log_set_level(-1);
    snprintf(path, sizeof path, "%s/clip.spin", check_folder());
    test_round_trip(false);
    test_round_trip(true);
    test_whole(0.3f, "one value that is no multiple");
    test_whole(-0.0f, "one value of -0");
    test_whole(NAN, "one that is none");
    test_whole(0x1p60f, "one that is too large");
    test_words();
    test_rounding();
    test_lies();
    test_version_2();
    test_short_key();
    test_damage();
}
