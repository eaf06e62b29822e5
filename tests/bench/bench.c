/* How long the stages of a training step take, beside what this machine can do and beside the
 * reference times of docs/benchmarks.md. `make bench` runs it; `bench --help` lists the choices.
 *
 * A round runs all stages of a step one after the other, as training does, so each finds caches
 * and gradients as they are in training. Processor time is what counts on a shared machine; with
 * more threads than one, time on the wall stands beside it. */
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "io/json.h"
#include "math/adam.h"
#include "tests/bench/bench.h"

enum { MAX_ROUNDS = 64, MAX_LIST = 8, N_SIZES = 3 };
static const size_t reference_sizes[N_SIZES] = {10000, 50000, 200000};

/* What a stage is counted in, and which ceiling bounds it. */
enum unit { PER_SPLAT, PER_PAIR, PER_PIXEL, PER_PARAMETER, UNITS };
enum bound { BY_NOTHING, BY_FMA, BY_LOOKUPS, BY_UPDATE };
static const char *const unit_names[UNITS] = {"Gaussian", "pair", "pixel", "parameter"};

struct work {
    double flop, bytes, lookups;
    double lines; /* of 64 bytes, wherever they lie: each is a random read by itself */
};

struct stage {
    const char *name, *title;
    void (*run)(struct bench_scene *s);
    struct work (*work)(const struct bench_scene *s);
    enum unit unit;
    enum bound bound;
    bool uses_table;              /* the reference is for 2^21 rows a level */
    double reference_ms[N_SIZES]; /* of one thread, docs/benchmarks.md */
    double allowed;               /* times that */
};

struct timing {
    double cpu[MAX_ROUNDS], wall[MAX_ROUNDS];
};

struct options {
    int threads[MAX_LIST], n_threads;
    int sizes[MAX_LIST], n_sizes;
    int tables[MAX_LIST], n_tables;
    int rounds, frame;
    const char *mode, *points;
    bool alone, json;
};

/* ---- the stages ------------------------------------------------------------------------------ */

static const struct spin_train_frame *frame_of(const struct bench_scene *s)
{
    return &s->trainer.frame[0];
}

static void run_contract(struct bench_scene *s)
{
    s->device.op->contract(&s->device, &s->trainer.field.transform, s->n, frame_of(s)->pos, 0.37f,
                           s->trainer.field_eval.x_u);
}

static void run_grid(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;

    s->device.op->grid(&s->device, &s->trainer.field.grid, s->trainer.table.p, s->n, w->x_u, w->z);
}

static void run_grid_lazy(struct bench_scene *s)
{
    struct spin_trainer *t = &s->trainer;

    s->device.op->lazy_grid(&s->device, &t->field.grid, &s->lazy.lazy, t->table.p, t->table.m,
                            t->table.v, s->n, t->field_eval.x_u, t->field_eval.z);
}

static void run_mlp(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;

    s->device.op->mlp(&s->device, &s->trainer.field.heads, s->trainer.heads.p, s->n, w->z, w->raw);
}

static void run_attr(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;

    s->device.op->attr(&s->device, s->n, w->raw, w->attr);
}

static void run_project(struct bench_scene *s)
{
    s->device.op->project(&s->device, &s->cam, s->n, frame_of(s)->pos, s->trainer.field_eval.attr,
                          s->trainer.field.sh_degree, s->trainer.raster.splat2d);
}

static void run_lists(struct bench_scene *s)
{
    struct spin_raster *r = &s->trainer.raster;

    s->device.op->tile_count(&s->device, &s->cam, s->n, r->splat2d, &r->tiles);
    s->device.op->tile_fill(&s->device, &s->cam, s->n, r->splat2d, &r->tiles);
}

static void run_blend(struct bench_scene *s)
{
    struct spin_raster *r = &s->trainer.raster;

    s->device.op->blend(&s->device, &s->cam, r->splat2d, &r->tiles, s->trainer.background, r->image,
                        r->final_transmittance, r->last_contributor);
}

static void run_loss(struct bench_scene *s)
{
    struct spin_raster *r = &s->trainer.raster;
    double values[3];

    s->device.op->loss(&s->device, s->cam.width, s->cam.height, r->image, r->truth, NULL, 0.2f,
                       1.0f, values, r->d_image);
}

