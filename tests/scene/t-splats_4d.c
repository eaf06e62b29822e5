/* splats_4d: slices of 4D splats against the formula in spin.h, which rows a time shows, rows that are no use, and the
 * way through a bundle.
 * K: splats_4d 4d bundle */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/log.h"
#include "scene/bundle.h"
#include "scene/splats_4d.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { N = 4, ALL = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES };

/* Row 0 a bell on a parabola, 1 a plateau, 2 a gate, 3 a cut of what never fades; with spin and colour in time. */
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
    ok(spin_splats_4d_settle(&s, &n_dropped, NULL) == SPIN_OK && n_dropped == 0 && s.n == N,
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
    ok(spin_splats_4d_settle(&s, &n_dropped, from) == SPIN_OK && n_dropped == 2 && s.n == 2 &&
           from[0] == 1 && from[1] == 3 && s.centres[3] == 3 && s.cuts[2] == 3,
       "NaN and no rotation go, the others close up with all their arrays");
    spin_splats_4d_free(&s);
    fill(&s);
    s.sigmas[1] = 0;
    s.gates[2] = 1.5f;
    s.plateaus[0] = 6;
    ok(spin_splats_4d_settle(&s, &n_dropped, NULL) == SPIN_OK && n_dropped == 3,
       "so do a sigma of 0, a gate above 1 and a plateau that ends before it begins");
    s.period = 0;
    ok(spin_splats_4d_settle(&s, &n_dropped, NULL) == SPIN_E_MALFORMED, "cosines need a period");
    spin_splats_4d_free(&s);
    ok(spin_splats_4d_reserve(&s, 1, 4, 0, 0) == SPIN_E_UNSUPPORTED,
       "paths of degree 4 are refused");
    spin_splats_4d_free(&s);
}

static void write_bundle(const char *path, const struct spin_splats_4d *s, size_t n_of_frame_1)
{
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {.from = "test", .n_source_frames = 2, .fps = 24};

    if (spin_bundle_meta_reserve(&meta, 2) != SPIN_OK ||
        spin_bundle_writer_open(path, true, false, &w) != SPIN_OK ||
        spin_bundle_write_4d(&w, s, &meta) != SPIN_OK)
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
    spin_splats_4d_settle(&s, &n_dropped, NULL);
    write_bundle(path, &s, 2);
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
    write_bundle(path, &s, 3);
    ok(spin_bundle_open(path, &b) == SPIN_OK &&
           spin_bundle_frame(&b, 1, ALL, &out) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "frame 1") != NULL,
       "a count that the splats do not have is refused");
    spin_bundle_close(&b);
    s.quats[0] = INFINITY;
    write_bundle(path, &s, 2);
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

TAP_MAIN
{
    spin_log_set_level(-2);
    test_slice();
    test_dropped();
    test_bundle();
}
