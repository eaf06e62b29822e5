/* K: html page export */
#include "exporters/lib/page_group.h"

#include "base/log.h"
#include "base/pool.h"
#include "tests/exporters/frame.h"

enum { N = 1000 };

/* ---- Bytes ------------------------------------------------------------------------------------
 */

static void test_whole(void)
{
    static int32_t x[N], y[N];
    static const int32_t edge[] = {
        0, 1, -1, 127, 128, -128, -129, 32767, -32769, SPIN_PAGE_MOST - 1, 1 - SPIN_PAGE_MOST};
    struct spin_page_bytes b = {0};
    size_t at = 0, refused = 0;
    uint32_t seed = 3;

    for (size_t i = 0; i < N; i++)
        x[i] = i < 11 ? edge[i] : (int32_t)draw(&seed, -3e7f, 3e7f);
    ok(spin_page_encode_whole(&b, x, N) == SPIN_OK &&
           spin_page_decode_whole(b.data, b.n, &at, y, N) == SPIN_OK && at == b.n &&
           memcmp(x, y, sizeof x) == 0,
       "numbers of any size come back");
    for (size_t n = 0; n < b.n; n++) {
        at = 0;
        refused += spin_page_decode_whole(b.data, n, &at, y, N) == SPIN_E_MALFORMED;
    }
    ok(refused == b.n, "and no fewer bytes are taken");
    b.data[0] |= 0x20;
    at = 0;
    ok(spin_page_decode_whole(b.data, b.n, &at, y, N) == SPIN_E_MALFORMED,
       "nor a column of another kind");
    b.n = at = 0;
    for (size_t i = 0; i < N; i++)
        x[i] = 1000000 + (int32_t)i;
    ok(spin_page_encode_whole(&b, x, N) == SPIN_OK && b.n == 1 + 3 * N &&
           spin_page_decode_whole(b.data, b.n, &at, y, N) == SPIN_OK && memcmp(x, y, sizeof x) == 0,
       "against the one before where that is less");
    memset(x, 0, sizeof x);
    b.n = at = 0;
    ok(spin_page_encode_whole(&b, x, N) == SPIN_OK && b.n == 1 &&
           spin_page_decode_whole(b.data, b.n, &at, y, N) == SPIN_OK && memcmp(x, y, sizeof x) == 0,
       "zeros take a byte");
    spin_page_bytes_free(&b);
}

/* Columns that are best encoded directly, as differences, relative to another column, and as
 * differences relative to it; all decode exactly. */
static void test_columns(void)
{
    static int32_t other[N], x[4][N], y[N];
    static const int head[] = {1, 1 | 16, 32, 32 | 16};
    uint32_t seed = 9;

    for (size_t i = 0; i < N; i++) {
        other[i] = (int32_t)draw(&seed, -3e7f, 3e7f);
        x[0][i] = (int32_t)draw(&seed, -99, 99);
        x[1][i] = 40 * (int32_t)i;
        x[2][i] = other[i];
        x[3][i] = other[i] + 40 * (int32_t)i;
    }
    for (int k = 0; k < 4; k++) {
        struct spin_page_bytes b = {0};
        size_t at = 0, refused = 0;

        ok(spin_page_encode_column(&b, x[k], other, N) == SPIN_OK &&
               b.data[0] >> 4 == head[k] >> 4 && b.n <= 1 + N &&
               spin_page_decode_column(b.data, b.n, &at, y, other, N) == SPIN_OK && at == b.n &&
               memcmp(x[k], y, sizeof y) == 0,
           "column %d in its way, %zu bytes", k, b.n);
        for (size_t n = 0; n < b.n; n++) {
            at = 0;
            refused += spin_page_decode_column(b.data, n, &at, y, other, N) == SPIN_E_MALFORMED;
        }
        at = 0;
        ok(refused == b.n &&
               (spin_page_decode_column(b.data, b.n, &at, y, NULL, N) == SPIN_OK) == (k < 2),
           "and no fewer bytes, nor without the other column");
        spin_page_bytes_free(&b);
    }
}

