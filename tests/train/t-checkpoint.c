/* A checkpoint restores the exact bits, completely or not at all; its digest of the inputs
 * decides whether it may be used.
 * K: retrain resume tracks */
#include "tests/device/strict.h"
#include "tests/train/tracked.h"

#include <limits.h>

#include "base/log.h"
#include "io/json.h"
#include "train/checkpoint.h"
#include "train/refinement.h"
#include "train/trainer.h"

/* Replaces Jansson's allocator, which the library calls, so that memory can run out. */
static int n_left = INT_MAX;

static void *starving(size_t bytes) { return n_left-- > 0 ? malloc(bytes) : NULL; }

void json_get_alloc_funcs(json_malloc_t *allocate, json_free_t *release)
{
    *allocate = starving;
    *release = free;
}

enum { ITERATION = 7, ITERATIONS = 20 };
static char path[600], other[620];
static struct spin_field field;

/* ---- A checkpoint */

struct run {
    struct spin_trainer t;
    struct spin_simd_paths simd_paths;
    uint32_t *place[2];
    struct spin_checkpoint c;
};

/* A trainer of these sizes with a lazy table, as at the start of a run. */
static void open_run(struct run *r, struct spin_device *d, const struct spin_frame_size *frame,
                     size_t n, size_t n_moving, size_t n_varying)
{
    memset(r, 0, sizeof *r);
    tracked_open(d, frame, n, n_moving, n_varying, &field, &r->t);
    r->t.rates.iterations = ITERATIONS;
    r->t.average = spin_average_of(1, 0, ITERATIONS);
    if (spin_trainer_enable_lazy_adam(&r->t) != SPIN_OK)
        exit(1);
    spin_simd_paths_begin(&r->simd_paths, "v1");
    tracked_places(r->place);
    r->c = (struct spin_checkpoint){.path = path,
                                    .fingerprint = "this input",
                                    .restart = "",
                                    .start_s = spin_now_s(),
                                    .simd_paths = &r->simd_paths,
                                    .permutation = r->place};
}

static void end(struct run *r)
{
    spin_pages_release(r->place[0]);
    spin_pages_release(r->place[1]);
    spin_trainer_close(&r->t);
}

/* Arrays of the trainer, one after the other. */
struct array {
    void SPIN_DEV *at;
    size_t n;
};

static int list(struct spin_trainer *t, struct array *a)
{
    const struct spin_param *param[] = {&t->table, &t->heads, &t->tracks};
    int n = 0;

    for (int i = 0; i < 3; i++) {
        a[n++] = (struct array){param[i]->p, param[i]->n};
        a[n++] = (struct array){param[i]->m, param[i]->n};
        a[n++] = (struct array){param[i]->v, param[i]->n};
    }
    for (int f = 0; f < TRACKED_FRAMES; f++)
        for (int k = 0; k < 6; k++)
            a[n++] = (struct array){tracked_part(&t->frame[f], k % 3, k > 2),
                                    k > 2 ? 11 * t->frame[f].size.n_residual
                                          : 3 * t->frame[f].size.n_pos};
    for (int f = 0; f < TRACKED_FRAMES; f++) {
        a[n++] = (struct array){t->frame[f].gradient, t->frame[f].size.n};
        a[n++] = (struct array){t->frame[f].seen, t->frame[f].size.n};
        a[n++] = (struct array){t->frame[f].track, t->frame[f].size.n};
        a[n++] = (struct array){t->frame[f].turn, 4 * t->frame[f].size.n_pos};
    }
    if (t->lazy)
        a[n++] = (struct array){t->lazy->last, t->lazy->n_lines};
    return n;
}
enum { MOST_ARRAYS = 40 };

