/* Allocates, validates (spin_splats_4d_finish()), rounds and slices 4D splats. A slice is the frame
 * at one time. */
#include "scene/splats_4d.h"

#include "base/base.h"
#include "math/activate.h"
#include "math/drawable.h"
#include "math/motion.h"
#include "scene/bundle_pack.h"
#include "scene/columns.h"

/* Limit of the absolute values in most arrays. It is far below FLT_MAX, since splats move from
 * these positions along their paths, and since squares must not overflow. */
#define SANE 1e18
/* Precision of a half float just below 1: HALF_PER_UNIT values per unit, HALF_BITS significant
 * bits. */
#define HALF_PER_UNIT 0x1p11f
#define HALF_BITS 11

enum { PATHS = 1u << 31, ALWAYS = 0 };

static const struct {
    const char *name;
    size_t place;  /* offset of the pointer in struct spin_splats_4d */
    size_t width;  /* floats per row; 0: depends on a degree */
    unsigned part; /* enum spin_splats_4d_part, PATHS or ALWAYS */
    double most;   /* largest permitted absolute value */
    float steps;   /* rounding steps per unit for SPIN_ROUND_COMPACT; 0: never rounded */
} arrays[SPIN_N_ARRAYS_4D] = {
    {"centres", offsetof(struct spin_splats_4d, centres), 3, ALWAYS, SANE, 0},
    {"times", offsetof(struct spin_splats_4d, times), 1, ALWAYS, SANE, 0},
    {"quats", offsetof(struct spin_splats_4d, quats), 4, ALWAYS, SANE, 256},
    {"log_scales", offsetof(struct spin_splats_4d, log_scales), 3, ALWAYS, SANE, 32},
    {"logit_opacities", offsetof(struct spin_splats_4d, logit_opacities), 1, ALWAYS, SANE, 32},
    {"sigmas", offsetof(struct spin_splats_4d, sigmas), 1, ALWAYS, SPIN_FOREVER, 0},
    {"sh", offsetof(struct spin_splats_4d, sh), 0, ALWAYS, SANE, 128},
    {"paths", offsetof(struct spin_splats_4d, paths), 0, PATHS, SANE, 0},
    {"spins", offsetof(struct spin_splats_4d, spins), 4, SPIN_4D_SPINS, SANE, 0},
    {"plateaus", offsetof(struct spin_splats_4d, plateaus), 3, SPIN_4D_PLATEAUS, SPIN_FOREVER, 0},
    {"cuts", offsetof(struct spin_splats_4d, cuts), 2, SPIN_4D_CUTS, SPIN_FOREVER, 0},
    {"gates", offsetof(struct spin_splats_4d, gates), 1, SPIN_4D_GATES, SANE, 0},
    {"sh_cos", offsetof(struct spin_splats_4d, sh_cos), 0, SPIN_4D_SH_COS, SANE, 128},
};

/* ---- Arrays ---------------------------------------------------------------------------------- */

const char *spin_array_4d_name(int k) { return arrays[k].name; }

float **spin_array_4d_of(struct spin_splats_4d *s, int k)
{
    return (float **)(void *)((char *)s + arrays[k].place);
}

static size_t sh_width(const struct spin_splats_4d *s)
{
    return 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
}

float spin_array_4d_per_unit(int k, enum spin_round_4d round)
{
    if (round == SPIN_ROUND_NOTHING || !(arrays[k].steps > 0))
        return 0;
    return round == SPIN_ROUND_HALF ? HALF_PER_UNIT : arrays[k].steps;
}

size_t spin_array_4d_width(const struct spin_splats_4d *s, int k)
{
    if (arrays[k].width)
        return arrays[k].width;
    return arrays[k].part == PATHS ? 3 * (size_t)s->degree
           : arrays[k].part        ? 2 * sh_width(s)
                                   : sh_width(s);
}

bool spin_array_4d_in(const struct spin_splats_4d *s, int k, unsigned parts)
{
    return arrays[k].part == PATHS ? s->degree > 0
                                   : arrays[k].part == ALWAYS || (parts & arrays[k].part) != 0;
}

unsigned spin_array_4d_part(const char *name)
{
    for (int k = 0; k < SPIN_N_ARRAYS_4D; k++)
        if (arrays[k].part != PATHS && strcmp(arrays[k].name, name) == 0)
            return arrays[k].part;
    return 0;
}

