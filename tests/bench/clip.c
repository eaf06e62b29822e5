/* clip FOLDER FRAMES SPLATS DEGREE [MOVING]: a clip of PLY frames for measuring, the same on every
 * machine.
 *
 * The splats lie on eight balls, of which MOVING (8 by default) drift, back and forth within 100
 * frames; scales, opacities and SH spread as those of trained
 * scenes do (SH falls off with its degree and most of it is near zero), as what packs well depends
 * on it. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "math/rng.h"
#include "spin.h"

extern const struct spin_exporter spin_exporter_ply;

/* The next draw of a frame; every frame draws the same. */
static float normal(uint64_t *at) { return spin_rng_normal(7, 0, (*at)++); }

/* Of the double exponential, as SH coefficients of trained scenes are. */
static float peaked(uint64_t *at)
{
    float u = spin_rng_uniform(7, 1, (*at)++) - 0.5f;

    return copysignf(logf(1 - 1.9999f * fabsf(u)), u);
}

/* Drift of a ball along each axis: it turns round after 50 frames, so that a long clip stays as
 * large as a short one. */
static float drift(int frame) { return 0.01f * (float)abs((frame + 50) % 100 - 50); }

static void fill_splat(struct spin_splats *s, size_t i, float offset, uint64_t *at)
{
    size_t n_sh = (size_t)((s->sh_degree + 1) * (s->sh_degree + 1)), ball = i % 8;
    float direction[3], length = 0, *q = s->quats + 4 * i, transform = 0, tone = normal(at);

    for (int c = 0; c < 3; c++) {
        direction[c] = normal(at);
        length += direction[c] * direction[c];
    }
    length = 1 / sqrtf(length + 1e-12f);
    for (int c = 0; c < 3; c++) {
        float centre = 3 * sinf((float)(ball * 3 + (size_t)c) * 1.7f) + offset;

        s->means[3 * i + (size_t)c] = centre + direction[c] * length * (1 + 0.02f * normal(at));
        s->log_scales[3 * i + (size_t)c] = -5.2f + 0.8f * normal(at);
    }
    for (int k = 0; k < 4; k++) {
        q[k] = normal(at);
        transform += q[k] * q[k];
    }
    for (int k = 0; k < 4; k++)
        q[k] /= sqrtf(transform + 1e-12f);
    s->logit_opacities[i] = 1 + 3 * normal(at);
    for (size_t k = 0; k < n_sh; k++) {
        for (size_t c = 0; c < 3; c++)
            s->sh[(i * n_sh + k) * 3 + c] = k == 0 ? 0.8f * tone + 0.3f * normal(at)
                                                   : (k < 4   ? 0.06f
                                                      : k < 9 ? 0.045f
                                                              : 0.03f) *
                                                         peaked(at);
    }
}

static int fail(void)
{
    fprintf(stderr, "clip: %s\n", spin_last_error());
    return 1;
}

int main(int argc, char **argv)
{
    bool complete = argc == 5 || argc == 6;
    int n_frames = complete ? atoi(argv[2]) : 0, degree = complete ? atoi(argv[4]) : 0,
        n_moving = argc == 6 ? atoi(argv[5]) : 8;
    size_t n = complete ? (size_t)atol(argv[3]) : 0;
    struct spin_splats s = {0};
    void *self = NULL;

    if (n_frames < 1 || n < 1 || degree < 0 || degree > 3 || n_moving < 0) {
        fprintf(stderr, "usage: clip FOLDER FRAMES SPLATS DEGREE [MOVING]\n");
        return 2;
    }
    struct spin_export_job job = {
        .output = argv[1], .force = true, .n_frames = n_frames, .sh_degree = degree};
    if (spin_splats_reserve(&s, n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, degree) != SPIN_OK ||
        spin_exporter_ply.begin(&job, &self) != SPIN_OK)
        return fail();
    for (int f = 0; f < n_frames; f++) {
        struct spin_frame_info info = {.number = f, .time = f, .n = n};
        uint64_t at = 0;

        for (size_t i = 0; i < n; i++)
            fill_splat(&s, i, i % 8 < (size_t)n_moving ? drift(f) : 0, &at);
        if (spin_exporter_ply.frame(self, f, &info, &s) != SPIN_OK)
            return fail();
    }
    return spin_exporter_ply.end(self) == SPIN_OK ? 0 : fail();
}