/* Gives every array and every recorded value different numbers. */
static void fill(struct run *r)
{
    static const float gradient[2][5] = {{0.1f, 0.2f, 0.3f, 0.4f, 0.5f}, {0.6f, 0.7f, 0.8f, 0.9f}};
    static const uint32_t seen[2][5] = {{1, 2, 3, 4, 4000000001u}, {6, 7, 8, 9}};
    struct spin_device *d = r->t.device;
    struct array a[MOST_ARRAYS];
    int n = list(&r->t, a);

    for (int i = 0; i < 6; i++) {
        float *host = malloc(a[i].n * sizeof *host + 1);

        for (size_t k = 0; k < a[i].n; k++)
            host[k] = (float)(i + 1) + (float)(k % 1000) / 1024;
        d->op->upload(d, a[i].at, host, a[i].n * sizeof *host);
        free(host);
    }
    if (r->t.lazy) {
        float *host = malloc(a[n - 1].n * sizeof *host);

        for (size_t k = 0; k < a[n - 1].n; k++)
            host[k] = (float)(k % (ITERATION + 1));
        d->op->upload(d, a[n - 1].at, host, a[n - 1].n * sizeof *host);
        free(host);
    }
    tracked_fill(d, &r->t, 0);
    tracked_see(d, &r->t, gradient, seen);
    for (r->t.iteration = 1; r->t.iteration < ITERATION; r->t.iteration++) /* 2, 4 and 6 count */
        if (spin_average_step(&r->t) != SPIN_OK)
            exit(1);
}

static void save(struct run *r)
{
    ok(spin_checkpoint_save(&r->c, &r->t) == SPIN_OK, "saves: %s", spin_last_error());
}

/* A trainer of the checkpoint's sizes, and the checkpoint read into it. */
static spin_status resume(struct run *r, struct spin_device *d, const char *from)
{
    struct spin_frame_size frame[TRACKED_FRAMES];
    struct spin_trainer_size size = {.n_frames = TRACKED_FRAMES};
    const struct spin_checkpoint c = {.path = from, .fingerprint = "this input"};
    spin_status status = spin_checkpoint_sizes(&c, frame, &size);

    if (status != SPIN_OK)
        return status;
    ok(memcmp(frame, tracked_size, sizeof frame) == 0 && size.n_tracks == TRACKED &&
           size.n_moving == 2 && size.n_varying == 3,
       "the sizes of its frames and tracks");
    open_run(r, d, frame, size.n_tracks, size.n_moving, size.n_varying);
    r->c.path = from;
    memset(r->place[0], 0, 5 * sizeof *r->place[0]);
    status = spin_checkpoint_load(&r->c, &r->t);
    if (status != SPIN_OK)
        end(r);
    return status;
}

/* Running out of memory for state.json loses this checkpoint, not the previous one. */
static void check_starved(struct run *r)
{
    struct spin_map map;
    struct spin_digest before, after;
    int n = 0, wrong = 0;
    spin_status status = SPIN_E_MEMORY;

    if (spin_map_open(path, &map) != SPIN_OK)
        exit(1);
    before = spin_map_digest(&map);
    spin_map_close(&map);
    for (; status == SPIN_E_MEMORY && n < 1000; n++) {
        n_left = n;
        status = spin_checkpoint_save(&r->c, &r->t);
        n_left = INT_MAX;
        if (status == SPIN_OK || spin_map_open(path, &map) != SPIN_OK)
            break;
        after = spin_map_digest(&map);
        spin_map_close(&map);
        wrong += after.size != before.size || after.crc != before.crc;
    }
    ok(status == SPIN_OK && n > 20 && wrong == 0,
       "each of %d allocations may fail: the last state stays", n);
}