unsigned spin_splats_4d_parts(const struct spin_splats_4d *s)
{
    struct spin_splats_4d of = *s;
    unsigned parts = 0;

    for (int k = 0; k < SPIN_N_ARRAYS_4D; k++)
        parts |= *spin_array_4d_of(&of, k) && arrays[k].part != PATHS ? arrays[k].part : 0;
    return parts;
}

spin_status spin_splats_4d_reserve(struct spin_splats_4d *s, size_t n, int degree, int sh_degree,
                                   unsigned parts)
{
    if (degree < 0 || degree > 3 || sh_degree < 0 || sh_degree > 3)
        return spin_unsupported("paths of degree %d, SH of degree %d: expected 0..3", degree,
                                sh_degree);
    s->n = 0;
    s->degree = degree;
    s->sh_degree = sh_degree;
    for (int k = 0; k < SPIN_N_ARRAYS_4D; k++)
        if (spin_array_4d_in(s, k, parts))
            SPIN_TRY(spin_alloc(n ? n : 1, spin_array_4d_width(s, k) * sizeof(float),
                                (void **)spin_array_4d_of(s, k)));
    SPIN_TRY(spin_alloc(n ? n : 1, 2 * sizeof *s->spans, (void **)&s->spans));
    s->n = n;
    return SPIN_OK;
}

void spin_splats_4d_free(struct spin_splats_4d *s)
{
    for (int k = 0; k < SPIN_N_ARRAYS_4D; k++)
        free(*spin_array_4d_of(s, k));
    free(s->spans);
    *s = (struct spin_splats_4d){0};
}

struct spin_splats spin_splats_of_4d(const struct spin_splats_4d *s)
{
    return (struct spin_splats){.n = s->n,
                                .capacity = s->n,
                                .sh_degree = s->sh_degree,
                                .means = s->centres,
                                .quats = s->quats,
                                .log_scales = s->log_scales,
                                .logit_opacities = s->logit_opacities,
                                .sh = s->sh};
}

/* ---- Validation ------------------------------------------------------------------------------ */

static struct spin_window window_of(const struct spin_splats_4d *s, size_t i)
{
    const float *p = s->plateaus ? s->plateaus + 3 * i : NULL;
    struct spin_window w = {
        .lo = (double)(p ? p[0] : s->times[i]),
        .hi = (double)(p ? p[1] : s->times[i]),
        .sigma = (double)s->sigmas[i],
        .sigma2 = (double)(p ? p[2] : s->sigmas[i]),
        .gate = s->gates ? (double)s->gates[i] : 0,
        .first = s->cuts ? (double)s->cuts[2 * i] : -HUGE_VAL,
        .end = s->cuts ? (double)s->cuts[2 * i + 1] : HUGE_VAL,
    };

    return w;
}

/* Normalises the rotation of a row, and scales its spin by the same factor. Returns false if the
 * rotation is so short that the spin would overflow. */
static bool normalise_rotation(float *quat, float *spin, double length)
{
    for (size_t c = 0; c < 4; c++) {
        quat[c] = (float)((double)quat[c] / length);
        if (!spin)
            continue;
        spin[c] = (float)((double)spin[c] / length);
        if (!isfinite(spin[c]))
            return false;
    }
    return true;
}

/* Returns whether all values of a row are finite and in range, and its rotation and Gaussian window
 * are valid. Normalises the rotation of a valid row. */
static bool validate_row(struct spin_splats_4d *s, size_t i)
{
    double length = 0;

    for (int k = 0; k < SPIN_N_ARRAYS_4D; k++) {
        const float *values = *spin_array_4d_of(s, k);
        size_t width = values ? spin_array_4d_width(s, k) : 0;

        for (size_t c = 0; c < width; c++)
            if (!(fabs((double)values[width * i + c]) <= arrays[k].most))
                return false;
    }
    for (size_t c = 0; c < 3; c++)
        if (s->log_scales[3 * i + c] > SPIN_LOG_SCALE_MOST)
            return false;
    for (size_t c = 0; c < 4; c++)
        length += (double)s->quats[4 * i + c] * (double)s->quats[4 * i + c];
    if (!(length > 0) || !(s->sigmas[i] > 0) ||
        (s->plateaus &&
         (!(s->plateaus[3 * i + 2] > 0) || !(s->plateaus[3 * i + 1] >= s->plateaus[3 * i]))) ||
        (s->gates && !(s->gates[i] >= 0 && s->gates[i] <= 1)))
        return false;
    return normalise_rotation(s->quats + 4 * i, s->spins ? s->spins + 4 * i : NULL, sqrt(length));
}

