/* Measures the stages of a training iteration, and compares them with the limits of this machine
 * and with the reference times of tests/bench/README.md. `make bench` runs it; `bench --help` lists
 * the choices.
 *
 * A round runs all stages of a step one after the other, as training does, so each finds caches
 * and gradients as they are in training. Processor time is what counts on a shared machine; with
 * more threads than one, time on the wall stands beside it. */
#include <getopt.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "base/number.h"
#include "math/adam.h"
#include "tests/bench/bench.h"

enum { MAX_ROUNDS = 64, MAX_LIST = 8 };
static const size_t reference_sizes[BENCH_SIZES] = {10000, 50000, 200000};

static const char *const unit_names[UNITS] = {"Gaussian", "pair", "pixel", "parameter"};

struct timing {
    double cpu[MAX_ROUNDS], wall[MAX_ROUNDS];
    bool failed; /* the device did */
};

struct options {
    int threads[MAX_LIST], n_threads;
    int sizes[MAX_LIST], n_sizes;
    int tables[MAX_LIST], n_tables;
    int rounds, frame;
    const char *mode, *points, *device;
    bool alone, json;
};

/* ---- measuring ------------------------------------------------------------------------------- */

static void time_stage(const struct bench_stage *stage, struct bench_scene *s, struct timing *t,
                       int round)
{
    double cpu = bench_cpu_s(), wall = spin_now_s();

    stage->run(s);
    if (!s->device.is_host && s->device.op->wait(&s->device) != SPIN_OK)
        t->failed = true;
    t->wall[round] = spin_now_s() - wall;
    t->cpu[round] = bench_cpu_s() - cpu;
}

struct row {
    const struct bench_stage *stage;
    double cpu_ms, cpu_median_ms, wall_ms, each_ns, gflops, gbytes, share, ratio;
    double lines, lines_ms; /* of the table, and the time of as many random reads */
};