static void check_back(struct spin_device *d)
{
    struct run was, now;
    struct array a[MOST_ARRAYS], b[MOST_ARRAYS];
    int n, wrong = 0;

    open_run(&was, d, tracked_size, TRACKED, 2, 3);
    fill(&was);
    was.c.before_s = 100;
    was.c.start_s -= 50;
    was.c.refine_s = 7;
    was.c.loss = 0.125;
    save(&was);
    check_starved(&was);
    if (!ok(resume(&now, d, path) == SPIN_OK, "comes back: %s", spin_last_error()))
        exit(tap_done());
    n = list(&was.t, a);
    ok(list(&now.t, b) == n && n == 9 + 12 + 8 + 1, "%d arrays", n);
    for (int i = 0; i < n; i++) {
        size_t bytes = a[i].n * sizeof(float);
        void *x = malloc(bytes + 1), *y = malloc(bytes + 1);

        wrong += a[i].n == 0 || a[i].n != b[i].n ||
                 d->op->download(d, x, a[i].at, bytes) != SPIN_OK ||
                 d->op->download(d, y, b[i].at, bytes) != SPIN_OK || memcmp(x, y, bytes) != 0;
        free(x), free(y);
    }
    ok(wrong == 0, "of the same bits: %d are not", wrong);
    ok(now.t.average.n == 3 && was.t.average.n == 3 && was.t.average.n_values > 14 * TRACKED &&
           now.t.average.n_values == was.t.average.n_values &&
           memcmp(now.t.average.mean, was.t.average.mean, was.t.average.n_values * sizeof(float)) ==
               0,
       "the average so far, of %d iterations", now.t.average.n);
    ok(now.t.iteration == ITERATION && now.t.frame[0].steps == 40 && now.t.frame[1].steps == 41,
       "the iteration, and the steps of each frame");
    for (int f = 0; f < 2; f++)
        ok(memcmp(now.place[f], was.place[f], tracked_size[f].n * sizeof *was.place[f]) == 0,
           "the places of frame %d in the output", f);
    now.c.start_s -= 30;
    near(spin_checkpoint_seconds(&now.c), 180, 5, "seconds of all runs: 100, 50 and 30");
    ok(now.c.refine_s == 7 && now.c.loss == 0.125 && now.c.saved == ITERATION,
       "and what else is told of it");
    end(&was);
    end(&now);
}

/* ---- Refused checkpoints */

/* The checkpoint with value i of an array changed to these bits, in another file. */
static void alter(const char *name, size_t i, uint32_t bits)
{
    struct spin_npz npz;
    struct spin_zip_writer w;
    bool found = false;

    if (spin_npz_open(path, &npz) != SPIN_OK || spin_zip_writer_open(other, true, &w) != SPIN_OK)
        exit(1);
    for (size_t k = 0; k < npz.zip.n; k++) {
        const struct spin_zip_member *m = &npz.zip.member[k];
        const unsigned char *bytes;
        unsigned char *copy = malloc(m->size);
        void *owned = NULL;

        if (spin_zip_read(&npz.zip, m, true, 1 << 26, &bytes, &owned) != SPIN_OK)
            exit(1);
        memcpy(copy, bytes, m->size);
        if (strncmp(m->name, name, strlen(name)) == 0 &&
            strcmp(m->name + strlen(name), ".npy") == 0) {
            memcpy(copy + 10 + copy[8] + 256 * copy[9] + 4 * i, &bits, 4);
            found = true;
        }
        if (spin_zip_member_begin(&w, m->name, m->size) != SPIN_OK ||
            spin_zip_member_write(&w, copy, m->size) != SPIN_OK ||
            spin_zip_member_end(&w) != SPIN_OK)
            exit(1);
        free(copy);
        free(owned);
    }
    if (spin_zip_writer_commit(&w) != SPIN_OK)
        exit(1);
    spin_npz_close(&npz);
    ok(found, "a state with another value %zu of %s", i, name);
}

static uint32_t bits_of(float v)
{
    uint32_t bits;

    memcpy(&bits, &v, sizeof bits);
    return bits;
}