static void test_changes(void)
{
    static int32_t x[N], last[2][N], mean[2][N];
    struct spin_page_state out = {last[0], mean[0]}, in = {last[1], mean[1]};
    struct spin_page_bytes b = {0};
    size_t at, wrong = 0, refused = 0;
    bool by_mean = false, by_last = false;
    uint32_t seed = 5;

    for (int f = 0; f < 12; f++) {
        b.n = at = 0;
        for (size_t i = 0; i < N; i++)
            x[i] = f == 11 ? (i % 7 ? 0 : 70000 - (int32_t)i)
                           : (f < 6 ? 5 * f : 0) + (int32_t)draw(&seed, -20, 20);
        wrong += spin_page_encode_changes(&b, x, N, &out) != SPIN_OK;
        wrong += spin_page_decode_changes(b.data, b.n, &at, N, &in) != SPIN_OK || at != b.n;
        wrong += memcmp(x, in.last, sizeof x) != 0 || memcmp(out.mean, in.mean, sizeof x) != 0;
        *(b.data[0] & 16 ? &by_mean : &by_last) = true;
    }
    ok(wrong == 0, "differences of twelve frames come back");
    ok(by_mean && by_last, "told from the frame before, or from the mean");
    for (size_t n = 0; n < b.n; n++) {
        at = 0;
        refused += spin_page_decode_changes(b.data, n, &at, N, &in) == SPIN_E_MALFORMED;
    }
    ok(refused == b.n, "and no fewer bytes are taken");
    b.n = 0;
    ok(spin_page_encode_changes(&b, out.last, N, &out) == SPIN_OK && b.n == 1,
       "what does not change takes a byte");
    spin_page_bytes_free(&b);
}

/* ---- A row --------------------------------------------------------------------------------------
 */

static struct spin_page_space space_of(double place)
{
    return (struct spin_page_space){.centre = {1, 2, 3},
                                    .bounds = {place, 0.02, 0.0174, 3.0 / 255, 3.0 / 255, 0.02}};
}

static void test_row(void)
{
    enum { F = 9 };
    static float value[F][SPIN_PAGE_WIDTH];
    const float *at[F];
    uint8_t present[F];
    int32_t key[SPIN_PAGE_COLUMNS], number[SPIN_PAGE_COLUMNS * F], one[SPIN_PAGE_COLUMNS];
    struct spin_page_space space = space_of(0.001);
    double shown[SPIN_PAGE_WIDTH], largest = 0;
    size_t changed = 0;

    for (int f = 0; f < F; f++) {
        at[f] = value[f];
        present[f] = f != 4;
        for (int c = 0; c < SPIN_PAGE_WIDTH; c++)
            value[f][c] = 0.3f + 0.0009f * (float)(f % 2);
        for (int c = 0; c < 4; c++)
            value[f][SPIN_PAGE_ROTATION + c] = 0.5f;
    }
    ok(spin_page_number_row(&space, at, present, F, 45, key, number, F), "a row over nine frames");
    for (int c = 0; c < SPIN_PAGE_COLUMNS; c++)
        for (int f = 0; f < F; f++)
            changed += c != SPIN_PAGE_OPACITY && number[c * F + f] != 0;
    ok(changed == 0, "what moves less than its bound does not change");
    for (int k = 0; k < 10; k++) {
        for (int f = 0; f < F; f++)
            value[f][SPIN_PAGE_OPACITY] = 0.3f + 0.003f * (float)k;
        changed += !spin_page_number_row(&space, at, present, F, 45, key, number, F);
        for (int c = 0; c < SPIN_PAGE_COLUMNS; c++)
            one[c] = number[c * F + 4];
        spin_page_value_of(&space, key, one, 45, shown);
        changed += shown[SPIN_PAGE_OPACITY] > 0;
    }
    ok(changed == 0, "where it is not there it is clear");
    spin_page_value_of(&space, key, NULL, 45, shown);
    near(shown[SPIN_PAGE_OPACITY], 0.327, 3.01 / 255, "else not");
    key[SPIN_PAGE_OPACITY] = 100;
    spin_page_value_of(&space, key, NULL, 45, shown);
    ok(shown[SPIN_PAGE_OPACITY] == 1, "a step beyond 1 is 1");
    /* half way round and on: the angle goes on, not back */
    for (int f = 0; f < F; f++) {
        double angle = 0.9 * f;

        value[f][SPIN_PAGE_ROTATION] = (float)cos(angle / 2);
        value[f][SPIN_PAGE_ROTATION + 1] = (float)sin(angle / 2);
        value[f][SPIN_PAGE_ROTATION + 2] = value[f][SPIN_PAGE_ROTATION + 3] = 0;
        value[f][0] = (float)(1e3 * f);
    }
    ok(spin_page_number_row(&space, at, present, F, 0, key, number, F),
       "a row that turns round and round");
    for (int f = 0; f < F; f++) {
        double q[4];

        for (int c = 0; c < SPIN_PAGE_SH; c++)
            one[c] = number[c * F + f];
        spin_page_value_of(&space, key, f ? one : NULL, 0, shown);
        for (int c = 0; c < 4; c++)
            q[c] = (double)value[f][SPIN_PAGE_ROTATION + c];
        largest = larger(largest, degrees_between(shown + SPIN_PAGE_ROTATION, q));
        ok(fabs(shown[0] - 1e3 * f) <= 0.001, "frame %d is where it is", f);
    }
    ok(largest <= 1 &&
           number[SPIN_PAGE_ROTATION * F + 6] > 5.3 / spin_page_step(&space, SPIN_PAGE_ROTATION),
       "turns on, within a degree (%g)", largest);
    value[3][1] = 1e6f;
    ok(!spin_page_number_row(&space, at, present, F, 0, key, number, F),
       "steps do not reach everywhere");
}

