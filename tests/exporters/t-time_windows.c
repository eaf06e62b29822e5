/* 4D splats as Gaussian windows in a file's unit of time: which are static, fitted, shortened or
 * omitted, and the loss.
 * K: 4d tsog sogst export */
#include "exporters/lib/time_windows.h"
#include "math/activate.h"
#include "math/motion.h"
#include "tests/tap.h"

static const double times[5] = {10, 11, 12, 13, 14};

/* Four rows: one with every feature, one that lasts forever, one of long before, a cubic path. */
static void fill(struct spin_splats_4d *s)
{
    size_t n_dropped;

    if (spin_splats_4d_reserve(s, 4, 3, 1, SPIN_4D_SPINS | SPIN_4D_SH_COS) != SPIN_OK)
        exit(1);
    s->period = 8;
    s->least_opacity = 1 / 255.0;
    for (size_t i = 0; i < 4; i++) {
        s->times[i] = 12;
        s->sigmas[i] = 1;
        s->quats[4 * i] = 1;
        s->logit_opacities[i] = 1;
        s->sh[12 * i] = 0.5f;
    }
    s->sh_cos[0] = 0.25f;    /* cos(2 pi d / 8) of red, degree 0 */
    s->sh_cos[12] = -0.125f; /* cos(4 pi d / 8) */
    s->sh_cos[12 + 5] = 2;   /* of blue, the first of degree 1 */
    s->spins[1] = 0.5f;
    s->paths[0] = 3;
    s->sigmas[1] = SPIN_FOREVER;
    s->paths[9 + 1] = 2;
    s->times[2] = -100;
    s->paths[27] = 1;
    s->paths[27 + 3] = 0.5f;
    s->paths[27 + 6] = 0.01f;
    s->sigmas[3] = 0.7f;
    if (spin_splats_4d_finish(s, &n_dropped, NULL) != SPIN_OK || n_dropped > 0)
        exit(1);
}

static void test_convert(const struct spin_export_job *job)
{
    struct spin_time_windows b = {
        .job = job, .name = "it", .length = 2, .most_sigma = 8, .degree = 1};
    const struct spin_splats_4d *c = &b.clip;
    double end = job->splats_4d->spans[1] < 14 ? job->splats_4d->spans[1] : 14, off = 0, sum = 0;

    ok(spin_time_windows_convert(&b) == SPIN_OK && c->n == 3 && c->degree == 1 && b.from[2] == 3,
       "rows that no frame shows are left out");
    ok(c->times[0] == 1 && c->sigmas[0] == 0.5f && spin_time_windows_time(&b, 14) == 2,
       "times are the file's");
    near((double)c->paths[0], 6, 1e-5, "and so are velocities");
    ok(c->sh[0] == 0.625f && c->sh[5] == 2 && c->sh[12] == 0.5f,
       "colours are those of the splat's own time, of both cosines");
    for (int k = 0; k < 9; k++) {
        double d = (end - 12) * (k - 4) / 4, turn = 0.7853981633974483 * d;

        off = larger(off, 0.28209479177387814 *
                              fabs(0.25 * (cos(turn) - 1) - 0.125 * (cos(2 * turn) - 1)));
    }
    near(b.lost_colour, off, 1e-6, "what they lose");
    near(b.lost_turn, 360 / 3.141592653589793 * atan(0.5 * (end - 12)), 1e-3, "and a rotation");
    ok(c->times[1] == 1 && c->sigmas[1] == 16 && fabs((double)c->logit_opacities[1] - 1) < 1e-3 &&
           c->centres[4] == 0,
       "what lasts for ever is put in the middle");
    /* the least-squares line of a parabola: its weighted mean, and its slope at the middle
     * except for the cubic part */
    for (int k = 0; k < 9; k++) {
        double d =
            (job->splats_4d->spans[7] < 14 ? job->splats_4d->spans[7] - 12 : 2) * (k - 4) / 4;
        double w = exp(-0.5 * d * d / 0.49);

        off = k == 0 ? 0 : off;
        off += w * 0.5 * d * d;
        sum += w;
    }
    near((double)c->centres[6], off / sum, 1e-5, "a curved path is fitted where it is seen");
    ok(c->paths[6] > 2 && c->paths[6] < 2.1f && b.lost_place > 0.1 && b.lost_place < 0.5,
       "and its speed, and what that loses");
    spin_time_windows_free(&b);
}