static void check_refused(struct spin_device *d)
{
    static const struct {
        const char *name;
        size_t i;
        uint32_t bits;
        const char *why;
    } bad[] = {
        {"frames/00001/track", 1, 2,
         "contradicts the numbers of tracks"}, /* two splats of track 2, none of 1 */
        {"frames/00001/track", 1, 3, "contradicts the numbers of tracks"},
        {"frames/00000/track", 0, 1,
         "contradicts the numbers of tracks"}, /* a track where splats have none */
        {"frames/00000/track", 2, 0xffffffffu, "contradicts the numbers of tracks"},
        {"frames/00000/track", 4, 4, "contradicts the numbers of tracks"}, /* there are four */
        {"frames/00000/place", 1, 2, "contradicts the numbers of tracks"}, /* twice */
        {"frames/00000/place", 1, 5, "contradicts the numbers of tracks"},
        {"residual/00001/v", 3, 0x7fc00000u, "not finite"},
        {"tracks/p", 0, 0x7f800000u, "not finite"},
        {"table/m", 1, 0xff800000u, "not finite"},
    };
    struct run r;
    struct spin_checkpoint c = {.path = path, .fingerprint = "another input", .restart = "--force"};
    struct spin_frame_size frame[TRACKED_FRAMES];
    struct spin_trainer_size size = {.n_frames = TRACKED_FRAMES};

    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        alter(bad[i].name, bad[i].i, bad[i].bits);
        ok(resume(&r, d, other) == SPIN_E_MALFORMED && strstr(spin_last_error(), bad[i].why) &&
               strstr(spin_last_error(), bad[i].name) && strstr(spin_last_error(), other),
           "is refused: %s", spin_last_error());
    }
    alter("table/last", 1, bits_of(ITERATION));
    ok(resume(&r, d, other) == SPIN_OK, "a line of the table that took the last step");
    end(&r);
    alter("table/last", 1, bits_of(ITERATION + 1));
    ok(resume(&r, d, other) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "row 1 is not an iteration from 0 to"),
       "not one that took a step more: %s", spin_last_error());
    ok(spin_checkpoint_sizes(&c, frame, &size) == SPIN_E_USAGE &&
           strstr(spin_last_error(), "the input, the options or the images differ") &&
           strstr(spin_last_error(), "ones, or --force to start anew"),
       "of another input: %s", spin_last_error());
    open_run(&r, d, tracked_size, TRACKED, 2, 3);
    r.c.fingerprint = "another input";
    ok(spin_checkpoint_load(&r.c, &r.t) == SPIN_E_USAGE, "nor is it loaded");
    r.c.fingerprint = "this input";
    r.t.rates.iterations = ITERATION;
    ok(spin_checkpoint_load(&r.c, &r.t) == SPIN_OK, "the state of the last iteration");
    r.t.rates.iterations = ITERATION - 1;
    ok(spin_checkpoint_load(&r.c, &r.t) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "iteration"),
       "not one beyond it: %s", spin_last_error());
    end(&r);
}

/* ---- The digest of inputs */

/* Two frames of a bundle of three, two cameras. */
struct input {
    struct spin_plan plan;
    struct spin_retrain_options o;
    struct spin_refined *given;
    struct spin_photos photos;
    struct spin_device device;
    struct spin_device_ops op;
    struct spin_zip_member member[2];
    struct spin_frame_info info[3];
    int frame[2], dataset_frame[2];
    size_t counts[2];
    struct spin_pair train[2];
    struct spin_refined refined[2];
    uint64_t digest[3];
    struct spin_view view[3];
};