/* ---- A group ------------------------------------------------------------------------------------
 */

struct seen {
    size_t shared, still, own[8], referred, key_bytes;
    int n;
};

static spin_status see(void *context, const struct spin_page_block *b)
{
    struct seen *s = context;

    s->shared = b->n_shared;
    s->still = b->n_still;
    s->own[b->frame] = b->n_own;
    s->referred = b->frame == 0 ? b->n_referred : s->referred;
    s->key_bytes = b->frame == 0 ? b->n_bytes : s->key_bytes;
    s->n++;
    return SPIN_OK;
}

static bool add(struct spin_page_group *g, struct spin_splat_rows *rows, struct spin_splats *s)
{
    bool full = true;

    return spin_splat_rows_choose(rows, s) == SPIN_OK &&
           spin_page_group_add(g, rows, s, &full) == SPIN_OK && !full;
}

static void test_group(void)
{
    struct spin_plugin_values values = {0};
    struct spin_export_job job = {.n_threads = 2, .values = &values};
    struct spin_page_group *g = calloc(1, sizeof *g);
    struct spin_splat_rows rows = {0};
    struct spin_splats a = {0}, b = {0};
    struct seen seen = {0};

    ok(spin_splat_rows_begin(&rows, &job, NULL) == SPIN_OK, "a filter");
    *g = (struct spin_page_group){.space = space_of(0.001), .pool = rows.pool, .most_frames = 4};
    make_frame(&a, 500, 0, 1);
    make_frame(&b, 450, 0, 2);
    /* 300 of the 500 also are in b, in the opposite order, two of them at one place */
    memcpy(a.means, a.means + 3, 3 * sizeof(float));
    for (size_t i = 0; i < 300; i++) {
        memcpy(b.means + 3 * (449 - i), a.means + 3 * i, 3 * sizeof(float));
        memcpy(b.quats + 4 * (449 - i), a.quats + 4 * i, 4 * sizeof(float));
        memcpy(b.log_scales + 3 * (449 - i), a.log_scales + 3 * i, 3 * sizeof(float));
        memcpy(b.sh + 3 * (449 - i), a.sh + 3 * i, 3 * sizeof(float));
        b.logit_opacities[449 - i] = a.logit_opacities[i];
    }
    ok(add(g, &rows, &a) && add(g, &rows, &b) && add(g, &rows, &a),
       "frames of 500, 450 and 500 splats");
    ok(spin_page_group_write(g, see, &seen) == SPIN_OK && seen.n == 3, "become three blocks: %s",
       spin_last_error());
    ok(seen.shared == 300 && seen.own[0] == 200 && seen.own[1] == 150 && seen.own[2] == 200,
       "300 at places of before are shared, the others are each frame's own");
    ok(seen.still >= 298 && g->quant.part[SPIN_QUANT_PLACE].largest <= 0.001 &&
           g->n_values == 1450 * 14,
       "they stand still; every value is held to its bound");
    ok(g->quant.part[SPIN_QUANT_ROTATION].largest <= 0.0174 &&
           g->quant.part[SPIN_QUANT_ROTATION].largest > 0.7 * 0.0174,
       "turns come near to theirs: %g", g->quant.part[SPIN_QUANT_ROTATION].largest);
    ok(add(g, &rows, &a) && add(g, &rows, &b) && add(g, &rows, &b) &&
           spin_page_group_write(g, see, &seen) == SPIN_OK && seen.shared == 300 &&
           seen.own[2] == 150 && seen.still >= 298,
       "as many rows as the frame before, other rows than the first: the same 300");
    ok(add(g, &rows, &a), "a new group");
    make_frame(&b, 500, 0, 9);
    ok(!add(g, &rows, &b), "takes no frame that has nothing in common with it");
    ok(add(g, &rows, &a) && add(g, &rows, &a) && add(g, &rows, &a) && !add(g, &rows, &a),
       "and no more than it may");
    a.means[0] = 1e9f;
    seen.n = 0;
    g->n_frames = 0;
    ok(add(g, &rows, &a) && spin_page_group_write(g, see, &seen) == SPIN_E_UNSUPPORTED &&
           seen.n == 0 && strstr(spin_last_error(), "--bound-place"),
       "too far for its steps: says which option helps");
    a.means[0] = a.means[3];
    make_frame(&b, 500, 0, 9);
    memcpy(b.means, a.means, 3 * 250 * sizeof *a.means);
    b.means[3 * 499] = 1e9f;
    g->n_frames = 0;
    ok(add(g, &rows, &a) && add(g, &rows, &b) &&
           spin_page_group_write(g, see, &seen) == SPIN_E_UNSUPPORTED &&
           strstr(spin_last_error(), "--bound-place"),
       "so is one that only the second frame has");
    spin_page_group_free(g);
    spin_splat_rows_end(&rows);
    spin_splats_free(&a);
    spin_splats_free(&b);
    free(g);
}