static void run_blend_back(struct bench_scene *s)
{
    struct spin_raster *r = &s->trainer.raster;

    s->device.op->blend_back(&s->device, &s->cam, s->n, r->splat2d, &r->tiles,
                             s->trainer.background, r->final_transmittance, r->last_contributor,
                             r->d_image, r->d_splat2d);
}

static void run_project_back(struct bench_scene *s)
{
    struct spin_raster *r = &s->trainer.raster;

    s->device.op->project_back(&s->device, &s->cam, s->n, frame_of(s)->pos,
                               s->trainer.field_eval.attr, s->trainer.field.sh_degree, r->splat2d,
                               r->d_splat2d, s->trainer.field_eval.d_attr, s->trainer.d_pos);
}

/* All rows, as in the reference, whether they have a gradient or not. */
static void run_attr_back(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;

    s->device.op->activate_back(&s->device, s->n, NULL, w->raw, w->d_attr, w->d_raw);
}

static void run_mlp_back(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;

    s->device.op->mlp_back(&s->device, &s->trainer.field.heads, s->trainer.heads.p, s->n, NULL,
                           w->z, w->d_raw, s->trainer.heads.g, w->d_z);
}

static void run_grid_back(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;

    s->device.op->grid_back(&s->device, &s->trainer.field.grid, s->trainer.table.p, s->n, NULL,
                            w->x_u, w->d_z, s->trainer.table.g, w->d_x_u);
}

static void run_adam_lazy(struct bench_scene *s)
{
    struct spin_trainer *t = &s->trainer;
    struct spin_param *p = &t->table;

    s->device.op->lazy_adam(&s->device, &t->field.grid, &s->lazy.lazy, p->n, p->p, p->g, p->m, p->v,
                            1e-7);
    spin_lazy_advance(&s->lazy, 1e-7);
}

static void run_adam(struct bench_scene *s)
{
    struct spin_param *p = &s->trainer.table;

    s->trainer.iteration++;
    s->device.op->adam(&s->device, p->n, p->p, p->g, p->m, p->v, 1e-7, s->trainer.iteration);
}

static void run_step(struct bench_scene *s)
{
    struct spin_train_item item = {.taken = {.camera = &s->camera, .truth = s->truth}};
    struct spin_train_values values = {0};

    if (spin_trainer_step(&s->trainer, &item, 1, &values) != SPIN_OK)
        exit(1);
}

/* ---- their work ------------------------------------------------------------------------------ */

static double lookups_of(const struct bench_scene *s)
{
    return (double)s->n * s->trainer.field.grid.n_levels * 16;
}

/* Lines of the table that the points of the scene need, after a look at it as a lazy one. */
static double lines_of(const struct bench_scene *s)
{
    const struct spin_lazy_adam *lazy = &s->lazy.lazy;
    double n = 0;

    for (size_t i = 0; i < s->lazy.n_lines; i++)
        n += lazy->last[i] > 0;
    return n;
}

static struct work work_grid(const struct bench_scene *s)
{
    return (struct work){
        .lookups = lookups_of(s), .bytes = 16 * lookups_of(s), .lines = lines_of(s)};
}

/* Read, add and write the gradient; read the table for the positions. */
static struct work work_grid_back(const struct bench_scene *s)
{
    return (struct work){.lookups = 2 * lookups_of(s), .bytes = 48 * lookups_of(s)};
}

static double multiply_adds(const struct bench_scene *s)
{
    const struct spin_heads *h = &s->trainer.field.heads;
    double sum = 0;

    for (int k = 0; k < SPIN_HEADS; k++)
        sum += (double)h->hidden * (h->n_in + h->hidden + h->n_out[k]);
    return sum * (double)s->n;
}

static struct work work_mlp(const struct bench_scene *s)
{
    return (struct work){.flop = 2 * multiply_adds(s), .bytes = 480.0 * (double)s->n};
}

/* The activations again, the gradient of the weights and of the inputs. */
static struct work work_mlp_back(const struct bench_scene *s)
{
    return (struct work){.flop = 6 * multiply_adds(s), .bytes = 736.0 * (double)s->n};
}

