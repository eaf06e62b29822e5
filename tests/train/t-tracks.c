/* Which splats are one Gaussian, how frames are put in order, and what a densification makes of them.
 * K: tracks densify */
#include "train/densify_tracks.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "scene/bundle.h"
#include "tests/check.h"
#include "tests/device/strict.h"
#include "tests/tap.h"
#include "train/tracks.h"

enum { FRAMES = 12 };
static int n_frames = 3;
static char path[600];
static struct spin_plan plan;
static size_t counts[FRAMES];
static int frame_of[FRAMES] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11};

/* A bundle of these frames, n[f] places each. */
static void write_clip(const float *const place[FRAMES], const size_t *n, bool identity)
{
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {.columns = SPIN_COL_MEANS, .sh_degree = -1};

    snprintf(meta.from, sizeof meta.from, "test");
    meta.identity = identity;
    meta.n_source_frames = n_frames;
    if (spin_bundle_meta_reserve(&meta, n_frames) != SPIN_OK ||
        spin_bundle_writer_open(path, true, false, &w) != SPIN_OK)
        exit(1);
    for (int f = 0; f < n_frames; f++) {
        struct spin_splats s = {.n = n[f], .means = (float *)place[f]};

        meta.frame[f] = (struct spin_frame_info){.n = n[f], .number = f, .time = f};
        meta.source_index[f] = f;
        if (spin_bundle_write_frame(&w, f, SPIN_COL_MEANS, 0, &s) != SPIN_OK)
            exit(1);
        counts[f] = n[f];
    }
    if (!ok(spin_bundle_writer_finish(&w, &meta, spin_json_object()) == SPIN_OK, "a clip: %s",
            spin_last_error()))
        exit(tap_done());
    spin_bundle_meta_free(&meta);
}

static void find(struct spin_tracks *tracks)
{
    memset(&plan, 0, sizeof plan);
    memset(tracks, 0, sizeof *tracks);
    plan.clip.n_frames = n_frames;
    plan.extent = 1;
    plan.clip.frame = frame_of;
    plan.counts = counts;
    ok(spin_bundle_open(path, &plan.clip.bundle) == SPIN_OK &&
           spin_tracks_find(tracks, &plan, NULL) == SPIN_OK,
       "its tracks: %s", spin_last_error());
    spin_bundle_close(&plan.clip.bundle);
}

/* Rows 0 and 2 never move, row 1 does in the last frame. */
static void check_identity(void)
{
    static const float a[9] = {0, 0, 0, 1, 0, 0, 2, 0, 0}, b[9] = {0, 0, 0, 1, 0, 5, 2, 0, 0};
    const float *const place[FRAMES] = {a, a, b};
    const size_t n[FRAMES] = {3, 3, 3};
    struct spin_tracks t;
    struct spin_frame_size size;
    uint32_t order[3] = {2, 1, 0};

    write_clip(place, n, true);
    find(&t);
    ok(t.identity && t.n == 3 && t.n_moving == 1, "a track a row, one of three moves");
    ok(t.of[0][1] == 0 && t.of[2][1] == 0 && t.of[0][0] == t.of[1][0] && t.of[0][0] > 0 &&
           t.of[0][2] == t.of[2][2],
       "numbers: those that move come first");
    ok(t.place[3 * t.of[0][2]] == 2, "the place of a track that stands still");
    size = spin_tracks_size(&t, 2, 3);
    ok(size.n == 3 && size.n_pos == 1 && size.n_residual == 0, "one splat has a place of its own");
    t.n_varying = 2;
    size = spin_tracks_size(&t, 2, 3);
    ok(size.n_pos == 1 && size.n_residual == 2, "and what varies has residual values");
    ok(spin_tracks_sort(&t, 1, 3, order) == SPIN_OK && order[0] == 1 && t.of[1][order[1]] == 1 &&
           t.of[1][order[2]] == 2,
       "the order of a frame is that of the tracks");
    spin_tracks_close(&t);
    write_clip(place, n, false);
    find(&t);
    ok(!t.identity && t.n == 3 && t.n_moving == 0 && t.of[2][1] == SPIN_NO_TRACK,
       "without identity, what stands still in more than half of the frames");
    spin_tracks_close(&t);
}