static bool write_twice(struct spin_page_group *g, struct spin_splat_rows *rows,
                        struct spin_splats *s, struct seen *seen)
{
    return add(g, rows, s) && add(g, rows, s) && spin_page_group_write(g, see, seen) == SPIN_OK;
}

/* Static rows of groups that follow each other. The writer checks what it wrote. */
static void test_base(void)
{
    struct spin_plugin_values values = {0};
    struct spin_export_job job = {.n_threads = 2, .values = &values};
    struct spin_page_group *g = calloc(1, sizeof *g);
    struct spin_splat_rows rows = {0};
    struct spin_splats s = {0};
    struct seen seen = {0};
    size_t whole;

    ok(spin_splat_rows_begin(&rows, &job, NULL) == SPIN_OK, "a filter");
    *g = (struct spin_page_group){
        .space = space_of(0.001), .pool = rows.pool, .most_frames = 2, .refers = true};
    make_frame(&s, 500, 0, 1);
    for (size_t i = 1; i < 40; i++) /* at the same place, but not the same */
        memcpy(s.means + 3 * i, s.means, 3 * sizeof(float));
    ok(write_twice(g, &rows, &s, &seen) && seen.still == 500 && seen.referred == 0,
       "the first group stores all its rows");
    whole = seen.key_bytes;
    ok(write_twice(g, &rows, &s, &seen) && seen.still == 500 && seen.referred == 500 &&
           20 * seen.key_bytes < whole,
       "the second none: %zu bytes instead of %zu", seen.key_bytes, whole);
    for (size_t i = 100; i < 200; i++)
        s.means[3 * i] += 0.1f;
    ok(write_twice(g, &rows, &s, &seen) && seen.referred == 400, "the third those that moved");
    for (size_t i = 200; i < 300; i++)
        s.sh[3 * i] += 0.3f;
    ok(write_twice(g, &rows, &s, &seen) && seen.referred == 300, "or have another colour");
    for (size_t i = 300; i < 400; i++)
        s.log_scales[3 * i + 2] += 0.3f;
    ok(write_twice(g, &rows, &s, &seen) && seen.referred == 0 && seen.key_bytes > whole / 2,
       "and all where half of them differ");
    ok(write_twice(g, &rows, &s, &seen) && seen.referred == 500, "which the next ones refer to");
    g->refers = false;
    ok(write_twice(g, &rows, &s, &seen) && seen.referred == 0, "unless they must not");
    spin_page_group_free(g);
    spin_splat_rows_end(&rows);
    spin_splats_free(&s);
    free(g);
}

/* Errors that exceed the bound or are nonfinite are not written. */
static void test_check(void)
{
    struct spin_page_bounds bounds = space_of(0.001).bounds;
    struct spin_quant_error quant = {0};

    spin_quant_error_add(&quant, SPIN_QUANT_PLACE, 0.001);
    ok(spin_page_errors_check(&quant, &bounds) == SPIN_OK, "at its bound");
    spin_quant_error_add(&quant, SPIN_QUANT_PLACE, 0.0011);
    ok(spin_page_errors_check(&quant, &bounds) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "position has an error of 0.0011"),
       "beyond it: %s", spin_last_error());
    quant = (struct spin_quant_error){0};
    spin_quant_error_add(&quant, SPIN_QUANT_SH, (double)NAN);
    ok(spin_page_errors_check(&quant, &bounds) == SPIN_E_MALFORMED, "and no number");
}

TAP_MAIN
{
    test_check();
    test_base();
    test_whole();
    test_columns();
    test_changes();
    test_row();
    test_group();
}
