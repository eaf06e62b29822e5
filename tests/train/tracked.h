/* A trainer with tracks, every value and moment of which identifies its owner. */
#ifndef SPIN_TESTS_TRAIN_TRACKED_H
#define SPIN_TESTS_TRAIN_TRACKED_H

#include "tests/check.h"
#include "tests/tap.h"
#include "base/mem.h"
#include "train/checkpoint.h"
#include "train/densify.h"

/* Four tracks: 0 and 1 are dynamic, 2 is static and varying, 3 is neither. Frame 0 has two
 * splats without a track and lacks track 1, frame 1 has one and lacks track 0. */
enum { TRACKED = 4, TRACKED_FRAMES = 2, TRACKED_MOST = 16 };
static const uint32_t tracked_of[2][5] = {{SPIN_NO_TRACK, SPIN_NO_TRACK, 0, 2, 3},
                                          {SPIN_NO_TRACK, 1, 2, 3}};
static const struct spin_frame_size tracked_size[2] = {{5, 2, 3, 4}, {4, 1, 2, 3}};

/* Column c (0 to 13) of part 0 to 2 (value, moments) of a track, or of row `of` of a frame.
 * Scales of about a twentieth, opacities of a half, identity rotations. */
static float tracked_value(int part, int frame, int of, int c)
{
    static const float base[14] = {0, 1, 2, -3, -3, -3, 1, 0, 0, 0, 0.1f, 0.2f, 0.3f, 0};
    float own = (float)(16 * (frame + 1) + of) / 1024;

    return part > 0 ? (float)(10 * part + c) + own : base[c] + (c < 6 || c > 9 ? own : 0);
}

/* The offset of column c of row i: groups of 3, 3, 4, 3 columns and of one, n rows each. */
static size_t tracked_at(size_t n, size_t i, int c)
{
    return c < 3    ? 3 * i + (size_t)c
           : c < 6  ? 3 * n + 3 * i + (size_t)(c - 3)
           : c < 10 ? 6 * n + 4 * i + (size_t)(c - 6)
           : c < 13 ? 10 * n + 3 * i + (size_t)(c - 10)
                    : 13 * n + i;
}

/* A trainer of that size, all zero; with a network or NULL. */
static void tracked_open(struct spin_device *d, const struct spin_frame_size *frame, size_t n,
                         size_t n_moving, size_t n_varying, const struct spin_field *network,
                         struct spin_trainer *t)
{
    static const struct spin_field none;
    const struct spin_trainer_size size = {.n_frames = TRACKED_FRAMES,
                                           .frame = frame,
                                           .tracked = true,
                                           .n_tracks = n,
                                           .n_moving = n_moving,
                                           .n_varying = n_varying,
                                           .network = network != NULL,
                                           .max_items = 1,
                                           .max_pixels = 16,
                                           .max_tiles = 1};

    if (spin_trainer_open(t, d, network ? network : &none, &size) != SPIN_OK) {
        ok(0, "a trainer with tracks: %s", spin_last_error());
        exit(tap_done());
    }
}

static float SPIN_DEV *tracked_part(const struct spin_train_frame *f, int part, bool residual)
{
    float SPIN_DEV *pos[] = {f->pos, f->m, f->v},
                   *own[] = {f->residual, f->residual_m, f->residual_v};

    return residual ? own[part] : pos[part];
}

/* Values, times and step counts. second: the opacity logit of frame 0's second splat without a
 * track. */
static void tracked_fill(struct spin_device *d, struct spin_trainer *t, float second)
{
    float SPIN_DEV *track[] = {t->tracks.p, t->tracks.m, t->tracks.v};
    float host[14 * TRACKED_MOST];

    for (int part = 0; part < 3; part++) {
        for (int i = 0; i < TRACKED; i++)
            for (int c = 0; c < 14; c++)
                host[tracked_at(TRACKED, (size_t)i, c)] = tracked_value(part, -1, i, c);
        d->op->upload(d, track[part], host, sizeof *host * 14 * TRACKED);
        for (int f = 0; f < TRACKED_FRAMES; f++) {
            size_t n_pos = tracked_size[f].n_pos, n = tracked_size[f].n_residual;

            for (size_t i = 0; i < n_pos; i++)
                for (int c = 0; c < 3; c++)
                    host[tracked_at(n_pos, i, c)] = tracked_value(part, f, (int)i, c);
            d->op->upload(d, tracked_part(&t->frame[f], part, false), host,
                          sizeof *host * 3 * n_pos);
            for (size_t i = 0; i < n; i++)
                for (int c = 3; c < 14; c++)
                    host[tracked_at(n, i, c) - 3 * n] = tracked_value(part, f, (int)i, c);
            if (part == 0 && f == 0)
                host[tracked_at(n, 1, 13) - 3 * n] = second;
            d->op->upload(d, tracked_part(&t->frame[f], part, true), host, sizeof *host * 11 * n);
        }
    }
    for (int f = 0; f < TRACKED_FRAMES; f++) {
        d->op->upload(d, t->frame[f].track, tracked_of[f], tracked_size[f].n * sizeof **tracked_of);
        for (size_t i = 0; i < 4 * tracked_size[f].n_pos; i++)
            host[i] = (float)(100 * f) + (float)i;
        d->op->upload(d, t->frame[f].turn, host, sizeof *host * 4 * tracked_size[f].n_pos);
        t->frame[f].time = 0.5 + f;
        t->frame[f].steps = 40 + f;
    }
}

/* Statistics of the splats. */
__attribute__((unused)) static void tracked_see(struct spin_device *d, struct spin_trainer *t,
                                                const float gradient[2][5],
                                                const uint32_t seen[2][5])
{
    for (int f = 0; f < TRACKED_FRAMES; f++) {
        d->op->upload(d, t->frame[f].gradient, gradient[f], tracked_size[f].n * sizeof **gradient);
        d->op->upload(d, t->frame[f].seen, seen[f], tracked_size[f].n * sizeof **seen);
    }
}

__attribute__((unused)) static void tracked_places(uint32_t *permutation[2])
{
    for (int f = 0; f < TRACKED_FRAMES; f++) {
        if (spin_pages_reserve(TRACKED_MOST * sizeof **permutation, (void **)&permutation[f]) !=
            SPIN_OK)
            exit(1);
        for (uint32_t i = 0; i < tracked_size[f].n; i++)
            permutation[f][i] = (i + 2) % (uint32_t)tracked_size[f].n;
    }
}

#endif
