/* Tracks of a bundle: the sums of what splats have of their own and share, and arrays that do not
 * fit. K: bundle tracks */
#include "scene/bundle_tracks.h"

#include "tests/check.h"
#include "tests/tap.h"

enum { N = 4, TRACKS = 3, W = SPIN_TRACK_WIDTH, ROW = W - 3 };
#define NONE SPIN_NOT_TRACKED
static char path[600];
static float tracks[TRACKS][W], means[N][3], residual[N][ROW];

/* What one test changes. */
struct change {
    uint32_t track[N];
    size_t n_means, n_residual;
    int n_tracks, n_moving, n_varying; /* as meta.json says */
    bool nan;
};
/* No track, one that moves, one that does not, and none. */
static const struct change sound = {{NONE, 0, 2, NONE}, 3, 2, TRACKS, 1, 0, false};

static void write_bundle(const struct change *c)
{
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {
        .columns = SPIN_COL_MEANS, .sh_degree = -1, .n_source_frames = 1};
    struct spin_splats s = {.n = N, .means = means[0]};
    spin_json *extra = spin_json_object(), *trained = spin_json_object(), *t = spin_json_object();
    uint64_t of_tracks[2] = {TRACKS, W}, of_track[1] = {N}, of_means[2] = {c->n_means, 3},
             of_residual[2] = {c->n_residual, ROW};

    snprintf(meta.from, sizeof meta.from, "test");
    tracks[1][4] = c->nan ? NAN : 1;
    if (spin_bundle_meta_reserve(&meta, 1) != SPIN_OK)
        exit(1);
    meta.frame[0].n = N;
    spin_json_set_integer(t, "n", c->n_tracks);
    spin_json_set_integer(t, "moving", c->n_moving);
    spin_json_set_integer(t, "varying", c->n_varying);
    spin_json_set_bool(t, "same_rows", true);
    spin_json_set(trained, "tracks", t);
    spin_json_set_null(trained, "field");
    spin_json_set(extra, "trained", trained);
    if (spin_bundle_writer_open(path, true, false, &w) != SPIN_OK ||
        spin_bundle_write_frame(&w, 0, SPIN_COL_MEANS, 0, &s) != SPIN_OK ||
        spin_npz_write(&w.zip, "trained/tracks", "<f4", 2, of_tracks, tracks) != SPIN_OK ||
        spin_npz_write(&w.zip, "trained/track/00000", "<u4", 1, of_track, c->track) != SPIN_OK ||
        spin_npz_write(&w.zip, "trained/means/00000", "<f4", 2, of_means, means) != SPIN_OK ||
        spin_npz_write(&w.zip, "trained/residual/00000", "<f4", 2, of_residual, residual) !=
            SPIN_OK ||
        spin_bundle_writer_finish(&w, &meta, extra) != SPIN_OK)
        exit(1);
    spin_bundle_meta_free(&meta);
}

/* Open and read the frame. */
static spin_status read_bundle(float *to_means, float *to_rows)
{
    struct spin_bundle b;
    struct spin_bundle_tracks t = {0};
    spin_status status = spin_bundle_open(path, &b);

    if (status != SPIN_OK)
        return status;
    status = spin_bundle_tracks_open(&b, &t);
    if (status == SPIN_OK)
        status = spin_bundle_tracks_frame(&t, 0, N, to_means, to_rows);
    spin_bundle_tracks_close(&t);
    spin_bundle_close(&b);
    return status;
}

/* The first n_varying tracks have values of their own in the frame. */
static void check_sums(int n_varying, size_t n_residual)
{
    struct change c = sound;
    float m[N][3], r[N][ROW];
    bool one = n_varying > 0, two = n_varying > 2;

    c.n_varying = n_varying;
    c.n_residual = n_residual;
    write_bundle(&c);
    if (!ok(read_bundle(m[0], r[0]) == SPIN_OK, "reads a frame: %s", spin_last_error()))
        return;
    ok(m[0][1] == means[0][1] && m[1][1] == means[1][1] + tracks[0][1] && m[2][1] == tracks[2][1] &&
           m[3][1] == means[2][1],
       "places: its own, the sum, the track's");
    ok(r[0][5] == residual[0][5] && r[1][5] == (one ? residual[1][5] : 0) + tracks[0][8] &&
           r[2][5] == (two ? residual[2][5] : 0) + tracks[2][8] &&
           r[3][5] == residual[1 + one + two][5],
       "values likewise, %zu rows of their own", n_residual);
}

static void check_refused(struct change c, const char *why, const char *what)
{
    float m[N][3], r[N][ROW];

    write_bundle(&c);
    ok(read_bundle(m[0], r[0]) == SPIN_E_MALFORMED && strstr(spin_last_error(), why), "%s: %s",
       what, spin_last_error());
}

TAP_MAIN
{
    struct change c;

    snprintf(path, sizeof path, "%s/tracks.spin", check_folder());
    for (int i = 0; i < TRACKS; i++)
        for (int k = 0; k < W; k++)
            tracks[i][k] = (float)(100 * i + k) / 8;
    for (int i = 0; i < N; i++) {
        for (int k = 0; k < 3; k++)
            means[i][k] = (float)(1000 * i + k);
        for (int k = 0; k < ROW; k++)
            residual[i][k] = (float)(2000 * i + k);
    }
    check_sums(0, 2);
    check_sums(1, 3);
    check_sums(3, 4);
    c = sound, c.track[1] = TRACKS;
    check_refused(c, "contains track 3, but there are 3 tracks", "a track that is not there");
    c = sound, c.n_means = 2;
    check_refused(c, "2 positions", "too few positions");
    c = sound, c.n_means = 4;
    check_refused(c, "4 positions", "too many");
    c = sound, c.n_residual = 1;
    check_refused(c, "1 residual values", "too few values");
    c = sound, c.n_moving = 4;
    check_refused(c, "trained.tracks", "more that move than there are");
    c = sound, c.n_varying = -1;
    check_refused(c, "trained.tracks", "fewer that vary than none");
    c = sound, c.n_tracks = 4;
    check_refused(c, "trained/tracks", "another number of rows");
    c = sound, c.nan = true;
    check_refused(c, "not finite in row 1", "a value that is no number");
}