static struct work work_adam(const struct bench_scene *s)
{
    return (struct work){.bytes = 32.0 * (double)s->trainer.table.n};
}

static struct work work_none(const struct bench_scene *s)
{
    (void)s;
    return (struct work){0};
}

/* clang-format off */
static const struct stage stages[] = {
    {"contract", "contraction", run_contract, work_none, PER_SPLAT, BY_NOTHING, 0, {0}, 0},
    {"grid", "encode forward", run_grid, work_grid, PER_SPLAT, BY_LOOKUPS, 1, {7, 35, 131}, 1.5},
    {"lazy_grid", "  of a lazy table", run_grid_lazy, work_grid, PER_SPLAT, BY_LOOKUPS, 0, {0}, 0},
    {"mlp", "heads forward", run_mlp, work_mlp, PER_SPLAT, BY_FMA, 0, {5.5, 27, 109}, 1.3},
    {"attr", "attributes", run_attr, work_none, PER_SPLAT, BY_NOTHING, 0, {0}, 0},
    {"project", "project + SH", run_project, work_none, PER_SPLAT, BY_NOTHING, 0, {1, 4, 17}, 1.5},
    {"lists", "sort + tile lists", run_lists, work_none, PER_SPLAT, BY_NOTHING, 0, {.6, 1.6, 7.5}, 1.5},
    {"blend", "raster forward", run_blend, work_none, PER_PAIR, BY_NOTHING, 0, {8, 14, 26}, 1.5},
    {"loss", "L1 + SSIM, both ways", run_loss, work_none, PER_PIXEL, BY_NOTHING, 0, {6.4, 6.4, 6.4}, 1.5},
    {"blend_back", "raster backward", run_blend_back, work_none, PER_PAIR, BY_NOTHING, 0, {12, 20, 38}, 1.5},
    {"project_back", "project + SH backward", run_project_back, work_none, PER_SPLAT, BY_NOTHING, 0, {1.4, 6.5, 24}, 1.5},
    {"activate_back", "attributes backward", run_attr_back, work_none, PER_SPLAT, BY_NOTHING, 0, {0}, 0},
    {"mlp_back", "heads backward", run_mlp_back, work_mlp_back, PER_SPLAT, BY_FMA, 0, {15.5, 76, 303}, 1.3},
    {"grid_back", "encode backward", run_grid_back, work_grid_back, PER_SPLAT, BY_LOOKUPS, 1, {22, 114, 404}, 1.5},
    {"adam_lazy", "Adam, needed lines", run_adam_lazy, work_none, PER_SPLAT, BY_NOTHING, 1, {25, 57, 68}, 1.5},
    {"adam", "Adam, all parameters", run_adam, work_adam, PER_PARAMETER, BY_UPDATE, 1, {108, 108, 108}, 1.5},
};
static const struct stage steps[] = {
    {"step", "whole step", run_step, work_none, PER_SPLAT, BY_NOTHING, 1, {187, 412, 1174}, 1.5},
    {"step_lazy", "whole step, lazy table", run_step, work_none, PER_SPLAT, BY_NOTHING, 1, {104, 361, 1134}, 1.5},
};
/* clang-format on */
enum { N_STAGES = sizeof stages / sizeof stages[0], N_STEPS = sizeof steps / sizeof steps[0] };

/* The same step by stock PyTorch on the CPU and a known trainer's rasteriser, docs/benchmarks.md. */
static const double peers_ms[N_SIZES] = {1910, 3810, 19470};

/* ---- measuring ------------------------------------------------------------------------------- */

static void time_stage(const struct stage *stage, struct bench_scene *s, struct timing *t,
                       int round)
{
    double cpu = bench_cpu_s(), wall = spin_now_s();

    stage->run(s);
    t->wall[round] = spin_now_s() - wall;
    t->cpu[round] = bench_cpu_s() - cpu;
}

