/* splats_4d: slices of 4D splats against the formula in spin.h, which rows a time shows, rows that
 * are no use, and the way through a bundle. K: splats_4d 4d bundle */

#include "base/log.h"
#include "scene/bundle.h"
#include "scene/splats_4d.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { N = 4, ALL = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES };

/* Four rows that rotate and change colour: row 0 has a Gaussian window and moves on a parabola, row
 * 1 has a plateau, row 2 a gate, and row 3 never fades but is cut. */
static void fill(struct spin_splats_4d *s)
{
    const float plateau[N][3] = {{5, 5, 1}, {2, 4, 0.5f}, {5, 5, 1}, {0, 0, SPIN_FOREVER}};
    const float cut[N][2] = {{-SPIN_FOREVER, SPIN_FOREVER},
                             {-SPIN_FOREVER, SPIN_FOREVER},
                             {-SPIN_FOREVER, SPIN_FOREVER},
                             {3, 6}};
    const float sigma[N] = {1, 1, 1, SPIN_FOREVER}, gate[N] = {0, 0, 0.5f, 0};

    memset(s, 0, sizeof *s);
    if (spin_splats_4d_reserve(s, N, 2, 0,
                               SPIN_4D_SPINS | SPIN_4D_PLATEAUS | SPIN_4D_CUTS | SPIN_4D_GATES |
                                   SPIN_4D_SH_COS) != SPIN_OK)
        exit(1);
    s->least_opacity = 1 / 255.0;
    s->period = 8;
    for (int i = 0; i < N; i++) {
        s->centres[3 * i] = (float)i;
        s->times[i] = 5;
        s->paths[6 * i] = 1;
        s->paths[6 * i + 3] = 0.5f;
        s->quats[4 * i] = 2;
        s->spins[4 * i + 3] = 2;
        s->sh[3 * i] = 0.25f;
        s->sh_cos[6 * i] = 1;
        s->sh_cos[6 * i + 3] = 10;
        s->sigmas[i] = sigma[i];
        s->gates[i] = gate[i];
        memcpy(s->plateaus + 3 * i, plateau[i], sizeof plateau[i]);
        memcpy(s->cuts + 2 * i, cut[i], sizeof cut[i]);
    }
}

static bool close_to(double got, double want, double least) { return fabs(got - want) <= least; }

static double weight(const struct spin_splats *s, int k)
{
    return 2 / (1 + exp(-(double)s->logit_opacities[k])); /* opacities are a half */
}

static void test_slice(void)
{
    struct spin_splats_4d s;
    struct spin_splats out = {0};
    const double times[3] = {6, 4, 40}, half = exp(-0.5);
    size_t n_dropped, counts[3];

    fill(&s);
    ok(!spin_splats_4d_is_finished(&s), "rows alone are not settled");
    ok(spin_splats_4d_finish(&s, &n_dropped, NULL) == SPIN_OK && n_dropped == 0 && s.n == N &&
           spin_splats_4d_is_finished(&s),
       "all rows are of use");
    ok(spin_splats_4d_slice(&s, 4, ALL, &out) == SPIN_OK && out.n == 4, "time 4 shows all four");
    ok(close_to(out.means[3], 1 - 1 + 0.5, 1e-6) && out.means[4] == 0, "a place on a parabola");
    ok(close_to(out.quats[0], sqrt(0.5), 1e-6) && close_to(out.quats[3], -sqrt(0.5), 1e-6),
       "a rotation with its spin is of unit length");
    ok(close_to(out.sh[0], 0.25 + cos(-3.141592653589793 / 4) + 10 * cos(-3.141592653589793 / 2),
                1e-5),
       "a colour with its cosines");
    ok(close_to(weight(&out, 0), half, 1e-5) && close_to(weight(&out, 1), 1, 1e-5) &&
           close_to(weight(&out, 2), 0.5 + 0.5 * half, 1e-5) && close_to(weight(&out, 3), 1, 1e-5),
       "bell, plateau, gate and cut weigh the opacity");
    ok(spin_splats_4d_slice(&s, 6, ALL, &out) == SPIN_OK && out.n == 2 &&
           out.means[0] == 0 + 1.5f && out.means[3] == 2 + 1.5f,
       "time 6 lacks the plateau, four of its sigmas on, and the cut, whose end it is");
    ok(spin_splats_4d_slice(&s, 40, SPIN_COL_MEANS, &out) == SPIN_OK && out.n == 1,
       "a gate is seen at any time");
    ok(spin_splats_4d_counts(&s, times, 3, counts) == SPIN_OK && counts[0] == 2 && counts[1] == 4 &&
           counts[2] == 1,
       "counts are those of the slices, in the order of the times");
    spin_splats_free(&out);
    spin_splats_4d_free(&s);
}