static int reference_place(size_t n)
{
    for (int i = 0; i < BENCH_SIZES; i++)
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

static double share_of(const struct bench_stage *stage, const struct bench_work *work,
                       double seconds, const struct bench_scene *s, const struct bench_ceilings *c)
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

static struct row row_of(const struct bench_stage *stage, struct timing *t, int rounds,
                         int n_threads, struct bench_scene *s, const struct bench_ceilings *c,
                         double intersections, int log2_rows)
{
    struct bench_work work = stage->work(s);
    struct row row = {.stage = stage};
    int at = reference_place(s->n);
    double seconds;
    bool one_thread = n_threads == 1 && s->device.is_host;

    qsort(t->cpu, (size_t)rounds, sizeof *t->cpu, spin_by_double);
    qsort(t->wall, (size_t)rounds, sizeof *t->wall, spin_by_double);
    seconds = one_thread ? t->cpu[0] : t->wall[0];
    row.cpu_ms = 1e3 * t->cpu[0];
    row.cpu_median_ms = 1e3 * t->cpu[rounds / 2];
    row.wall_ms = 1e3 * t->wall[0];
    row.each_ns = 1e9 * (s->device.is_host ? t->cpu[0] : t->wall[0]) /
                  units_of(s, stage->unit, intersections);
    row.gflops = work.flop / seconds / 1e9;
    row.gbytes = work.bytes / seconds / 1e9;
    if (s->device.is_host) { /* the ceilings are the processor's */
        row.share = share_of(stage, &work, seconds, s, c);
        row.lines = work.lines;
        row.lines_ms = 1e3 * work.lines / bench_lookups(c, 4 * s->trainer.table.n);
    }
    if (at >= 0 && one_thread && stage->allowed > 0 && (!stage->uses_table || log2_rows == 21))
        row.ratio = row.cpu_ms / stage->reference_ms[at];
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
}

static void print_head(const struct bench_scene *s, int log2_rows, double intersections)
{
    printf("\n%s, %zu Gaussians, 2^%d rows a level (%.1f M parameters), %.1f contributing pairs a "
           "pixel, %llu tile pairs\n",
           s->device.description, s->n, log2_rows, (double)s->trainer.table.n / 1e6,
           intersections / ((double)s->cam.width * s->cam.height),
           (unsigned long long)s->trainer.raster.tiles.n_intersections);
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
static bool repeats(const struct bench_stage *stage)
{
    return !strstr(stage->name, "lazy") && strcmp(stage->name, "step") != 0;
}

static bool wanted(const struct options *o, const struct bench_stage *stage)
{
    return (!o->mode || strcmp(o->mode, stage->name) == 0) && (!o->alone || repeats(stage));
}

static spin_status fill_lists(struct bench_scene *s)
{
    struct spin_trainer *t = &s->trainer;
    struct spin_frame_batch frames = bench_frames(s);
    struct spin_view_batch views = bench_views(s);

    spin_field_forward(&t->field_eval, &t->field, t->table.p, t->heads.p, &frames);
    return spin_raster_forward(&t->raster, &views, &frames, t->field_eval.attr, t->field.sh_degree);
}

/* All rows count as active. */
static spin_status fill_active(struct bench_scene *s)
{
    struct spin_device *d = &s->device;
    uint32_t n = (uint32_t)s->n, *row;
    void *block = NULL;

    SPIN_TRY(spin_alloc(n, sizeof *row, &block));
    row = block;
    for (uint32_t i = 0; i < n; i++)
        row[i] = i;
    d->op->upload(d, s->trainer.field_eval.active.row, row, n * sizeof *row);
    d->op->upload(d, s->trainer.field_eval.active.n, &n, sizeof n);
    free(block);
    return SPIN_OK;
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

/* Each stage over and over, as kernels are measured on their own: its data is where it left them.
 */
static void time_alone(const struct options *o, struct bench_scene *s, struct timing *timing)
{
    zero_gradients(s);
    for (int i = 0; i < BENCH_STAGES; i++)
        time_stage(&bench_stages[i], s, &timing[i], 0);
    for (int i = 0; i < BENCH_STAGES; i++)
        for (int round = 0; round < o->rounds && wanted(o, &bench_stages[i]); round++)
            time_stage(&bench_stages[i], s, &timing[i], round);
}

static spin_status measure(const struct options *o, struct bench_scene *s, int n_threads,
                           int log2_rows, const struct bench_ceilings *c, spin_json *runs)
{
    static struct timing timing[BENCH_STAGES + BENCH_STEPS];
    spin_json *rows = runs ? spin_json_array() : NULL;
    double intersections;

    SPIN_TRY(fill_lists(s)); /* grows what grows */
    SPIN_TRY(fill_active(s));
    intersections = bench_scene_pairs(s);
    if (o->alone)
        time_alone(o, s, timing);
    for (int round = 0; round < o->rounds && !o->alone; round++) {
        zero_gradients(s);
        for (int i = 0; i < BENCH_STAGES; i++)
            time_stage(&bench_stages[i], s, &timing[i], round);
    }
    for (int i = 0; i < BENCH_STEPS; i++) {
        if (!wanted(o, &bench_steps[i]))
            continue;
        s->trainer.iteration = 0;
        if (i == 1)
            SPIN_TRY(spin_trainer_enable_lazy_adam(&s->trainer));
        for (int round = 0; round < o->rounds; round++)
            time_stage(&bench_steps[i], s, &timing[BENCH_STAGES + i], round);
    }
    if (!runs)
        print_head(s, log2_rows, intersections);
    for (int i = 0; i < BENCH_STAGES + BENCH_STEPS; i++) {
        const struct bench_stage *stage =
            i < BENCH_STAGES ? &bench_stages[i] : &bench_steps[i - BENCH_STAGES];
        struct row row;

        if (!wanted(o, stage))
            continue;
        if (timing[i].failed)
            return spin_fail(SPIN_E_DEVICE, "%s failed: %s", stage->name, spin_last_error());
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
        spin_json_set_integer(j, "tile_pairs", (int64_t)s->trainer.raster.tiles.n_intersections);
        spin_json_set(j, "stages", rows);
        spin_json_push(runs, j);
    }
    return SPIN_OK;
}

static spin_status run_all(const struct options *o, spin_json *ceilings, spin_json *runs)
{
    for (int t = 0; t < o->n_threads; t++) {
        struct bench_ceilings c = {0};

        if (strcmp(o->device, "cpu") == 0) {
            SPIN_TRY(bench_ceilings(o->threads[t], &c));
            if (o->json)
                spin_json_push(ceilings, ceilings_to_json(o->threads[t], &c));
            else
                print_ceilings(o->threads[t], &c);
        }
        for (int k = 0; k < o->n_tables; k++)
            for (int i = 0; i < o->n_sizes; i++) {
                struct bench_scene s;
                spin_status status;

                SPIN_TRY(bench_scene_open(o->device, (size_t)o->sizes[i], o->tables[k],
                                          o->threads[t], o->points, o->frame, &s));
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
           "  --device cpu          or cuda: then wall ms counts, and a stage ends when the card "
           "has done it\n"
           "  --threads 1,2         numbers of threads\n"
           "  --gaussians 10000,50000,200000\n"
           "  --table 19,21         log2 of the rows a level\n"
           "  --mode NAME           one stage:");
    for (int i = 0; i < BENCH_STAGES; i++)
        printf(" %s", bench_stages[i].name);
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
    bool known = strcmp(mode, bench_steps[0].name) == 0 || strcmp(mode, bench_steps[1].name) == 0;

    for (int i = 0; i < BENCH_STAGES; i++)
        known |= strcmp(mode, bench_stages[i].name) == 0;
    return known;
}

static bool read_options(int argc, char **argv, struct options *o)
{
    static const struct option known[] = {
        {"threads", 1, 0, 't'}, {"gaussians", 1, 0, 'g'}, {"table", 1, 0, 'k'},
        {"mode", 1, 0, 'm'},    {"rounds", 1, 0, 'r'},    {"points", 1, 0, 'p'},
        {"frame", 1, 0, 'f'},   {"json", 0, 0, 'j'},      {"help", 0, 0, 'h'},
        {"alone", 0, 0, 'a'},   {"device", 1, 0, 'd'},    {0, 0, 0, 0}};
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
        case 'd':
            o->device = optarg;
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
                        .rounds = 7,
                        .device = "cpu"};
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