void spin_splats_4d_round(struct spin_splats_4d *s, enum spin_round_4d round)
{
    for (int k = 0; k < SPIN_N_ARRAYS_4D; k++) {
        float *values = *spin_array_4d_of(s, k), per_unit = spin_array_4d_per_unit(k, round);

        if (values && per_unit > 0)
            spin_round_values(values, s->n * spin_array_4d_width(s, k), HALF_BITS, 1 / per_unit);
    }
}

static void move_row(struct spin_splats_4d *s, size_t from, size_t to)
{
    for (int k = 0; k < SPIN_N_ARRAYS_4D && from != to; k++) {
        float *values = *spin_array_4d_of(s, k);
        size_t width = values ? spin_array_4d_width(s, k) : 0;

        if (values)
            memcpy(values + width * to, values + width * from, width * sizeof *values);
    }
}

static void span_of(const struct spin_splats_4d *s, size_t i, double span[2])
{
    struct spin_window w = window_of(s, i);
    double opacity = spin_sigmoid_of((double)s->logit_opacities[i]);

    spin_window_span(
        &w, fmax(s->least_weight, s->least_opacity > 0 ? s->least_opacity / opacity : 0), span);
}

bool spin_splats_4d_is_finished(const struct spin_splats_4d *s)
{
    for (size_t i = 0; i < s->n; i++) {
        double span[2];

        span_of(s, i, span);
        if (span[0] != s->spans[2 * i] || span[1] != s->spans[2 * i + 1])
            return false;
    }
    return true;
}

spin_status spin_splats_4d_finish(struct spin_splats_4d *s, size_t *n_dropped, size_t *from)
{
    size_t kept = 0;

    if (s->sh_cos && !(s->period > 0 && isfinite(s->period)))
        return spin_malformed(
            "time-varying colours have a period of %g, expected a positive number", s->period);
    for (size_t i = 0; i < s->n; i++) {
        if (!validate_row(s, i))
            continue;
        move_row(s, i, kept);
        if (from)
            from[kept] = i;
        span_of(s, kept, s->spans + 2 * kept);
        kept++;
    }
    *n_dropped = s->n - kept;
    s->n = kept;
    return SPIN_OK;
}

spin_status spin_splats_4d_select(const struct spin_splats_4d *s, const unsigned char *mark,
                                  struct spin_splats_4d *out)
{
    struct spin_splats_4d from = *s;
    size_t n = 0;

    for (size_t i = 0; i < s->n; i++)
        n += mark[i];
    *out = *s;
    out->spans = NULL;
    for (int k = 0; k < SPIN_N_ARRAYS_4D; k++)
        *spin_array_4d_of(out, k) = NULL;
    SPIN_TRY(spin_splats_4d_reserve(out, n, s->degree, s->sh_degree, spin_splats_4d_parts(s)));
    for (int k = 0; k < SPIN_N_ARRAYS_4D; k++) {
        const float *at = *spin_array_4d_of(&from, k);

        if (at)
            spin_rows_select(at, s->n, spin_array_4d_width(s, k), mark, *spin_array_4d_of(out, k));
    }
    n = 0;
    for (size_t i = 0; i < s->n; i++)
        if (mark[i])
            memcpy(out->spans + 2 * n++, s->spans + 2 * i, 2 * sizeof *out->spans);
    return SPIN_OK;
}

/* ---- Slices ---------------------------------------------------------------------------------- */

double spin_splats_4d_weight(const struct spin_splats_4d *s, size_t i, double time)
{
    struct spin_window w = window_of(s, i);

    return spin_window_at(&w, time);
}

static void fill_row(const struct spin_splats_4d *s, size_t i, double time, unsigned columns,
                     struct spin_splats *out, size_t k)
{
    double d = time - (double)s->times[i], place[3];
    size_t width = sh_width(s);