static void test_dropped(void)
{
    struct spin_splats_4d s;
    size_t n_dropped, from[N];

    fill(&s);
    s.centres[0] = NAN;
    memset(s.quats + 8, 0, 4 * sizeof *s.quats);
    ok(spin_splats_4d_finish(&s, &n_dropped, from) == SPIN_OK && n_dropped == 2 && s.n == 2 &&
           from[0] == 1 && from[1] == 3 && s.centres[3] == 3 && s.cuts[2] == 3,
       "NaN and no rotation go, the others close up with all their arrays");
    spin_splats_4d_free(&s);
    fill(&s);
    s.sigmas[1] = 0;
    s.gates[2] = 1.5f;
    s.plateaus[0] = 6;
    ok(spin_splats_4d_finish(&s, &n_dropped, NULL) == SPIN_OK && n_dropped == 3,
       "so do a sigma of 0, a gate above 1 and a plateau that ends before it begins");
    spin_splats_4d_free(&s);
    for (int k = 0; k < SPIN_N_ARRAYS_4D; k++) {
        float *values;

        fill(&s);
        values = *spin_array_4d_of(&s, k);
        if (values)
            values[spin_array_4d_width(&s, k)] = NAN;
        ok(spin_splats_4d_finish(&s, &n_dropped, NULL) == SPIN_OK && n_dropped == (values != NULL),
           "NaN in array %d", k);
        spin_splats_4d_free(&s);
    }
    fill(&s);
    s.log_scales[4] = 400;
    ok(spin_splats_4d_finish(&s, &n_dropped, NULL) == SPIN_OK && n_dropped == 1,
       "and a scale of exp(400), which is no float");
    spin_splats_4d_free(&s);
    fill(&s);
    s.quats[4] = 1e-30f;
    s.spins[7] = 1e20f;
    ok(spin_splats_4d_finish(&s, &n_dropped, NULL) == SPIN_OK && n_dropped == 1,
       "and a rotation so short that its spin overflows when both are normalised");
    s.period = 0;
    ok(spin_splats_4d_finish(&s, &n_dropped, NULL) == SPIN_E_MALFORMED, "cosines need a period");
    spin_splats_4d_free(&s);
    ok(spin_splats_4d_reserve(&s, 1, 4, 0, 0) == SPIN_E_UNSUPPORTED,
       "paths of degree 4 are refused");
    spin_splats_4d_free(&s);
}

static void write_bundle(const char *path, const struct spin_splats_4d *s, size_t n_of_frame_1,
                         bool packs, enum spin_round_4d round)
{
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {.from = "test", .n_source_frames = 2, .fps = 24};

    if (spin_bundle_meta_reserve(&meta, 2) != SPIN_OK ||
        spin_bundle_writer_open(path, true, false, &w) != SPIN_OK)
        exit(1);
    w.packs = w.packer.quick = packs;
    if (spin_bundle_write_4d(&w, s, round, &meta) != SPIN_OK)
        exit(1);
    meta.frame[0] = (struct spin_frame_info){0, 4, 4};
    meta.frame[1] = (struct spin_frame_info){1, 6, n_of_frame_1};
    meta.source_index[1] = 1;
    if (spin_bundle_writer_finish(&w, &meta, NULL) != SPIN_OK)
        exit(1);
    spin_bundle_meta_free(&meta);
}