static void make_input(struct input *in)
{
    memset(in, 0, sizeof *in);
    spin_retrain_preset("paper", &in->o);
    in->op.name = "cpu";
    in->device.op = &in->op;
    in->plan.o = &in->o;
    in->plan.field = field;
    in->plan.extent = 3;
    in->plan.counts = in->counts;
    in->plan.train = in->train;
    in->plan.n_train = 2;
    in->plan.clip.frame = in->frame;
    in->plan.clip.n_frames = 2;
    in->plan.clip.dataset_frame = in->dataset_frame;
    in->plan.clip.bundle.meta.frame = in->info;
    in->plan.clip.bundle.meta.n_frames = 3;
    in->plan.clip.bundle.npz.zip.member = in->member;
    in->plan.clip.bundle.npz.zip.n = 2;
    in->plan.clip.views.view = in->view;
    in->plan.clip.views.n = 3;
    in->photos.digest = in->digest;
    in->given = in->refined;
    for (int i = 0; i < 3; i++) {
        in->info[i].number = 10 + i;
        in->digest[i] = 1000 + (uint64_t)i;
        in->view[i].camera_id = i;
        in->view[i].test = i == 2;
    }
    for (int i = 0; i < 2; i++) {
        in->member[i] = (struct spin_zip_member){
            .name = i == 0 ? "first.npy" : "second.npy", .size = 100, .crc = 77 + (uint32_t)i};
        in->frame[i] = 1 + i;
        in->counts[i] = 500 + (size_t)i;
        in->train[i] = (struct spin_pair){i, (size_t)i};
        snprintf(in->refined[i].key, sizeof in->refined[i].key, "key%d", i);
    }
}

static char *fingerprint_of(const struct input *in)
{
    char *text = NULL;

    if (spin_fingerprint(&in->plan, in->given, &in->photos, &in->device, &text) != SPIN_OK)
        exit(1);
    return text;
}

static void by_nothing(struct input *in)
{
    in->o.n_threads++, in->o.save_every++, in->o.force = true;
}
static void by_number(struct input *in) { in->info[2].number++; }
static void by_order(struct input *in) { in->frame[0] = 2, in->frame[1] = 1; }
static void by_count(struct input *in) { in->counts[1]++; }
static void by_key(struct input *in) { in->refined[1].key[0] = 'K'; }
static void by_image(struct input *in) { in->digest[1]++; }
static void by_view(struct input *in) { in->train[1].view = 0; }
static void by_bytes(struct input *in) { in->member[1].crc++; }
static void by_exchange(struct input *in) { in->member[0].crc = 78, in->member[1].crc = 77; }
static void by_name(struct input *in) { in->member[1].name = "other.npy"; }
static void by_test_view(struct input *in) { in->view[1].test = true; }
static void by_extent(struct input *in) { in->plan.extent = 4; }
static void by_seed(struct input *in) { in->o.seed++; }
static void by_rate(struct input *in) { in->o.lr_table *= 2; }
static void by_way(struct input *in) { in->o.normalise++; }
static void by_levels(struct input *in) { in->plan.field.grid.n_levels--; }
static void by_device(struct input *in) { in->op.name = "cuda"; }

static void check_fingerprint(void)
{
    static const struct {
        const char *what;
        void (*change)(struct input *);
        bool explicit_too; /* frame by frame too */
    } by[] = {{"a frame's number", by_number, true},
              {"which frames these are", by_order, true},
              {"splats of a frame", by_count, true},
              {"how a frame is refined", by_key, true},
              {"an image", by_image, true},
              {"which views are learned from", by_view, true},
              {"an array of the input", by_bytes, true},
              {"two arrays that were exchanged", by_exchange, true},
              {"the name of an array", by_name, true},
              {"which views are held out", by_test_view, false},
              {"the extent of the cameras", by_extent, false},
              {"the seed", by_seed, false},
              {"a rate", by_rate, false},
              {"how it is fitted", by_way, false},
              {"the network's shape", by_levels, false},
              {"the device", by_device, false}};
    static struct input in;

    for (int alone = 0; alone < 2; alone++)
        for (size_t i = 0; i <= sizeof by / sizeof *by; i++) {
            bool none = i == sizeof by / sizeof *by;
            char *was, *now;

            make_input(&in);
            in.o.method = alone ? SPIN_METHOD_FRAMES : in.o.method;
            was = fingerprint_of(&in);
            (none ? by_nothing : by[i].change)(&in);
            now = fingerprint_of(&in);
            if (none)
                ok(strcmp(was, now) == 0, "threads and files say nothing of what comes out");
            else if (by[i].explicit_too || !alone)
                ok(strcmp(was, now) != 0, "the fingerprint tells %s%s", by[i].what,
                   alone ? ", frame by frame" : "");
            free(was), free(now);
        }
}

