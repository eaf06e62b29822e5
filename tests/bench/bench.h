/* The benchmark's parts: what the machine can do, and a scene to work on. */
#ifndef SPIN_TESTS_BENCH_BENCH_H
#define SPIN_TESTS_BENCH_BENCH_H

#include "render/image_store.h"
#include "train/step.h"

/* ---- ceilings.c: measured on the spot, so that a share of them holds on any machine ---------- */

enum { BENCH_TABLES = 4 };
struct bench_ceilings {
    double fma;                         /* float operations a second, two to a multiply-add */
    double read, update, triad;         /* bytes a second, read and written */
    size_t table_bytes[BENCH_TABLES];   /* 2, 32, 128, 512 MiB */
    double table_lookups[BENCH_TABLES]; /* random reads of 16 bytes a second */
};
spin_status bench_ceilings(int n_threads, struct bench_ceilings *out);
/* Lookups a second in a table of this size: of the next larger one measured. */
double bench_lookups(const struct bench_ceilings *c, size_t bytes);

/* ---- scene.c: one frame, one camera, a network that draws it --------------------------------- */

struct bench_scene {
    struct spin_device device;
    struct spin_trainer trainer;
    struct spin_lazy_adam *lazy;   /* of the trainer's table, for the stages */
    struct spin_image_store photo; /* one */
    struct spin_camera camera;
    struct spin_camera_f32 cam;
    size_t n;
    bool open;
};

/* n Gaussians on eight spheres, in Morton order, at 640x360, about 50 contributing pairs a pixel;
 * or the points of a frame of a bundle (path not NULL, n ignored). */
spin_status bench_scene_open(const char *device, size_t n, int log2_rows, int n_threads,
                             const char *path, int frame, struct bench_scene *out);
void bench_scene_close(struct bench_scene *s);
/* The frame, and the view of it. */
struct spin_frame_batch bench_frames(struct bench_scene *s);
struct spin_view_batch bench_views(struct bench_scene *s);
/* (splat, pixel) pairs that pass 1/255 before the pixel stops, after a forward pass. */
double bench_scene_pairs(struct bench_scene *s);
/* n values of the device's memory on the host, to be freed; or the end of the program. */
void *bench_fetch(struct bench_scene *s, const void SPIN_DEV *from, size_t bytes);

/* ---- stages.c ------------------------------------------------------------------------------- */

enum { BENCH_STAGES = 16, BENCH_STEPS = 2, BENCH_SIZES = 3 };
/* What a stage is counted in, and which ceiling bounds it. */
enum unit { PER_SPLAT, PER_PAIR, PER_PIXEL, PER_PARAMETER, UNITS };
enum bound { BY_NOTHING, BY_FMA, BY_LOOKUPS, BY_UPDATE };

struct bench_work {
    double flop, bytes, lookups;
    double lines; /* of 64 bytes, wherever they lie: each is a random read by itself */
};

struct bench_stage {
    const char *name, *title;
    void (*run)(struct bench_scene *s);
    struct bench_work (*work)(struct bench_scene *s);
    enum unit unit;
    enum bound bound;
    bool uses_table;                  /* the reference is for 2^21 rows a level */
    double reference_ms[BENCH_SIZES]; /* of one thread, tests/bench/README.md */
    double allowed;                   /* times that */
};
extern const struct bench_stage bench_stages[BENCH_STAGES];
extern const struct bench_stage bench_steps[BENCH_STEPS]; /* whole ones */

/* Seconds of processor time of this process. */
double bench_cpu_s(void);

#endif
