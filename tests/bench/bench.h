/* The benchmark's parts: what the machine can do, and a scene to work on. */
#ifndef SPIN_TESTS_BENCH_BENCH_H
#define SPIN_TESTS_BENCH_BENCH_H

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
    struct spin_lazy_table lazy; /* of the trainer's table, for the stages */
    struct spin_camera camera;
    struct spin_camera_f32 cam;
    size_t n;
    float *truth; /* host [3][h][w] */
    bool open;
};

/* n Gaussians on eight spheres, in Morton order, at 640x360, about 50 contributing pairs a pixel;
 * or the points of a frame of a bundle (path not NULL, n ignored). */
spin_status bench_scene_open(size_t n, int log2_rows, int n_threads, const char *path, int frame,
                             struct bench_scene *out);
void bench_scene_close(struct bench_scene *s);
/* (splat, pixel) pairs that pass 1/255 before the pixel stops, after a forward pass. */
double bench_scene_pairs(const struct bench_scene *s);

/* Seconds of processor time of this process. */
double bench_cpu_s(void);

#endif