/* Places that occur in two of three frames or more, each once a frame. */
static void check_places(void)
{
    static const float a[12] = {0, 0, 0, 1, 1, 1, 7, 7, 7, 1, 1, 1},
                       b[9] = {1, 1, 1, 8, 8, 8, 0, 0, 0}, c[6] = {9, 9, 9, 0, 0, -0.0f};
    const float *const place[FRAMES] = {a, b, c};
    const size_t n[FRAMES] = {4, 3, 2};
    struct spin_tracks t;
    struct spin_frame_size size;

    write_clip(place, n, true); /* not so: the numbers of rows differ */
    find(&t);
    ok(!t.identity && t.n == 2 && t.n_moving == 0, "two places are there in two frames");
    ok(t.of[0][0] == t.of[1][2] && t.of[0][1] == t.of[1][0] && t.of[0][0] != t.of[0][1],
       "and tell which splats are one");
    ok(t.of[0][2] == SPIN_NO_TRACK && t.of[0][3] == SPIN_NO_TRACK && t.of[1][1] == SPIN_NO_TRACK,
       "the others have no track, nor has the second at a place");
    size = spin_tracks_size(&t, 0, 4);
    ok(size.n_pos == 2 && size.n_residual == 2, "these have all of their own");
    ok(t.of[2][0] == SPIN_NO_TRACK && t.of[2][1] == SPIN_NO_TRACK, "-0 is not the same place");
    spin_tracks_close(&t);
}

/* Rows with noise of a hundredth of a unit: alone, on a slow way, of a unit; and a tremble too small to be seen. */
static void check_noise(void)
{
    static const float noise[FRAMES] = {3, -5, 2, 6, -4, 0, -3, 5, 1, -6, -2, 3};
    float at[FRAMES][12];
    const float *place[FRAMES];
    size_t n[FRAMES];
    struct spin_tracks t;
    double mean = 0;

    for (int f = 0; f < FRAMES; f++) {
        memset(at[f], 0, sizeof at[f]);
        at[f][1] = 7 + noise[f] / 1000;
        at[f][3] = noise[f] / 1000 + 0.004f * (float)f;
        at[f][6] = noise[f] / 10;
        at[f][10] = 1e-5f * (float)f;
        mean += (double)at[f][1] / FRAMES;
        place[f] = at[f];
        n[f] = 4;
    }
    n_frames = FRAMES;
    write_clip(place, n, true);
    find(&t);
    ok(t.n == 4 && t.n_moving == 2 && t.of[0][1] < 2 && t.of[0][2] < 2,
       "noise alone does not move a track; a slow way, and noise as large as the scene, do");
    ok(fabs((double)t.place[3 * t.of[0][0] + 1] - mean) < 1e-6,
       "it stands at the mean of its places");
    spin_tracks_close(&t);
    n_frames = 7;
    write_clip(place, n, true);
    find(&t);
    ok(t.n_moving == 3, "seven frames do not tell noise from motion");
    spin_tracks_close(&t);
    n_frames = 3;
}

/* ---- Densification ------------------------------------------------------------------------------- */

/* Two frames, three tracks: two move, and in the first frame there is a splat without a track. */
enum { TRACKS = 3 };
static const uint32_t track_of[2][4] = {{SPIN_NO_TRACK, 0, 1, 2}, {1, 2}};
static const struct spin_frame_size size_of[2] = {{4, 1, 3, 1}, {2, 0, 1, 0}};

static void open_trainer(struct spin_device *d, struct spin_trainer *t)
{
    struct spin_field field = {.sh_degree = 0};
    const struct spin_trainer_size size = {.n_frames = 2,
                                           .frame = size_of,
                                           .n_tracks = TRACKS,
                                           .n_moving = 2,
                                           .max_items = 1,
                                           .max_pixels = 16,
                                           .max_tiles = 1};
    float values[SPIN_TRACK * TRACKS], own[3 * 3], residual[SPIN_RESIDUAL] = {0};

    if (!ok(spin_trainer_open(t, d, &field, &size) == SPIN_OK, "a trainer with tracks"))
        exit(tap_done());
    for (size_t i = 0; i < 3 * TRACKS; i++)
        values[i] = (float)i;
    for (size_t i = 3 * TRACKS; i < SPIN_TRACK * TRACKS; i++)
        values[i] = -3; /* log scales, and opacities of 0.05 */
    d->op->upload(d, t->tracks.p, values, sizeof values);
    for (size_t i = 0; i < SPIN_TRACK * TRACKS; i++)
        values[i] = 0.5f;
    d->op->upload(d, t->tracks.m, values, sizeof values);
    for (int f = 0; f < 2; f++) {
        for (size_t i = 0; i < 9; i++)
            own[i] = (float)(100 * (f + 1)) + (float)i;
        d->op->upload(d, t->frame[f].pos, own, 3 * size_of[f].n_pos * sizeof *own);
        d->op->upload(d, t->frame[f].m, own, 3 * size_of[f].n_pos * sizeof *own);
        d->op->upload(d, t->frame[f].track, track_of[f], size_of[f].n * sizeof **track_of);
    }
    residual[10] = 1;
    d->op->upload(d, t->frame[0].residual, residual, sizeof residual);
}