/* Earlier versions recorded options that are now constants. */
static void check_former_options(void)
{
    static const char own[] = "{\"normalise\":1,\"options\":{\"lr_table\":0.04}}";
    static const struct {
        const char *radius, *base, *log_scale;
        bool equal;
    } of[] = {{"0", "[8,8,8,8]", "-5", true},
              {"2", "[8,8,8,8]", "-5", false},
              {"0", "[8,8,8,4]", "-5", false},
              {"0", "[8,8,8,8]", "\"auto\"", false}};
    char recorded[300];

    for (size_t i = 0; i < sizeof of / sizeof *of; i++) {
        snprintf(recorded, sizeof recorded,
                 "{\"normalise\":1,\"normalise_radius\":%s,\"normalise_centre\":[0,0,0],"
                 "\"options\":{\"lr_table\":0.04,\"base_resolution\":%s,\"init_log_scale\":%s}}",
                 of[i].radius, of[i].base, of[i].log_scale);
        ok(spin_fingerprint_equal(recorded, own) == of[i].equal,
           "radius %s, coarsest level %s, log scale %s: %s", of[i].radius, of[i].base,
           of[i].log_scale, of[i].equal ? "the run of today" : "another run");
    }
    ok(!spin_fingerprint_equal("{", own), "a damaged fingerprint is another run");
}

/* ---- SIMD paths */

static int n_warnings;

static bool count_warning(const char *line)
{
    n_warnings +=
        strstr(line, "of this run is v1, but the training has used several (v1+base)") != NULL;
    return false;
}

/* Frames that have changed since the last check are checked again. */
static void check_not_finite(struct spin_device *d)
{
    static const float bad = NAN;
    struct run r;

    open_run(&r, d, tracked_size, TRACKED, 2, 3);
    fill(&r);
    r.t.frame[0].steps = r.t.frame[1].steps = 4;
    ok(spin_check_parameters(&r.t) == SPIN_OK, "all parameters are finite");
    r.t.frame[1].steps++;
    d->op->upload(d, r.t.frame[1].pos + 2, &bad, sizeof bad);
    ok(spin_check_parameters(&r.t) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "'frames/00001/p' has a value that is not finite at index 2"),
       "not after a step of a frame: %s", spin_last_error());
    ok(spin_check_parameters(&r.t) == SPIN_E_MALFORMED, "nor when it is checked once more");
    end(&r);
}

static void check_code_paths(void)
{
    struct spin_simd_paths paths;

    spin_simd_paths_begin(&paths, "v1");
    spin_log_set_level(-1);
    spin_log_set_sink(count_warning);
    spin_simd_paths_add(&paths, NULL);
    spin_simd_paths_add(&paths, "v1");
    ok(n_warnings == 0 && !strcmp(paths.all, "v1"), "the same code path: nothing is said");
    spin_simd_paths_add(&paths, "base+v1");
    ok(n_warnings == 1 && !strcmp(paths.all, "v1+base"), "another is told, and kept: %s",
       paths.all);
    spin_simd_paths_add(&paths, "base");
    ok(n_warnings == 1, "once");
    spin_log_set_sink(NULL);
}

TAP_MAIN
{
    static const int base[4] = {4, 4, 4, 2}, finest[4] = {16, 16, 16, 8};
    struct spin_device *d;

    spin_log_set_level(-2);
    snprintf(path, sizeof path, "%s/state", check_folder());
    snprintf(other, sizeof other, "%s.altered", path);
    if (spin_field_plan(&field, 4, 4, 8, 8, 0, base, finest) != SPIN_OK)
        exit(1);
    d = check_device(2);
    check_back(d);
    check_refused(d);
    check_not_finite(d);
    check_device_free(d);
    check_fingerprint();
    check_former_options();
    check_code_paths();
}
