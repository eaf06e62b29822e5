/* An importer of points per frame, as text; each becomes a small isotropic Gaussian.
 *
 *     frame,x,y,z,red,green,blue          the first line; colours are 0 to 255
 *     0,0.5,1.0,-0.25,255,128,0           lines grouped by frame, frames in ascending order
 *
 * See spin-plugin(7); everything that is called here is declared in spin.h. */
#include <math.h>
#include <spin.h>
#include <stdlib.h>
#include <string.h>

static const char header[] = "frame,x,y,z,red,green,blue";

struct point {
    float place[3], colour[3];
};

struct run {
    struct point *point; /* [n], of all frames */
    size_t n;
    size_t *first, *counts; /* [n_frames] */
    int *numbers;
    int n_frames;
    float log_scale;
};

/* Certainty from the first bytes alone that the file is in this format. */
static int csv_probe(const struct spin_peek *peek)
{
    size_t n = strlen(header);

    return peek->n_head >= n && memcmp(peek->head, header, n) == 0 ? 90 : 0;
}

/* Grow an array of n items by one; its capacity doubles: 1, 2, 4, ... */
static bool grow(void **items, size_t n, size_t size)
{
    void *larger = n & (n - 1) ? *items : realloc(*items, (n ? 2 * n : 1) * size);

    if (larger)
        *items = larger;
    return larger != NULL;
}

static spin_status add_frame(struct run *run, int number)
{
    size_t n = (size_t)run->n_frames;

    if (!grow((void **)&run->first, n, sizeof *run->first) ||
        !grow((void **)&run->counts, n, sizeof *run->counts) ||
        !grow((void **)&run->numbers, n, sizeof *run->numbers))
        return spin_fail(SPIN_E_MEMORY, "no memory for %zu frames", n + 1);
    run->first[n] = run->n;
    run->counts[n] = 0;
    run->numbers[n] = number;
    run->n_frames++;
    return SPIN_OK;
}

static spin_status add_point(struct run *run, const char *path, size_t line, const char *text)
{
    struct point p;
    int number, end = 0, last = run->n_frames ? run->numbers[run->n_frames - 1] : -1;

    if (sscanf(text, "%d,%f,%f,%f,%f,%f,%f %n", &number, &p.place[0], &p.place[1], &p.place[2],
               &p.colour[0], &p.colour[1], &p.colour[2], &end) != 7 ||
        text[end])
        return spin_fail(SPIN_E_MALFORMED, "'%s' line %zu: expected %s", path, line, header);
    if (number < 0 || number < last)
        return spin_fail(SPIN_E_MALFORMED, "'%s' line %zu: frame %d comes after frame %d", path,
                         line, number, last);
    if (number != last)
        SPIN_TRY(add_frame(run, number));
    if (!grow((void **)&run->point, run->n, sizeof p))
        return spin_fail(SPIN_E_MEMORY, "no memory for %zu points", run->n + 1);
    run->point[run->n++] = p;
    run->counts[run->n_frames - 1]++;
    return SPIN_OK;
}

static spin_status read_lines(struct run *run, const char *path, FILE *file)
{
    char text[256];

    for (size_t line = 1; fgets(text, sizeof text, file); line++) {
        if (line == 1 && strncmp(text, header, strlen(header)) != 0)
            return spin_fail(SPIN_E_MALFORMED, "'%s' line 1: expected %s", path, header);
        if (line > 1)
            SPIN_TRY(add_point(run, path, line, text));
    }
    if (run->n == 0)
        return spin_fail(SPIN_E_MALFORMED, "'%s' has no points", path);
    return SPIN_OK;
}

static spin_status csv_open(const char *path, const struct spin_plugin_values *values, void **self,
                            struct spin_sequence_info *sequence)
{
    const char *size = spin_plugin_value(values, "size", "0.01");
    struct run *run = NULL;
    FILE *file;
    spin_status status;

    if (!(atof(size) > 0))
        return spin_fail(SPIN_E_USAGE, "--size '%s': expected a length above 0", size);
    file = fopen(path, "r");
    if (!file)
        return spin_fail(SPIN_E_NOT_FOUND, "cannot read '%s'", path);
    run = calloc(1, sizeof *run);
    *self = run; /* from here on close() frees it, also when open() fails */
    status = run ? read_lines(run, path, file) : spin_fail(SPIN_E_MEMORY, "no memory");
    fclose(file);
    SPIN_TRY(status);
    run->log_scale = logf((float)atof(size));
    sequence->n_frames = run->n_frames;
    sequence->numbers = run->numbers;
    sequence->counts = run->counts;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->sh_degree = 0;
    snprintf(sequence->variant, sizeof sequence->variant, "%zu points", run->n);
    return SPIN_OK;
}

static spin_status csv_frame(void *self, int frame, double time, unsigned columns,
                             struct spin_splats *out)
{
    const struct run *run = self;
    const struct point *p = run->point + run->first[frame];

    (void)time; /* the frames are discrete, not continuous in time */
    SPIN_TRY(spin_splats_reserve(out, run->counts[frame], columns, 0));
    for (size_t i = 0; i < out->n; i++) {
        for (int c = 0; c < 3; c++) {
            if (columns & SPIN_COL_MEANS)
                out->means[3 * i + c] = p[i].place[c];
            if (columns & SPIN_COL_LOG_SCALES)
                out->log_scales[3 * i + c] = run->log_scale;
            if (columns & SPIN_COL_SH) /* colour = 0.5 + 0.2820948 sh, of degree 0 */
                out->sh[3 * i + c] = (p[i].colour[c] / 255 - 0.5f) / 0.28209479f;
        }
        if (columns & SPIN_COL_QUATS)
            memcpy(out->quats + 4 * i, (float[]){1, 0, 0, 0}, 4 * sizeof(float));
        if (columns & SPIN_COL_LOGIT_OPACITIES)
            out->logit_opacities[i] = 4; /* 98 % */
    }
    return SPIN_OK;
}

static void csv_close(void *self)
{
    struct run *run = self;

    free(run->point);
    free(run->first);
    free(run->counts);
    free(run->numbers);
    free(run);
}

static const struct spin_plugin_option options[] = {
    {"size", "LENGTH", "standard deviation of a point, in the units of the file", "0.01"},
    {0},
};

static const struct spin_importer points_csv = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "points-csv",
    .summary = "coloured points per frame as text: frame,x,y,z,red,green,blue",
    .options = options,
    .probe = csv_probe,
    .open = csv_open,
    .frame = csv_frame,
    .close = csv_close,
};

/* The symbol that spin4d looks up. */
const struct spin_plugin spin_plugin = {
    .abi = SPIN_PLUGIN_ABI,
    .importers = (const struct spin_importer *const[]){&points_csv, NULL},
};
