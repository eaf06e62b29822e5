/* Shared by the exporters' tests: a frame of plausible splats, and one run of an exporter. */
#ifndef SPIN_TESTS_EXPORTERS_FRAME_H
#define SPIN_TESTS_EXPORTERS_FRAME_H

#include "tests/check.h"
#include "tests/tap.h"

/* Files that an exporter writes beside the frames and sequence.json: half of them sort before
 * the frames, half after. */
__attribute__((unused)) static size_t n_more;

/* One row with the meaning of the bundle. */
struct want {
    double place[3], log_scale[3], q[4], opacity, dc[3];
};

__attribute__((unused)) static const char *in_folder(const char *name)
{
    static const char *folder;
    static char path[8][4096];
    static int next;
    char *p = path[next++ % 8];

    if (!folder)
        folder = check_folder();
    snprintf(p, sizeof path[0], "%s/%s", folder, name);
    return p;
}

/* In [low, high], the same on every machine. */
__attribute__((unused)) static float draw(uint32_t *seed, float low, float high)
{
    *seed = *seed * 1664525u + 1013904223u;
    return low + (high - low) * (float)(*seed >> 8) / 16777216.0f;
}

/* n splats with colours inside 0..1, so that every format can hold them. */
__attribute__((unused)) static void make_frame(struct spin_splats *s, size_t n, int degree,
                                               uint32_t seed)
{
    size_t n_sh = 3 * (size_t)((degree + 1) * (degree + 1));

    if (spin_splats_reserve(s, n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, degree) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++) {
        double norm = 0;

        for (size_t k = 0; k < 3; k++) {
            s->means[3 * i + k] = draw(&seed, -4, 4);
            s->log_scales[3 * i + k] = draw(&seed, -7, 0);
        }
        for (size_t k = 0; k < 4; k++) {
            s->quats[4 * i + k] = draw(&seed, -1, 1);
            norm += (double)s->quats[4 * i + k] * s->quats[4 * i + k];
        }
        for (size_t k = 0; k < 4; k++)
            s->quats[4 * i + k] = (float)(s->quats[4 * i + k] / sqrt(norm));
        s->logit_opacities[i] = draw(&seed, -5, 5);
        for (size_t k = 0; k < n_sh; k++)
            s->sh[n_sh * i + k] = k < 3 ? draw(&seed, -1.7f, 1.7f) : draw(&seed, -0.9f, 0.9f);
    }
}

__attribute__((unused)) static struct want want_of(const struct spin_splats *s, size_t i)
{
    size_t n_sh = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
    struct want w;
    double norm = 0, sign = s->quats[4 * i] < 0 ? -1 : 1;

    for (size_t k = 0; k < 4; k++)
        norm += (double)s->quats[4 * i + k] * s->quats[4 * i + k];
    for (size_t k = 0; k < 4; k++)
        w.q[k] = sign * s->quats[4 * i + k] / sqrt(norm);
    for (size_t k = 0; k < 3; k++) {
        w.place[k] = s->means[3 * i + k];
        w.log_scale[k] = s->log_scales[3 * i + k];
        w.dc[k] = s->sh[n_sh * i + k];
    }
    w.opacity = 1 / (1 + exp(-(double)s->logit_opacities[i]));
    return w;
}

/* Degrees between two unit quaternions, q and -q being one. */
__attribute__((unused)) static double degrees_between(const double a[4], const double b[4])
{
    double plus = 0, minus = 0;

    for (int k = 0; k < 4; k++) {
        plus += (a[k] + b[k]) * (a[k] + b[k]);
        minus += (a[k] - b[k]) * (a[k] - b[k]);
    }
    return 4 * asin(fmin(sqrt(fmin(plus, minus)) / 2, 1)) * 57.29577951308232;
}

__attribute__((unused)) static spin_status run(const struct spin_exporter *exporter,
                                               const struct spin_export_job *job,
                                               const struct spin_splats *s, int number)
{
    struct spin_frame_info info = {.number = number, .time = 0.5 * number, .n = s->n};
    void *self = NULL;
    spin_status status = exporter->begin(job, &self);

    if (status != SPIN_OK)
        return status;
    status = exporter->frame(self, 0, &info, s);
    if (status == SPIN_OK)
        return exporter->end(self);
    exporter->abort(self);
    return status;
}

/* The guarantees of every exporter that writes to a folder. bad: pairs of an option and a value
 * that must be refused. */
__attribute__((unused)) static void check_folder_rules(const struct spin_exporter *exporter,
                                                       const char *file, const char *const bad[][2],
                                                       size_t n_bad)
{
    struct spin_export_job job = {.output = in_folder("never"), .n_frames = 1};
    struct spin_splats s = {0};
    char path[512], **names = NULL;
    void *self = NULL;
    size_t n = 0;

    for (size_t i = 0; i < n_bad; i++) {
        const char *pairs[] = {bad[i][0], bad[i][1], NULL};
        struct spin_plugin_values values = {pairs};

        job.values = &values;
        ok(exporter->begin(&job, &self) == SPIN_E_USAGE && !self &&
               strstr(spin_last_error(), bad[i][0]),
           "refuses --%s '%s'", bad[i][0], bad[i][1]);
    }
    job.values = NULL;
    ok(!spin_path_exists(in_folder("never")), "and makes no folder");
    make_frame(&s, 9, 0, 1);
    job.output = in_folder("twice");
    ok(run(exporter, &job, &s, 1) == SPIN_OK, "makes its folder");
    ok(run(exporter, &job, &s, 1) == SPIN_E_IO && strstr(spin_last_error(), "--force"),
       "refuses a folder with files, and names --force");
    job.force = true;
    ok(run(exporter, &job, &s, 1) == SPIN_OK, "overwrites when told to");
    ok(spin_folder_list(job.output, &names, &n) == SPIN_OK && n == 2 + n_more &&
           strcmp(names[n_more / 2], file) == 0 && strcmp(names[n - 1], "sequence.json") == 0,
       "leaves %s and sequence.json", file);
    spin_folder_list_free(names);
    job.output = in_folder("broken");
    snprintf(path, sizeof path, "broken/%s", file);
    ok(spin_folder_make(in_folder(path)) == SPIN_OK && run(exporter, &job, &s, 1) != SPIN_OK &&
           spin_folder_list(job.output, &names, &n) == SPIN_OK && n == 1,
       "a file that cannot be written leaves nothing half-written");
    spin_folder_list_free(names);
    job.output = in_folder("aborted");
    ok(exporter->begin(&job, &self) == SPIN_OK && spin_path_is_folder(job.output),
       "begins with a folder");
    exporter->abort(self);
    ok(!spin_path_exists(in_folder("aborted")), "an abort takes it away");
    spin_splats_free(&s);
}

#endif