static void test_shorten(struct spin_export_job *job)
{
    struct spin_splats_4d s = {0};
    struct spin_time_windows b = {
        .job = job, .name = "it", .length = 1, .most_sigma = 8, .degree = 1};
    size_t n_dropped;

    if (spin_splats_4d_reserve(&s, 1, 1, 0, 0) != SPIN_OK)
        exit(1);
    s.times[0] = -60;
    s.sigmas[0] = 80;
    s.quats[0] = 1;
    s.paths[0] = 0.5f;
    job->splats_4d = &s;
    if (spin_splats_4d_finish(&s, &n_dropped, NULL) != SPIN_OK)
        exit(1);
    ok(spin_time_windows_convert(&b) == SPIN_OK && b.clip.n == 1 && b.clip.sigmas[0] == 8,
       "a sigma of twenty clips becomes one of eight");
    for (int f = 0; f < 5; f++) {
        double t = times[f], d = (t - 10) / 4 - (double)b.clip.times[0], place[3];
        double is = 0.5 * exp(-0.5 * (t + 60) * (t + 60) / 6400);
        double seen = spin_sigmoid_of((double)b.clip.logit_opacities[0]) * exp(-0.5 * d * d / 64);

        spin_path_at(b.clip.centres, b.clip.paths, 1, d, place);
        near(seen, is, 1e-3, "it fades as before");
        near(place[0], 0.5 * (t + 60), 1e-4, "and is where it was");
    }
    spin_time_windows_free(&b);
    spin_splats_4d_free(&s);
}

static bool can(const struct spin_export_job *job)
{
    const struct spin_time_windows b = {.job = job, .name = "it"};

    return spin_time_windows_can(&b) == SPIN_OK;
}

static void refused(struct spin_export_job *job, struct spin_splats_4d *s, unsigned part,
                    const char *word)
{
    if (spin_splats_4d_reserve(s, 1, 0, 0, part) != SPIN_OK)
        exit(1);
    job->splats_4d = s;
    ok(!can(job) && strstr(spin_last_error(), word), "refused: %s", spin_last_error());
    spin_splats_4d_free(s);
}

/* The clip is from 10 to 14: windows that begin and end outside of it are not cut. */
static void test_cuts(struct spin_export_job *job)
{
    static const struct {
        float first, end;
        bool can;
    } row[] = {{10, 15, true}, {0, 14.5f, true},  {10.5f, 15, false}, {0, 14, false},
               {0, 9, true},   {14.5f, 20, true}, {11, 12, false}};
    struct spin_splats_4d s = {0};
    size_t n_dropped;

    if (spin_splats_4d_reserve(&s, 1, 0, 0, SPIN_4D_CUTS) != SPIN_OK)
        exit(1);
    job->splats_4d = &s;
    s.quats[0] = s.sigmas[0] = 1;
    s.times[0] = 12;
    for (size_t i = 0; i < sizeof row / sizeof row[0]; i++) {
        s.cuts[0] = row[i].first;
        s.cuts[1] = row[i].end;
        if (spin_splats_4d_finish(&s, &n_dropped, NULL) != SPIN_OK || n_dropped > 0)
            exit(1);
        ok(can(job) == row[i].can && (row[i].can || strstr(spin_last_error(), "begin or end")),
           "from %g to %g", (double)row[i].first, (double)row[i].end);
    }
    spin_splats_4d_free(&s);
}

TAP_MAIN
{
    struct spin_splats_4d s = {0};
    struct spin_export_job job = {.splats_4d = &s, .times = times, .n_frames = 5};

    fill(&s);
    ok(can(&job), "windows can be written");
    test_convert(&job);
    spin_splats_4d_free(&s);
    test_shorten(&job);
    test_cuts(&job);
    refused(&job, &s, SPIN_4D_GATES, "do not fade to 0");
    refused(&job, &s, SPIN_4D_PLATEAUS, "keep their full opacity for some time");
    job.n_frames = 1;
    refused(&job, &s, 0, "two or more frames");
}