static int by_value(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

struct row {
    const struct stage *stage;
    double cpu_ms, cpu_median_ms, wall_ms, each_ns, gflops, gbytes, share, ratio, peers;
    double lines, lines_ms; /* of the table, and the time of as many random reads */
};

static int reference_place(size_t n)
{
    for (int i = 0; i < N_SIZES; i++)
        if (reference_sizes[i] == n)
            return i;
    return -1;
}

static double units_of(const struct bench_scene *s, enum unit unit, double intersections)
{
    switch (unit) {
    case PER_PAIR:
        return intersections;
    case PER_PIXEL:
        return (double)s->cam.width * s->cam.height;
    case PER_PARAMETER:
        return (double)s->trainer.table.n;
    default:
        return (double)s->n;
    }
}

static double share_of(const struct stage *stage, const struct work *work, double seconds,
                       const struct bench_scene *s, const struct bench_ceilings *c)
{
    switch (stage->bound) {
    case BY_FMA:
        return work->flop / seconds / c->fma;
    case BY_LOOKUPS:
        return work->lookups / seconds / bench_lookups(c, 4 * s->trainer.table.n);
    case BY_UPDATE:
        return work->bytes / seconds / c->update;
    default:
        return 0;
    }
}

static struct row row_of(const struct stage *stage, struct timing *t, int rounds, int n_threads,
                         const struct bench_scene *s, const struct bench_ceilings *c,
                         double intersections, int log2_rows)
{
    struct work work = stage->work(s);
    struct row row = {.stage = stage};
    int at = reference_place(s->n);
    double seconds;

    qsort(t->cpu, (size_t)rounds, sizeof *t->cpu, by_value);
    qsort(t->wall, (size_t)rounds, sizeof *t->wall, by_value);
    seconds = n_threads == 1 ? t->cpu[0] : t->wall[0];
    row.cpu_ms = 1e3 * t->cpu[0];
    row.cpu_median_ms = 1e3 * t->cpu[rounds / 2];
    row.wall_ms = 1e3 * t->wall[0];
    row.each_ns = 1e9 * t->cpu[0] / units_of(s, stage->unit, intersections);
    row.gflops = work.flop / seconds / 1e9;
    row.gbytes = work.bytes / seconds / 1e9;
    row.share = share_of(stage, &work, seconds, s, c);
    row.lines = work.lines;
    row.lines_ms = 1e3 * work.lines / bench_lookups(c, 4 * s->trainer.table.n);
    if (at >= 0 && n_threads == 1 && stage->allowed > 0 && (!stage->uses_table || log2_rows == 21))
        row.ratio = row.cpu_ms / stage->reference_ms[at];
    if (at >= 0 && n_threads == 1 && stage->run == run_step && log2_rows == 21)
        row.peers = peers_ms[at] / row.cpu_ms;
    return row;
}

/* ---- printing -------------------------------------------------------------------------------- */

static void print_number(const char *format, double v)
{
    char text[32];

    snprintf(text, sizeof text, format, v);
    printf(" %9s", v > 0 ? text : "-");
}

static void print_row(const struct row *r)
{
    printf("  %-22s", r->stage->title);
    print_number("%.2f", r->cpu_ms);
    print_number("%.2f", r->cpu_median_ms);
    print_number("%.2f", r->wall_ms);
    print_number("%.2f", r->each_ns);
    print_number("%.1f", r->gflops);
    print_number("%.1f", r->gbytes);
    print_number("%.2f", r->share);
    print_number("%.2f", r->ratio);
    printf("  %s%s\n", unit_names[r->stage->unit],
           r->ratio <= 0                   ? ""
           : r->ratio <= r->stage->allowed ? ""
                                           : "  OVER");
    if (r->lines > 0 && r->ratio > 0)
        printf("  %-22s %9.2f ms to read its %.2f M lines of 64 bytes at random\n", "", r->lines_ms,
               r->lines / 1e6);
    if (r->peers > 0)
        printf("  %-22s %9.1f times the peers' speed\n", "", r->peers);
}

static void print_head(const struct bench_scene *s, int log2_rows, double intersections)
{
    printf("\n%s, %zu Gaussians, 2^%d rows a level (%.1f M parameters), %.1f contributing pairs a "
           "pixel, %u tile pairs\n",
           s->device.description, s->n, log2_rows, (double)s->trainer.table.n / 1e6,
           intersections / ((double)s->cam.width * s->cam.height),
           s->trainer.raster.tiles.n_intersections);
    printf("  %-22s %9s %9s %9s %9s %9s %9s %9s %9s\n", "", "cpu ms", "median", "wall ms",
           "ns each", "GFLOP/s", "GB/s", "ceiling", "reference");
}

static spin_json *row_to_json(const struct row *r)
{
    spin_json *j = spin_json_object();

    spin_json_set_string(j, "stage", r->stage->name);
    spin_json_set_number(j, "cpu_ms", r->cpu_ms);
    spin_json_set_number(j, "cpu_median_ms", r->cpu_median_ms);
    spin_json_set_number(j, "wall_ms", r->wall_ms);
    spin_json_set_number(j, "each_ns", r->each_ns);
    spin_json_set_string(j, "each", unit_names[r->stage->unit]);
    if (r->gflops > 0)
        spin_json_set_number(j, "gflop_per_s", r->gflops);
    if (r->gbytes > 0)
        spin_json_set_number(j, "gbyte_per_s", r->gbytes);
    if (r->share > 0)
        spin_json_set_number(j, "of_ceiling", r->share);
    if (r->lines > 0) {
        spin_json_set_number(j, "lines", r->lines);
        spin_json_set_number(j, "lines_ms", r->lines_ms);
    }
    if (r->ratio > 0) {
        spin_json_set_number(j, "of_reference", r->ratio);
        spin_json_set_bool(j, "within", r->ratio <= r->stage->allowed);
    }
    if (r->peers > 0)
        spin_json_set_number(j, "times_peers", r->peers);
    return j;
}

static spin_json *ceilings_to_json(int n_threads, const struct bench_ceilings *c)
{
    spin_json *j = spin_json_object(), *tables = spin_json_array();

    spin_json_set_integer(j, "threads", n_threads);
    spin_json_set_number(j, "gflop_per_s", c->fma / 1e9);
    spin_json_set_number(j, "read_gbyte_per_s", c->read / 1e9);
    spin_json_set_number(j, "update_gbyte_per_s", c->update / 1e9);
    spin_json_set_number(j, "triad_gbyte_per_s", c->triad / 1e9);
    for (int i = 0; i < BENCH_TABLES; i++) {
        spin_json *one = spin_json_object();

        spin_json_set_number(one, "mib", (double)(c->table_bytes[i] >> 20));
        spin_json_set_number(one, "lookups_per_s", c->table_lookups[i]);
        spin_json_push(tables, one);
    }
    spin_json_set(j, "random_16_bytes", tables);
    return j;
}

static void print_ceilings(int n_threads, const struct bench_ceilings *c)
{
    printf("%s%d thread%s: multiply-add %.0f GFLOP/s; read %.1f, update %.1f, triad %.1f GB/s; "
           "random 16 bytes",
           n_threads == 1 ? "" : "\n", n_threads, n_threads == 1 ? "" : "s", c->fma / 1e9,
           c->read / 1e9, c->update / 1e9, c->triad / 1e9);
    for (int i = 0; i < BENCH_TABLES; i++)
        printf("%s %.0f M/s in %zu MiB", i ? "," : "", c->table_lookups[i] / 1e6,
               c->table_bytes[i] >> 20);
    printf("\n");
}

/* ---- one scene ------------------------------------------------------------------------------- */

/* What is lazy has nothing to do the second time, and a step is no stage. */
static bool repeats(const struct stage *stage)
{
    return !strstr(stage->name, "lazy") && strcmp(stage->name, "step") != 0;
}

static bool wanted(const struct options *o, const struct stage *stage)
{
    return (!o->mode || strcmp(o->mode, stage->name) == 0) && (!o->alone || repeats(stage));
}

static spin_status fill_lists(struct bench_scene *s)
{
    struct spin_trainer *t = &s->trainer;

    run_contract(s);
    run_grid(s);
    run_mlp(s);
    run_attr(s);
    t->device->op->upload(t->device, t->raster.truth, s->truth,
                          (size_t)s->cam.width * (size_t)s->cam.height * 3 * sizeof(float));
    return spin_raster_forward(&t->raster, &s->cam, s->n, frame_of(s)->pos, t->field_eval.attr,
                               t->field.sh_degree, t->background);
}

static void zero_gradients(struct bench_scene *s)
{
    struct spin_device *d = &s->device;

    d->op->zero(d, s->trainer.field_eval.d_attr, s->n * SPIN_ATTR * sizeof(float));
    d->op->zero(d, s->trainer.d_pos, s->n * 3 * sizeof(float));
    d->op->zero(d, s->trainer.heads.g, s->trainer.heads.n * sizeof(float));
}

static void report(const struct options *o, const struct row *row, spin_json *into)
{
    if (!wanted(o, row->stage))
        return;
    if (into)
        spin_json_push(into, row_to_json(row));
    else
        print_row(row);
}

/* Each stage over and over, as kernels are measured on their own: its data is where it left them. */
static void time_alone(const struct options *o, struct bench_scene *s, struct timing *timing)
{
    zero_gradients(s);
    for (int i = 0; i < N_STAGES; i++)
        time_stage(&stages[i], s, &timing[i], 0);
    for (int i = 0; i < N_STAGES; i++)
        for (int round = 0; round < o->rounds && wanted(o, &stages[i]); round++)
            time_stage(&stages[i], s, &timing[i], round);
}

static spin_status measure(const struct options *o, struct bench_scene *s, int n_threads,
                           int log2_rows, const struct bench_ceilings *c, spin_json *runs)
{
    static struct timing timing[N_STAGES + N_STEPS];
    spin_json *rows = runs ? spin_json_array() : NULL;
    double intersections;

    SPIN_TRY(fill_lists(s)); /* grows what grows */
    intersections = bench_scene_pairs(s);
    if (o->alone)
        time_alone(o, s, timing);
    for (int round = 0; round < o->rounds && !o->alone; round++) {
        zero_gradients(s);
        for (int i = 0; i < N_STAGES; i++)
            time_stage(&stages[i], s, &timing[i], round);
    }
    for (int i = 0; i < N_STEPS; i++) {
        if (!wanted(o, &steps[i]))
            continue;
        s->trainer.iteration = 0;
        if (i == 1)
            SPIN_TRY(spin_trainer_enable_lazy_adam(&s->trainer));
        for (int round = 0; round < o->rounds; round++)
            time_stage(&steps[i], s, &timing[N_STAGES + i], round);
    }
    if (!runs)
        print_head(s, log2_rows, intersections);
    for (int i = 0; i < N_STAGES + N_STEPS; i++) {
        const struct stage *stage = i < N_STAGES ? &stages[i] : &steps[i - N_STAGES];
        struct row row;

        if (!wanted(o, stage))
            continue;
        row = row_of(stage, &timing[i], o->rounds, n_threads, s, c, intersections, log2_rows);
        report(o, &row, rows);
    }
    if (runs) {
        spin_json *j = spin_json_object();

        spin_json_set_string(j, "device", s->device.description);
        spin_json_set_integer(j, "gaussians", (int64_t)s->n);
        spin_json_set_integer(j, "log2_rows", log2_rows);
        spin_json_set_number(j, "pairs_per_pixel",
                             intersections / ((double)s->cam.width * s->cam.height));
        spin_json_set_integer(j, "tile_pairs", s->trainer.raster.tiles.n_intersections);
        spin_json_set(j, "stages", rows);
        spin_json_push(runs, j);
    }
    return SPIN_OK;
}

static spin_status run_all(const struct options *o, spin_json *ceilings, spin_json *runs)
{
    for (int t = 0; t < o->n_threads; t++) {
        struct bench_ceilings c;

        SPIN_TRY(bench_ceilings(o->threads[t], &c));
        if (o->json)
            spin_json_push(ceilings, ceilings_to_json(o->threads[t], &c));
        else
            print_ceilings(o->threads[t], &c);
        for (int k = 0; k < o->n_tables; k++)
            for (int i = 0; i < o->n_sizes; i++) {
                struct bench_scene s;
                spin_status status;

                SPIN_TRY(bench_scene_open((size_t)o->sizes[i], o->tables[k], o->threads[t],
                                          o->points, o->frame, &s));
                status = measure(o, &s, o->threads[t], o->tables[k], &c, runs);
                bench_scene_close(&s);
                SPIN_TRY(status);
            }
    }
    return SPIN_OK;
}

/* ---- the command line ------------------------------------------------------------------------ */

static void help(void)
{
    printf("usage: bench [options]\n"
           "  --threads 1,2         numbers of threads\n"
           "  --gaussians 10000,50000,200000\n"
           "  --table 19,21         log2 of the rows a level\n"
           "  --mode NAME           one stage:");
    for (int i = 0; i < N_STAGES; i++)
        printf(" %s", stages[i].name);
    printf(" step step_lazy\n"
           "  --alone               each stage repeated by itself, not in its place in a step\n"
           "  --rounds 7            up to %d; the least and the median are shown\n"
           "  --points FILE.spin    the points of a bundle's frame instead of the made-up ones\n"
           "  --frame 0             which\n"
           "  --json                one document on standard output\n",
           MAX_ROUNDS);
}

static int read_list(const char *text, int list[MAX_LIST])
{
    int n = 0;

    while (n < MAX_LIST && *text) {
        char *end;
        long v = strtol(text, &end, 10);

        if (end == text || v < 1)
            return 0;
        list[n++] = (int)v;
        text = *end == ',' ? end + 1 : end;
        if (*end && *end != ',')
            return 0;
    }
    return n;
}

static bool known_mode(const char *mode)
{
    bool known = strcmp(mode, steps[0].name) == 0 || strcmp(mode, steps[1].name) == 0;

    for (int i = 0; i < N_STAGES; i++)
        known |= strcmp(mode, stages[i].name) == 0;
    return known;
}

static bool read_options(int argc, char **argv, struct options *o)
{
    static const struct option known[] = {
        {"threads", 1, 0, 't'}, {"gaussians", 1, 0, 'g'}, {"table", 1, 0, 'k'}, {"mode", 1, 0, 'm'},
        {"rounds", 1, 0, 'r'},  {"points", 1, 0, 'p'},    {"frame", 1, 0, 'f'}, {"json", 0, 0, 'j'},
        {"help", 0, 0, 'h'},    {"alone", 0, 0, 'a'},     {0, 0, 0, 0}};
    int c;

    while ((c = getopt_long(argc, argv, "", known, NULL)) != -1) {
        switch (c) {
        case 't':
            o->n_threads = read_list(optarg, o->threads);
            break;
        case 'g':
            o->n_sizes = read_list(optarg, o->sizes);
            break;
        case 'k':
            o->n_tables = read_list(optarg, o->tables);
            break;
        case 'm':
            o->mode = optarg;
            break;
        case 'r':
            o->rounds = atoi(optarg);
            break;
        case 'p':
            o->points = optarg;
            o->n_sizes = 1;
            break;
        case 'f':
            o->frame = atoi(optarg);
            break;
        case 'a':
            o->alone = true;
            break;
        case 'j':
            o->json = true;
            break;
        case 'h':
            help();
            exit(0);
        default:
            return false;
        }
    }
    return optind == argc && o->n_threads && o->n_sizes && o->n_tables && o->rounds >= 1 &&
           o->rounds <= MAX_ROUNDS && (!o->mode || known_mode(o->mode));
}

int main(int argc, char **argv)
{
    struct options o = {.threads = {1},
                        .n_threads = 1,
                        .sizes = {10000, 50000, 200000},
                        .n_sizes = 3,
                        .tables = {19, 21},
                        .n_tables = 2,
                        .rounds = 7};
    spin_json *all, *ceilings = NULL, *runs = NULL;

    if (!read_options(argc, argv, &o)) {
        fprintf(stderr, "bench: not understood; see bench --help\n");
        return 2;
    }
    if (o.json) {
        ceilings = spin_json_array();
        runs = spin_json_array();
    }
    if (run_all(&o, ceilings, runs) != SPIN_OK) {
        fprintf(stderr, "bench: %s\n", spin_last_error());
        return 1;
    }
    if (o.json) {
        char *text;

        all = spin_json_object();
        spin_json_set(all, "ceilings", ceilings);
        spin_json_set(all, "runs", runs);
        text = spin_json_text(all, true);
        printf("%s\n", text ? text : "{}");
        free(text);
        spin_json_free(all);
    }
    return 0;
}
