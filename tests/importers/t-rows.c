/* 4D splats compared with frames: for every fixture of every importer that returns both, slices
 * of the rows equal the rows of frame(), in their order. Errors are printed; docs/importers.md
 * states the largest.
 * K: import realtime4dgs hybrid4dgs rotor4dgs spacetimegs ex4dgs omg4 */
#include "base/number.h"
#include "math/motion.h"
#include "tests/importers/models.h"

/* Tolerances between a frame and a slice. */
struct errors {
    double place;    /* over 1 + the position */
    double rotation; /* degrees */
    double opacity, sh;
};

/* Importers whose frames are more than slices; at a row's own time they agree exactly. */
static const struct {
    const char *name;
    struct errors bound;
} bounds[] = {
    {"ex4dgs", {1e-6, 0.12, 1e-6, 0}},
    {"omg4", {1e-6, 1e-3, 1, 100}}, /* its networks are not in the rows */
};
static const struct errors exact = {1e-6, 1e-4, 1e-6, 1e-5};

static struct errors bound_of(const char *name)
{
    for (size_t i = 0; i < sizeof bounds / sizeof *bounds; i++)
        if (strcmp(bounds[i].name, name) == 0)
            return bounds[i].bound;
    return exact;
}

static double sigmoid_at(const struct spin_splats *s, size_t i)
{
    return sigmoid((double)s->logit_opacities[i]);
}

/* Of row i of the frame and row k of the slice. */
static struct errors errors_of(const struct spin_splats *frame, size_t i,
                               const struct spin_splats *slice, size_t k)
{
    struct errors e = {0, 0, fabs(sigmoid_at(frame, i) - sigmoid_at(slice, k)), 0};
    size_t width = 3 * (size_t)((frame->sh_degree + 1) * (frame->sh_degree + 1));
    double apart[2] = {0, 0};

    for (size_t c = 0; c < 3; c++) {
        double x = (double)frame->means[3 * i + c];

        e.place = larger(e.place, fabs(x - (double)slice->means[3 * k + c]) / (1 + fabs(x)));
    }
    for (size_t c = 0; c < 4; c++) {
        double a = (double)frame->quats[4 * i + c], b = (double)slice->quats[4 * k + c];

        apart[0] += (a - b) * (a - b);
        apart[1] += (a + b) * (a + b);
    }
    e.rotation = 4 * asin(fmin(sqrt(fmin(apart[0], apart[1])) / 2, 1)) * 180 / 3.141592653589793;
    for (size_t c = 0; c < width; c++)
        e.sh = larger(e.sh, fabs((double)frame->sh[width * i + c] - slice->sh[width * k + c]));
    return e;
}

static void widen(struct errors *to, const struct errors *e)
{
    to->place = larger(to->place, e->place);
    to->rotation = larger(to->rotation, e->rotation);
    to->opacity = larger(to->opacity, e->opacity);
    to->sh = larger(to->sh, e->sh);
}

static bool within(const struct errors *e, const struct errors *bound)
{
    return e->place <= bound->place && e->rotation <= bound->rotation &&
           e->opacity <= bound->opacity && e->sh <= bound->sh;
}

static bool same_splat(const struct spin_splats *frame, size_t i, const struct spin_splats *slice,
                       size_t k)
{
    return memcmp(frame->log_scales + 3 * i, slice->log_scales + 3 * k, 3 * sizeof(float)) == 0 &&
           errors_of(frame, i, slice, k).place <= 1e-6;
}

/* The errors of all rows at a time, or of row `only` of the slice unless that is SIZE_MAX.
 * Returns false if the rows differ; rows of the frame may be missing only if they are invisible. */
static bool compare_at(struct run *run, const struct spin_splats_4d *rows, double time, size_t only,
                       struct errors *out)
{
    struct spin_splats frame = {0}, slice = {0};
    unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    bool good = run->importer->frame(run->self, 0, time, columns, &frame) == SPIN_OK &&
                spin_splats_4d_slice(rows, time, columns, &slice) == SPIN_OK &&
                frame.sh_degree == slice.sh_degree && frame.antialias == slice.antialias;
    size_t k = 0;

    for (size_t i = 0; good && i < frame.n; i++) {
        if (k < slice.n && same_splat(&frame, i, &slice, k)) {
            struct errors e = errors_of(&frame, i, &slice, k);

            if (only == SIZE_MAX || only == k)
                widen(out, &e);
            k++;
        } else if (sigmoid_at(&frame, i) >= 1.0 / 255) {
            printf("#   time %g, row %zu of the frame is not in the slice\n", time, i);
            good = false;
        }
    }
    if (good && k < slice.n)
        printf("#   time %g: %zu rows of the slice, %zu of them in the frame\n", time, slice.n, k);
    good = good && k == slice.n;
    spin_splats_free(&frame);
    spin_splats_free(&slice);
    return good;
}