static void test_bundle(void)
{
    char path[300];
    struct spin_splats_4d s;
    const struct spin_splats_4d *back;
    struct spin_bundle b;
    struct spin_splats out = {0}, view = {0}, want = {0};
    uint32_t sum[3];
    size_t n_dropped;

    snprintf(path, sizeof path, "%s/a.spin", check_folder());
    fill(&s);
    spin_splats_4d_finish(&s, &n_dropped, NULL);
    write_bundle(path, &s, 2, false, SPIN_ROUND_NOTHING);
    if (!ok(spin_bundle_open(path, &b) == SPIN_OK, "a bundle of 4D splats opens")) {
        printf("# %s\n", spin_last_error());
        return;
    }
    ok(b.meta.fps == 24 && spin_bundle_count(&b, 0, SPIN_FROM_SOURCE) == 4,
       "frames have a rate and counts");
    ok(spin_bundle_splats_4d(&b, &back) == SPIN_OK && back && back->n == N && back->degree == 2 &&
           back->period == 8 && back->least_opacity == s.least_opacity &&
           spin_splats_4d_parts(back) == spin_splats_4d_parts(&s) &&
           !memcmp(back->sh_cos, s.sh_cos, 6 * N * sizeof *s.sh_cos),
       "they come back");
    ok(spin_bundle_frame(&b, 1, ALL, &out) == SPIN_OK &&
           spin_splats_4d_slice(&s, 6, ALL, &want) == SPIN_OK && out.n == 2 &&
           !memcmp(out.means, want.means, 6 * sizeof *out.means) &&
           !memcmp(out.sh, want.sh, 6 * sizeof *out.sh),
       "a frame is the slice at its time");
    ok(spin_bundle_view(&b, 1, SPIN_FROM_SOURCE, ALL, &view) == SPIN_OK && !view.mapped &&
           view.n == 2 && !memcmp(view.quats, want.quats, 8 * sizeof *view.quats),
       "and so is a view of it");
    ok(spin_bundle_checksum(&b, 0, ALL, &sum[0]) == SPIN_OK &&
           spin_bundle_checksum(&b, 1, ALL, &sum[1]) == SPIN_OK &&
           spin_bundle_checksum(&b, 1, SPIN_COL_MEANS, &sum[2]) == SPIN_OK && sum[0] != sum[1] &&
           sum[1] != sum[2],
       "checksums tell frames and columns apart");
    spin_bundle_close(&b);
    write_bundle(path, &s, 3, false, SPIN_ROUND_NOTHING);
    ok(spin_bundle_open(path, &b) == SPIN_OK &&
           spin_bundle_frame(&b, 1, ALL, &out) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "frame 1") != NULL,
       "a count that the splats do not have is refused");
    spin_bundle_close(&b);
    s.quats[0] = INFINITY;
    write_bundle(path, &s, 2, false, SPIN_ROUND_NOTHING);
    ok(spin_bundle_open(path, &b) == SPIN_OK &&
           spin_bundle_frame(&b, 1, ALL, &out) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "source/4d") != NULL,
       "rows that are no use are refused");
    spin_bundle_close(&b);
    spin_splats_free(&out);
    spin_splats_free(&view);
    spin_splats_free(&want);
    spin_splats_4d_free(&s);
}

/* Every array of `back` against `is`, which went in rounded. */
static bool same_arrays(struct spin_splats_4d *is, struct spin_splats_4d *back)
{
    bool same = is->n == back->n;

    for (int k = 0; k < SPIN_N_ARRAYS_4D && same; k++) {
        const float *a = *spin_array_4d_of(is, k), *b = *spin_array_4d_of(back, k);

        /* rotations are made of unit length again */
        for (size_t i = 0; a && i < is->n * spin_array_4d_width(is, k); i++)
            same = same && (strcmp(spin_array_4d_name(k), "quats") == 0 ||
                                    strcmp(spin_array_4d_name(k), "spins") == 0
                                ? fabsf(a[i] - b[i]) < 4e-3f
                                : a[i] == b[i]);
    }
    return same;
}