    if (columns & SPIN_COL_MEANS) {
        spin_path_at(s->centres + 3 * i, s->paths ? s->paths + 3 * (size_t)s->degree * i : NULL,
                     s->degree, d, place);
        for (size_t c = 0; c < 3; c++)
            out->means[3 * k + c] = (float)place[c];
    }
    if (columns & SPIN_COL_QUATS) {
        double q[4], length = 0;

        for (size_t c = 0; c < 4; c++) {
            q[c] = (double)s->quats[4 * i + c] + (s->spins ? d * (double)s->spins[4 * i + c] : 0);
            length += q[c] * q[c];
        }
        for (size_t c = 0; c < 4; c++)
            out->quats[4 * k + c] = length > 0 ? (float)(q[c] / sqrt(length)) : s->quats[4 * i + c];
    }
    if (columns & SPIN_COL_LOG_SCALES)
        memcpy(out->log_scales + 3 * k, s->log_scales + 3 * i, 3 * sizeof(float));
    if (columns & SPIN_COL_LOGIT_OPACITIES) {
        out->logit_opacities[k] = spin_logit_of(spin_splats_4d_weight(s, i, time) *
                                                spin_sigmoid_of((double)s->logit_opacities[i]));
    }
    if (!(columns & SPIN_COL_SH))
        return;
    for (size_t c = 0; c < width; c++) {
        const float *cosine = s->sh_cos ? s->sh_cos + 2 * width * i + c : NULL;
        double turn = cosine ? 6.283185307179586 * d / s->period : 0;

        out->sh[width * k + c] =
            cosine ? (float)((double)s->sh[width * i + c] + cos(turn) * (double)cosine[0] +
                             cos(2 * turn) * (double)cosine[width])
                   : s->sh[width * i + c];
    }
}

bool spin_splats_4d_is_visible(const struct spin_splats_4d *s, size_t i, double time)
{
    return s->spans[2 * i] <= time && time <= s->spans[2 * i + 1];
}

spin_status spin_splats_4d_slice(const struct spin_splats_4d *s, double time, unsigned columns,
                                 struct spin_splats *out)
{
    size_t n = 0, k = 0;

    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    for (size_t i = 0; i < s->n; i++)
        n += spin_splats_4d_is_visible(s, i, time);
    SPIN_TRY(spin_splats_reserve(out, n, columns, s->sh_degree));
    out->antialias = s->antialias;
    for (size_t i = 0; i < s->n; i++)
        if (spin_splats_4d_is_visible(s, i, time))
            fill_row(s, i, time, columns, out, k++);
    if (columns & SPIN_COL_MEANS && spin_finite_missing(out->means, 3 * n) > 0)
        return spin_malformed("positions are not finite at time %g", time);
    return SPIN_OK;
}

/* Returns the index of the first of the sorted times that is equal to t or later. */
static size_t first_at(const double *sorted, size_t n, double t)
{
    size_t low = 0, high = n;

    while (low < high) {
        size_t middle = (low + high) / 2;

        if (sorted[middle] < t)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

spin_status spin_splats_4d_counts(const struct spin_splats_4d *s, const double *times, size_t n,
                                  size_t *counts)
{
    SPIN_FREED double *sorted = NULL;
    int64_t sum = 0;
    SPIN_FREED int64_t *change = NULL;

    SPIN_TRY(spin_alloc(n, sizeof *sorted, (void **)&sorted));
    SPIN_TRY(spin_alloc(n + 1, sizeof *change, (void **)&change));
    memcpy(sorted, times, n * sizeof *sorted);
    qsort(sorted, n, sizeof *sorted, spin_by_double);
    for (size_t i = 0; i < s->n; i++) {
        if (!(s->spans[2 * i] <= s->spans[2 * i + 1]))
            continue;
        change[first_at(sorted, n, s->spans[2 * i])]++;
        change[first_at(sorted, n, nextafter(s->spans[2 * i + 1], HUGE_VAL))]--;
    }
    for (size_t k = 0; k < n; k++)
        change[k] = sum += change[k];
    for (size_t k = 0; k < n; k++) /* times[] may be unsorted */
        counts[k] = (size_t)change[first_at(sorted, n, times[k])];
    return SPIN_OK;
}
