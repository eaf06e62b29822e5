/* Which splats form a track, the order of frames, and the densification of tracks.
 * K: tracks densify */

#include "tests/device/strict.h"
#include "tests/train/tracked.h"
#include "train/tracks.h"

enum { FRAMES = 12 };
static int n_frames = 3;
static char path[600];
static struct spin_plan plan;
static const struct spin_retrain_options options = {.n_threads = 2};
static size_t counts[FRAMES];
static const float *colours; /* [n][3] of every frame's splats, or NULL */
static int frame_of[FRAMES] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11};

/* A bundle of these frames, with n[f] positions each. */
static void write_clip(const float *const place[FRAMES], const size_t *n, bool identity)
{
    struct spin_bundle_writer w;
    unsigned columns = SPIN_COL_MEANS | (colours ? SPIN_COL_RGB : 0);
    struct spin_bundle_meta meta = {.columns = columns, .sh_degree = -1};

    snprintf(meta.from, sizeof meta.from, "test");
    meta.identity = identity;
    meta.n_source_frames = n_frames;
    if (spin_bundle_meta_reserve(&meta, n_frames) != SPIN_OK ||
        spin_bundle_writer_open(path, true, false, &w) != SPIN_OK)
        exit(1);
    for (int f = 0; f < n_frames; f++) {
        struct spin_splats s = {.n = n[f], .means = (float *)place[f], .rgb = (float *)colours};

        meta.frame[f] = (struct spin_frame_info){.n = n[f], .number = f, .time = f};
        meta.source_index[f] = f;
        if (spin_bundle_write_frame(&w, f, columns, 0, &s) != SPIN_OK)
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
    plan.o = &options;
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

/* Positions that occur in at least two of three frames, each once a frame. */
static void check_places(void)
{
    static const float a[12] = {0, 0, 0, 1, 1, 1, 7, 7, 7, 1, 1, 1},
                       b[9] = {1, 1, 1, 8, 8, 8, 0, 0, 0}, c[6] = {9, 9, 9, 0, 0, -0.0f};
    const float *const place[FRAMES] = {a, b, c};
    static const float unlike[12] = {0, 0, 0, 0.3f, 0, 0, 0.6f, 0, 0, 0.9f, 0, 0};
    const size_t n[FRAMES] = {4, 3, 2};
    struct spin_tracks t;
    struct spin_frame_size size;

    colours = unlike;           /* no row is matched with another */
    write_clip(place, n, true); /* it is not, since the numbers of rows differ */
    find(&t);
    colours = NULL;
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

/* A position in two of four frames, beside one in all. */
static void check_half(void)
{
    static const float a[6] = {0, 0, 0, 1, 1, 1}, b[6] = {0, 0, 0, 2, 2, 2},
                       c[6] = {0, 0, 0, 3, 3, 3};
    const float *const place[FRAMES] = {a, a, b, c};
    const size_t n[FRAMES] = {2, 2, 2, 2};
    struct spin_tracks t;

    n_frames = 4;
    write_clip(place, n, false);
    find(&t);
    ok(t.n == 1 && t.of[0][1] == SPIN_NO_TRACK, "half of the frames are not enough");
    spin_tracks_close(&t);
    n_frames = 3;
}

/* A row of accelerating splats, in another order in each frame. */
static void check_chains(void)
{
    enum { N = 20 };
    static const float step[4] = {0, 0.45f, 1, 1.6f};
    static float at[4][3 * N];
    const float *const place[FRAMES] = {at[0], at[1], at[2], at[3]};
    const size_t n[FRAMES] = {N, N, N, N};
    struct spin_tracks t;
    struct spin_frame_size size;
    int right = 0;

    for (int f = 0; f < 4; f++)
        for (int i = 0; i < N; i++)
            at[f][3 * ((i + 7 * f) % N)] = (float)i + step[f];
    n_frames = 4;
    write_clip(place, n, false);
    find(&t);
    for (int i = 0; i < N; i++)
        for (int f = 1; f < 4; f++)
            right += t.of[f][(i + 7 * f) % N] == t.of[0][i] && t.of[0][i] < t.n_moving;
    ok(!t.identity && t.n == N && t.n_moving == N && right == 3 * N,
       "splats that go on are linked, though each stands nearer to where another was: %d", right);
    size = spin_tracks_size(&t, 1, N);
    ok(size.n_free == 0 && size.n_pos == N && size.n_residual == 0,
       "each has a place of its own in each frame");
    spin_tracks_close(&t);
}

/* Six splats, two of them with another colour than their neighbours; they move by half a step. */
static void check_chains_by_colour(void)
{
    static const float a[18] = {0, 0, 0, 1, 0, 0, 2, 0, 0, 3, 0, 0, 4, 0, 0, 5, 0, 0},
                       rgb[18] = {0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0.05f, 0, 0, 0.5f, 0, 0, 0};
    static float b[18];
    const float *const place[FRAMES] = {a, b, b};
    const size_t n[FRAMES] = {6, 6, 0};
    struct spin_tracks t;
    bool right = true;

    for (int i = 0; i < 6; i++)
        b[3 * i] = a[3 * i] + 0.8f; /* nearer to the previous position of its neighbour */
    colours = rgb;
    write_clip(place, n, false);
    find(&t);
    right = t.of[0][1] != SPIN_NO_TRACK && t.of[0][1] == t.of[1][1] &&
            t.of[0][4] != SPIN_NO_TRACK && t.of[0][4] == t.of[1][4];
    ok(right, "splats of another colour are linked to their like");
    spin_tracks_close(&t);
    colours = NULL;
}

/* Rows with noise of a hundredth of a unit: by itself, on a slow path of a unit, and jitter too
 * small to be visible. */
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

/* ---- Densification
 * ------------------------------------------------------------------------------- */

/* Two frames, three tracks: two move, and in the first frame there is a splat without a track. */
enum { TRACKS = 3 };
static const uint32_t track_of[2][4] = {{SPIN_NO_TRACK, 0, 1, 2}, {1, 2}};
static const struct spin_frame_size size_of[2] = {{4, 1, 3, 1}, {2, 0, 1, 0}};

static void open_trainer(struct spin_device *d, struct spin_trainer *t)
{
    struct spin_field field = {.sh_degree = 0};
    const struct spin_trainer_size size = {.n_frames = 2,
                                           .frame = size_of,
                                           .tracked = true,
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
        if (spin_pages_reserve(8 * sizeof **permutation, (void **)&permutation[f]) != SPIN_OK)
            exit(1);
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
        spin_pages_release(permutation[f]);
    spin_trainer_close(&t);
}

/* ---- State kept by densification */

/* Old tracks and the rows of new ones; a negative number: -1 - row, new and therefore without
 * moments. */
static const int track_from[5] = {0, 1, 2, -3, 3}, n_row[2] = {5, 5},
                 row_from[2][5] = {{0, 2, 3, -4, 4}, {0, 1, 2, -3, 3}};

static int wrong_values(const float *got, size_t n, int part, int frame, const int *from, int first,
                        int end)
{
    int wrong = 0;

    for (size_t i = 0; i < n; i++)
        for (int c = first; c < end; c++) {
            float want = from[i] >= 0 ? tracked_value(part, frame, from[i], c)
                         : part > 0   ? 0
                                      : tracked_value(0, frame, -from[i] - 1, c);

            wrong += got[tracked_at(n, i, c) - (size_t)(first ? 3 * n : 0)] != want;
        }
    return wrong;
}

/* The mean gradient of track 2 is exactly 3/8, that of track 3 is smaller and visible mostly
 * where it is smallest; the second splat without a track is almost transparent. */
static void check_carried(struct spin_device *d)
{
    static const float gradient[2][5] = {{0, 0, 0.1f, 0.5f, 0.9f}, {0, 0.18f, 0.25f, 0.3f}};
    static const uint32_t seen[2][5] = {{1, 1, 1, 1, 1}, {1, 1, 1, 3}};
    struct spin_trainer t;
    struct spin_densify_options o;
    struct spin_densify_change change = {0};
    uint32_t *place[2];
    size_t n[2];
    float got[14 * TRACKED_MOST];
    int wrong = 0;

    tracked_open(d, tracked_size, TRACKED, 2, 3, NULL, &t);
    tracked_fill(d, &t, -9);
    tracked_see(d, &t, gradient, seen);
    tracked_places(place);
    spin_densify_defaults(&o);
    o.extent = 1000;
    o.gradient_threshold = 0.375;
    if (spin_densify_tracks(&t, &o, 1, place, n, &change) != SPIN_OK)
        exit(1);
    ok(change.clones == 1 && change.splits == 0 && change.pruned == 1,
       "a mean gradient at the threshold is enough, one over two frames is of both: %zu clones",
       change.clones);
    ok(t.n_tracks == 5 && t.n_moving == 2 && t.n_varying == 4,
       "the new track varies, as its parent does");
    for (int part = 0; part < 3; part++) {
        float SPIN_DEV *at[] = {t.tracks.p, t.tracks.m, t.tracks.v};

        wrong += d->op->download(d, got, at[part], sizeof *got * 14 * 5) != SPIN_OK;
        wrong += wrong_values(got, 5, part, -1, track_from, 0, 14);
    }
    ok(wrong == 0, "tracks keep values and both moments; a new one has its parent's values");
    for (int f = 0; f < 2; f++) {
        const struct spin_train_frame *frame = &t.frame[f];

        wrong = 0;
        ok(n[f] == (size_t)n_row[f] && frame->size.n == n[f] && frame->size.n_free == 1 &&
               frame->size.n_pos == 2 && frame->size.n_residual == 4,
           "frame %d: %zu splats", f, n[f]);
        for (int part = 0; part < 3; part++) {
            wrong += d->op->download(d, got, tracked_part(frame, part, false),
                                     sizeof *got * 3 * 2) != SPIN_OK;
            wrong += wrong_values(got, 2, part, f, row_from[f], 0, 3);
            wrong += d->op->download(d, got, tracked_part(frame, part, true),
                                     sizeof *got * 11 * 4) != SPIN_OK;
            wrong += wrong_values(got, 4, part, f, row_from[f], 3, 14);
        }
        ok(wrong == 0, "its splats keep theirs");
        ok(d->op->download(d, got, frame->turn, sizeof *got * 4 * 2) == SPIN_OK && got[0] == 1 &&
               got[1] == 0 && got[4] == (float)(100 * f + 4 * row_from[f][1]) &&
               got[7] == got[4] + 3,
           "and their turn; without a track there is none");
        ok(frame->time == 0.5 + f && frame->steps == 40 + f, "it keeps its time and its steps");
        spin_pages_release(place[f]);
    }
    spin_trainer_close(&t);
}

/* Everything is large and split: the positions of the children, of tracks and of the splats
 * without one in frame 0. */
static void split_all(struct spin_device *d, uint64_t seed, int iteration, float *of_tracks,
                      float *of_free)
{
    static const float gradient[2][5] = {{1, 1, 1, 1, 1}, {1, 1, 1, 1}};
    static const uint32_t seen[2][5] = {{1, 1, 1, 1, 1}, {1, 1, 1, 1}};
    struct spin_trainer t;
    struct spin_densify_options o;
    struct spin_densify_change change = {0};
    uint32_t *place[2];
    size_t n[2];

    tracked_open(d, tracked_size, TRACKED, 2, 3, NULL, &t);
    tracked_fill(d, &t, 0);
    tracked_see(d, &t, gradient, seen);
    tracked_places(place);
    spin_densify_defaults(&o);
    o.extent = 1e-6;
    o.seed = seed;
    if (spin_densify_tracks(&t, &o, iteration, place, n, &change) != SPIN_OK ||
        change.splits != 7 ||
        d->op->download(d, of_tracks, t.tracks.p, sizeof *of_tracks * 6) != SPIN_OK ||
        d->op->download(d, of_free, t.frame[0].pos, sizeof *of_free * 6) != SPIN_OK)
        exit(1);
    for (int i = 0; i < 2; i++) /* first children: less where their parents were, of a unit */
        for (int c = 0; c < 3; c++) {
            of_tracks[3 * i + c] = (of_tracks[3 * i + c] - tracked_value(0, -1, i, c)) /
                                   expf(tracked_value(0, -1, i, 3 + c));
            of_free[3 * i + c] = (of_free[3 * i + c] - tracked_value(0, 0, i, c)) /
                                 expf(tracked_value(0, 0, i, 3 + c));
        }
    for (int f = 0; f < 2; f++)
        spin_pages_release(place[f]);
    spin_trainer_close(&t);
}

static double farthest(const float *a, const float *b, int n)
{
    double most = 0;

    for (int i = 0; i < n; i++)
        most = larger(most, fabs((double)a[i] - (double)b[i]));
    return most;
}

static void check_numbers_drawn(struct spin_device *d)
{
    float track[4][6], own[4][6];

    split_all(d, 5, 3, track[0], own[0]);
    split_all(d, 5, 3, track[1], own[1]);
    split_all(d, 6, 3, track[2], own[2]);
    split_all(d, 5, 4, track[3], own[3]);
    check_same_bits(track[1], track[0], sizeof track[0],
                    "one seed, one iteration: the same children of tracks");
    check_same_bits(own[1], own[0], sizeof own[0], "and of splats without");
    ok(farthest(track[2], track[0], 6) > 0.1 && farthest(own[2], own[0], 6) > 0.1,
       "another seed: others");
    ok(farthest(track[3], track[0], 6) > 0.1 && farthest(own[3], own[0], 6) > 0.1,
       "another iteration: others");
    ok(farthest(track[0], own[0], 3) > 0.1, "tracks and splats without do not share their numbers");
}

/* No frame exceeds its splat budget, tracks and splats without tracks together; tracks have
 * priority. */
static void check_most(struct spin_device *d)
{
    static const float gradient[2][5] = {{3, 3, 1, 1, 1}, {2, 1, 1, 1}};
    static const uint32_t seen[2][5] = {{1, 1, 1, 1, 1}, {1, 1, 1, 1}};
    static const size_t tracks[10] = {8, 4, 4, 4, 4, 4, 4, 5, 6, 7},
                        splats[10][2] = {{10, 8}, {5, 4}, {5, 4}, {5, 4},
                                         {5, 4},  {5, 5}, {6, 5}, {0}};

    for (size_t most = 0; most < 10; most++) {
        struct spin_trainer t;
        struct spin_densify_options o;
        struct spin_densify_change change = {0};
        uint32_t *place[2];
        size_t n[2];

        tracked_open(d, tracked_size, TRACKED, 2, 3, NULL, &t);
        tracked_fill(d, &t, 0);
        tracked_see(d, &t, gradient, seen);
        tracked_places(place);
        spin_densify_defaults(&o);
        o.extent = 1000;
        o.max_points = most;
        if (spin_densify_tracks(&t, &o, 1, place, n, &change) != SPIN_OK)
            exit(1);
        ok(t.n_tracks == tracks[most] &&
               (most > 6 ? n[0] <= most && n[1] <= most
                         : n[0] == splats[most][0] && n[1] == splats[most][1]),
           "at most %zu splats: %zu tracks, %zu and %zu splats", most, t.n_tracks, n[0], n[1]);
        spin_pages_release(place[0]), spin_pages_release(place[1]);
        spin_trainer_close(&t);
    }
}

/* If the last track is pruned, no gradient of its splats remains for iterations without tracks. */
static void check_last(struct spin_device *d)
{
    struct spin_trainer t;
    struct spin_densify_options o;
    struct spin_densify_change change = {0};
    uint32_t *place[2];
    size_t n[2], left = 0;
    float host[SPIN_RESIDUAL * 5];

    tracked_open(d, tracked_size, TRACKED, 2, 3, NULL, &t);
    tracked_fill(d, &t, 0);
    tracked_places(place);
    for (size_t i = 0; i < SPIN_RESIDUAL * 5; i++)
        host[i] = 1;
    d->op->upload(d, t.d_residual, host, sizeof host);
    spin_densify_defaults(&o);
    o.extent = 1000;
    o.prune_opacity = 0.9;
    ok(spin_densify_tracks(&t, &o, 1, place, n, &change) == SPIN_OK && t.n_tracks == 0 &&
           d->op->download(d, host, t.d_residual, sizeof host) == SPIN_OK,
       "no track is left");
    for (size_t i = 0; i < SPIN_RESIDUAL * 5; i++)
        left += host[i] != 0;
    ok(left == 0, "and no gradient");
    spin_pages_release(place[0]), spin_pages_release(place[1]);
    spin_trainer_close(&t);
}

/* A step changes each number by about its rate. Dynamic tracks use half of the rate for their
 * displacement, and continue after static tracks have stopped. */
static void check_rates(struct spin_device *d)
{
    static const struct spin_camera camera = {
        4, 4, 4, 4, 2, 2, {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}, 0};
    const struct spin_train_item item = {.frame = 0, .camera = &camera};
    const double rate = 1e-3;
    struct spin_image_store photos;
    struct spin_train_values seen = {0};
    struct spin_trainer t;
    float values[SPIN_TRACK * TRACKS], now[SPIN_TRACK * TRACKS], own[9], white[48];

    open_trainer(d, &t);
    for (int i = 0; i < 48; i++)
        white[i] = 1;
    for (int i = 0; i < 9; i++)
        own[i] = i % 3 == 2 ? 2 : 0.3f;
    for (int i = 0; i < SPIN_TRACK * TRACKS; i++)
        values[i] = i >= 3 * TRACKS ? -1 : i >= 6 ? own[i - 6] : 0;
    d->op->upload(d, t.tracks.p, values, sizeof values);
    d->op->zero(d, t.tracks.m, sizeof values);
    d->op->upload(d, t.frame[0].pos, own, 3 * size_of[0].n_pos * sizeof *own);
    t.lambda_dssim = 0.2f;
    t.rates = (struct spin_train_rates){.position = rate,
                                        .displacement = rate,
                                        .track = {rate, rate, rate, rate},
                                        .tracked = 1,
                                        .iterations = 1000,
                                        .track_iterations = 1000};
    if (!ok(spin_image_store_open(&photos, d, 1, 16, SPIN_IMAGE_F32, false) == SPIN_OK, "a photo"))
        exit(tap_done());
    spin_image_store_put(&photos, 0, 16, white, NULL);
    for (int step = 1; step <= 2; step++) {
        ok(spin_trainer_step(&t, &photos.images, &item, 1, &seen) == SPIN_OK &&
               d->op->download(d, now, t.tracks.p, sizeof now) == SPIN_OK,
           "step %d", step);
        for (int track = 0; track < TRACKS; track++) {
            double moved = fabs((double)now[3 * track] - (double)values[3 * track]) / rate;
            double faded = fabs((double)now[9 + 3 * track] - (double)values[9 + 3 * track]) / rate;

            if (step == 1) {
                near(moved, track == 2 ? 1 : 0.5, 0.02, "the displacement of a track");
                near(faded, 1, 0.02, "and its scale");
            } else
                ok(track == 2 ? moved == 0 && faded == 0 : moved > 0.1 && faded > 0.1,
                   "then: %.2f and %.2f of the rate", moved, faded);
        }
        memcpy(values, now, sizeof now);
        t.rates.track_iterations = 1;
    }
    spin_image_store_close(&photos);
    spin_trainer_close(&t);
}

TAP_MAIN
{
    struct spin_device *d;

    snprintf(path, sizeof path, "%s/clip.spin", check_folder());
    check_identity();
    check_places();
    check_half();
    check_chains();
    n_frames = 3;
    check_chains_by_colour();
    check_noise();
    d = check_device(2);
    check_densify(d);
    check_carried(d);
    check_numbers_drawn(d);
    check_most(d);
    check_last(d);
    check_rates(d);
    check_device_free(d);
    d = strict_open(check_device(1), 1, 1);
    check_densify(d);
    check_carried(d);
    ok(strict_complaints() == 0, "no complaint of the strict device");
    strict_close(d);
}