/* To 11 significant bits, and to steps: of what may be, and no more than half a step. */
static void test_round(void)
{
    static const struct {
        const char *name;
        float per_unit;
    } compact[] = {{"quats", 256}, {"log_scales", 32}, {"logit_opacities", 32},
                   {"sh", 128},    {"sh_cos", 128},    {"centres", 0},
                   {"sigmas", 0}};

    for (size_t i = 0; i < sizeof compact / sizeof *compact; i++)
        for (int k = 0; k < SPIN_N_ARRAYS_4D; k++)
            if (strcmp(spin_array_4d_name(k), compact[i].name) == 0)
                ok(spin_array_4d_per_unit(k, SPIN_ROUND_COMPACT) == compact[i].per_unit,
                   "compact: %s in steps of 1/%g", compact[i].name, compact[i].per_unit);
    for (int r = SPIN_ROUND_NOTHING; r <= SPIN_ROUND_COMPACT; r++) {
        enum spin_round_4d round = (enum spin_round_4d)r;
        struct spin_splats_4d was, is;
        const struct spin_splats_4d *back;
        struct spin_bundle b;
        char path[300];
        bool near = true, on_steps = true, whole = true;
        size_t n_dropped;

        snprintf(path, sizeof path, "%s/round%d.spin", check_folder(), r);
        fill(&was);
        fill(&is);
        spin_splats_4d_finish(&was, &n_dropped, NULL);
        spin_splats_4d_finish(&is, &n_dropped, NULL);
        is.sh[1] = was.sh[1] = 0.123456f;
        is.log_scales[1] = was.log_scales[1] = -5.4321f;
        spin_splats_4d_round(&is, round);
        for (int k = 0; k < SPIN_N_ARRAYS_4D; k++) {
            const float *a = *spin_array_4d_of(&was, k), *v = *spin_array_4d_of(&is, k);
            float per_unit = spin_array_4d_per_unit(k, round);

            for (size_t i = 0; a && i < is.n * spin_array_4d_width(&is, k); i++) {
                float most = per_unit > 0 ? fmaxf(0.501f / per_unit, fabsf(a[i]) * 0x1p-11f) : 0;

                near = near && fabsf(v[i] - a[i]) <= most;
                on_steps = on_steps && (per_unit <= 0 || fmodf(v[i] * per_unit, 1) == 0);
            }
        }
        ok(near && on_steps, "%d: values are on steps, and near", r);
        ok((is.sh[1] == 0.123456f) == (r == 0) && (is.log_scales[1] == -5.4321f) == (r == 0),
           "%d: which is not what they were, unless nothing is rounded", r);
        write_bundle(path, &is, 2, true, round);
        ok(spin_bundle_open(path, &b) == SPIN_OK && spin_bundle_splats_4d(&b, &back) == SPIN_OK &&
               same_arrays(&is, &b.four_d),
           "%d: they come back from a bundle", r);
        for (int k = 0; k < SPIN_N_ARRAYS_4D; k++)
            if (spin_array_4d_per_unit(k, round) > 0 && *spin_array_4d_of(&is, k)) {
                char name[64];
                struct spin_array head;

                snprintf(name, sizeof name, "source/4d/%s", spin_array_4d_name(k));
                whole = whole && spin_npz_head(&b.npz, name, &head) == SPIN_OK &&
                        head.kind == 'i' && head.shape[0] <= 2;
            }
        ok(whole, "%d: as whole numbers of two bytes at most", r);
        spin_bundle_close(&b);
        spin_splats_4d_free(&was);
        spin_splats_4d_free(&is);
    }
}

/* Marked rows, and what belongs to them. */
static void test_take(void)
{
    unsigned char mark[N] = {0};
    struct spin_splats_4d s, out;
    struct spin_splats a = {0}, b = {0};
    size_t n_dropped, n = 0;

    fill(&s);
    spin_splats_4d_finish(&s, &n_dropped, NULL);
    mark[1] = mark[s.n - 1] = 1;
    ok(spin_splats_4d_select(&s, mark, &out) == SPIN_OK && out.n == 2 &&
           !memcmp(out.sh_cos + 6, s.sh_cos + 6 * (s.n - 1), 6 * sizeof *s.sh_cos) &&
           !memcmp(out.spans, s.spans + 2, 2 * sizeof *s.spans),
       "two rows are taken out");
    for (double t = 0; t < 10; t += 0.5) {
        n += spin_splats_4d_is_visible(&s, 1, t) + spin_splats_4d_is_visible(&s, s.n - 1, t);
        n -= spin_splats_4d_slice(&out, t, ALL, &a) == SPIN_OK ? a.n : 0;
    }
    ok(n == 0, "and are shown when they were");
    spin_splats_free(&a);
    spin_splats_free(&b);
    spin_splats_4d_free(&s);
    spin_splats_4d_free(&out);
}

TAP_MAIN
{
    spin_log_set_level(-2);
    test_slice();
    test_dropped();
    test_bundle();
    test_round();
    test_take();
}