/* Track 1 and the splat without a track have large gradients, both in the first frame.  */
static void put_gradients(struct spin_device *d, struct spin_trainer *t)
{
    static const float gradient[2][4] = {{1, 0, 1, 0}, {0, 0}};
    static const uint32_t seen[2][4] = {{1, 1, 1, 1}, {1, 1}};

    for (int f = 0; f < 2; f++) {
        d->op->upload(d, t->frame[f].gradient, gradient[f], size_of[f].n * sizeof **gradient);
        d->op->upload(d, t->frame[f].seen, seen[f], size_of[f].n * sizeof **seen);
    }
}

static void check_densify(struct spin_device *d)
{
    struct spin_trainer t;
    struct spin_densify_options o;
    struct spin_densify_change change = {0};
    uint32_t *permutation[2], track[8],
        want[2][6] = {{SPIN_NO_TRACK, SPIN_NO_TRACK, 0, 1, 2, 3}, {1, 2, 3}};
    size_t n[2];
    float pos[3 * 6], m[3 * 6];

    open_trainer(d, &t);
    put_gradients(d, &t);
    for (int f = 0; f < 2; f++) {
        permutation[f] = malloc(8 * sizeof **permutation);
        for (uint32_t i = 0; i < size_of[f].n; i++)
            permutation[f][i] = (uint32_t)size_of[f].n - 1 - i;
    }
    spin_densify_defaults(&o);
    o.extent = 1000;            /* all are small: clones */
    o.gradient_threshold = 0.4; /* track 1 has a mean of 0.5 */
    ok(spin_densify_tracks(&t, &o, 1, permutation, n, &change) == SPIN_OK, "densifies");
    ok(change.clones == 2 && change.splits == 0 && change.pruned == 0,
       "one track and one splat without are cloned");
    ok(t.n_tracks == 4 && t.n_moving == 3 && t.n_varying == 0 && n[0] == 6 && n[1] == 3,
       "the new track has a splat in both frames");
    for (int f = 0; f < 2; f++) {
        ok(d->op->download(d, track, t.frame[f].track, n[f] * sizeof *track) == SPIN_OK, "frame %d",
           f);
        check_same_bits(track, want[f], n[f] * sizeof *track,
                        "without a track, what moves, what does not");
    }
    ok(d->op->download(d, pos, t.frame[0].pos, 15 * sizeof *pos) == SPIN_OK &&
           t.frame[0].size.n_pos == 5 && pos[0] == 100 && pos[3] == 100 && pos[6] == 103 &&
           pos[9] == 106 && pos[12] == 106,
       "a clone begins at its parent's place");
    ok(d->op->download(d, m, t.frame[0].m, 15 * sizeof *m) == SPIN_OK && m[0] == 100 && m[3] == 0 &&
           m[9] == 106 && m[12] == 0,
       "and without moments");
    ok(permutation[1][0] == 1 && permutation[1][2] == 0 && permutation[1][1] == 2 &&
           permutation[0][0] == 3 && permutation[0][1] >= 4 && permutation[0][4] >= 4,
       "what was there keeps its order in the output, new splats follow");
    ok(t.frame[0].size.n_residual == 2 && t.frame[1].size.n_residual == 0,
       "splats without a track keep values of their own");
    for (int f = 0; f < 2; f++)
        free(permutation[f]);
    spin_trainer_close(&t);
}

TAP_MAIN
{
    struct spin_device *d;

    snprintf(path, sizeof path, "%s/clip.spin", check_folder());
    check_identity();
    check_places();
    check_noise();
    d = check_device(2);
    check_densify(d);
    check_device_free(d);
    d = strict_open(check_device(1), 1, 1);
    check_densify(d);
    ok(strict_complaints() == 0, "no complaint of the strict device");
    strict_close(d);
}