/* Some rows at their own times, where they equal the method's result in any case. */
static bool compare_own(struct run *run, const struct spin_splats_4d *rows, struct errors *out)
{
    bool good = true;

    for (size_t step = rows->n / 40 + 1, i = step / 2; i < rows->n && good; i += step) {
        double time = (double)rows->times[i];
        size_t k = 0;

        if (time < run->sequence.time_first || time > run->sequence.time_last ||
            !spin_splats_4d_is_visible(rows, i, time))
            continue;
        for (size_t before = 0; before < i; before++)
            k += spin_splats_4d_is_visible(rows, before, time);
        good = compare_at(run, rows, time, k, out);
    }
    return good;
}

/* The times at which some rows begin and end, and just before: no gap, and no row twice. */
static bool compare_cuts(struct run *run, const struct spin_splats_4d *rows, struct errors *out)
{
    size_t n = rows->cuts ? 2 * rows->n : 0;
    bool good = true;

    for (size_t i = 0; i < n && good; i += n / 80 + 1) {
        double times[] = {(double)rows->cuts[i], (double)nextafterf(rows->cuts[i], -SPIN_FOREVER)};

        for (int k = 0; k < 2 && good; k++)
            if (times[k] >= run->sequence.time_first && times[k] <= run->sequence.time_last)
                good = compare_at(run, rows, times[k], SIZE_MAX, out);
    }
    return good;
}

static void compare_run(struct run *run, const struct spin_splats_4d *rows, const char *name,
                        struct errors *worst)
{
    static const double parts[] = {0, 0.23, 0.5, 0.77, 1};
    double first = run->sequence.time_first, last = run->sequence.time_last;
    struct errors e = {0}, own = {0}, bound = bound_of(run->importer->name);
    bool good = true;

    for (int i = 0; i < 5; i++)
        good = good && compare_at(run, rows, first + parts[i] * (last - first), SIZE_MAX, &e);
    good = good && compare_cuts(run, rows, &e);
    ok(good && within(&e, &bound),
       "%s: %zu rows, place %.2g, rotation %.2g degrees, opacity %.2g, SH %.2g", name, rows->n,
       e.place, e.rotation, e.opacity, e.sh);
    good = compare_own(run, rows, &own);
    ok(good && within(&own, &exact),
       "%s: at their own times place %.2g, rotation %.2g degrees, opacity %.2g, SH %.2g", name,
       own.place, own.rotation, own.opacity, own.sh);
    widen(worst, &e);
}

/* The run of this importer in a fixture: the folder, or one in it. */
static const char *run_in(const struct spin_importer *importer, const char *folder)
{
    static const char *const names[] = {"", "model", "run", "output", "scene.ply"};
    const struct spin_importer *found;

    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        const char *path = *names[i] ? path_in(folder, names[i]) : folder;

        if (spin_path_exists(path) && spin_importer_find(path, NULL, false, &found) == SPIN_OK &&
            found == importer)
            return path;
    }
    return NULL;
}

static void compare_importer(const struct spin_importer *importer)
{
    /* Those of a network are no rows. */
    static const char *const base[] = {"colour", "base", NULL};
    const char *const *pairs = strcmp(importer->name, "spacetimegs") == 0 ? base : NULL;
    const char **cases = check_cases(importer->name, "manifest.json");
    const char *root = check_fixture(importer->name);
    struct errors worst = {0};
    int n = 0;

    for (size_t i = 0; cases && cases[i]; i++) {
        const char *path = run_in(importer, path_in(root, cases[i]));
        const struct spin_splats_4d *rows = NULL;
        struct run run;

        if (!path || model_open(importer->name, path, pairs, &run) != SPIN_OK)
            continue;
        if (run.sequence.continuous && importer->splats_4d(run.self, &rows) == SPIN_OK && rows &&
            rows->n > 0) {
            compare_run(&run, rows, path, &worst);
            n++;
        }
        run_close(&run);
    }
    ok(n > 0, "%s: %d runs, at most: place %.2g, rotation %.2g degrees, opacity %.2g, SH %.2g",
       importer->name, n, worst.place, worst.rotation, worst.opacity, worst.sh);
    free(cases);
}

TAP_MAIN
{
    const struct spin_importer *const *all = spin_importer_list();

    for (; *all; all++)
        if ((*all)->splats_4d)
            compare_importer(*all);
}
