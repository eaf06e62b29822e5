#include "exporters/lib/page_rows.h"

#include "base/base.h"
#include "io/compress.h"
#include "math/activate.h"
#include "math/motion.h"

#define LN2 0.693147180559945309
#define TURN 6.283185307179586 /* radians of a full turn */
#define NARROWER 0.999         /* must be equal to NARROWER in page_values.c */
#define FAINT (0.5 / 255)      /* splats of a smaller opacity are invisible */
#define UNEVEN 1e-5 /* tolerance of rounded frame times, as a share of the time between frames */
/* Dot product of the unit quaternions of two rotations that are 90 degrees apart. */
#define LEAST_DOT 0.707
enum { CHECKED = 33 }; /* number of evenly spaced ticks at which a row is checked */

/* The error bound of an opacity is divided among the quantised values of its window. HEIGHT: for
 * the opacity at the window's centre; WIDTH: for the time of the centre and again for the sigma;
 * GATE: for the gate. With w = exp(-z^2/2), the error of the window is at most w (HEIGHT + z WIDTH
 * + z^2 WIDTH) times the bound, and that of the gate at most (1 - w) GATE times the bound. Their
 * sum is below the bound for all z. */
#define HEIGHT 0.5
#define WIDTH 0.45
#define GATE 0.3
/* Shares of the error bound of a rotation. ENDS: for the rotations at the two ends of a piece.
 * RATIO: for the ratio of the lengths of the two quaternions. Between the ends, the error stays
 * within the bound if the rotations at the ends are at most 90 degrees apart. */
#define ENDS 0.78
#define RATIO 0.1
/* Shares of the error bound of a colour that changes over time: for its mean, for each of its two
 * cosines, and for the phase of the cosines. */
#define MEAN 0.4
#define COSINE 0.2
#define PHASE 0.2

enum { FROM, LENGTH, SIGMA, MIDDLE, N_ALWAYS };

/* A piece of a row: its ticks from `from` to `end` - 1. Most rows have a single piece. */
struct piece {
    uint32_t row;
    int32_t from, end;
};

/* ---- Steps ----------------------------------------------------------------------------------- */

bool spin_page_rows_can(const double *times, int n_frames, double *step)
{
    *step = n_frames > 1 ? (times[n_frames - 1] - times[0]) / (n_frames - 1) : 0;
    for (int f = 0; f < n_frames; f++)
        if (!(fabs(times[f] - (times[0] + f * *step)) <= UNEVEN * *step))
            return false;
    return *step > 0;
}

static const float *cosines_of(const struct spin_page_rows *r, size_t i)
{
    return r->splats->sh_cos + 6 * (size_t)spin_sh_count(r->splats->sh_degree) * i;
}

/* Returns the coefficient of cosine k, 0 or 1, of row i in column c. Columns 0 to 2 are colours,
 * the others SH coefficients in the order of the file. */
static double cosine_at(const struct spin_page_rows *r, size_t i, int k, int c)
{
    size_t width = 3 * (size_t)spin_sh_count(r->splats->sh_degree);
    double v = (double)cosines_of(r, i)[(size_t)k * width + (size_t)c];

    return c < 3 ? SPIN_SH_C0 * v : v;
}

/* Returns the largest derivative of a colour or SH coefficient with respect to the phase in
 * radians, as a multiple of the bound of this value. */
static double steepest(const struct spin_page_rows *r)
{
    double most = 0;

    for (size_t i = 0; i < r->splats->n; i++)
        for (int c = 0; c < 3 + r->n_sh; c++)
            most = fmax(most, (fabs(cosine_at(r, i, 0, c)) + 2 * fabs(cosine_at(r, i, 1, c))) /
                                  (c < 3 ? r->space.bounds.colour : r->space.bounds.sh));
    return most;
}

void spin_page_rows_begin(struct spin_page_rows *r)
{
    /* Lebesgue constants of interpolation at evenly spaced nodes, indexed by the degree: upper
     * limits of the largest error between the nodes, divided by the largest error at the nodes. */
    static const double lebesgue[] = {1, 1, 1.25, 1.64};
    const struct spin_splats_4d *s = r->splats;
    const struct spin_page_bounds *b = &r->space.bounds;
    int at = SPIN_PAGE_SH + r->n_sh + N_ALWAYS;

    r->inner = r->space;
    r->inner.bounds.place /= lebesgue[s->degree];
    r->inner.bounds.opacity *= HEIGHT;
    r->octave = (int)ceil(LN2 / (2 * WIDTH * NARROWER * b->opacity));
    r->middle = 2 * WIDTH * NARROWER * b->opacity;
    r->plateau = s->plateaus ? at : 0;
    at += s->plateaus ? 2 : 0;
    r->path = s->degree ? at : 0;
    at += 3 * s->degree;
    r->gates = s->gates ? at : 0;
    at += s->gates ? 1 : 0;
    r->turn = s->spins ? at : 0;
    at += s->spins ? 4 : 0;
    r->cosines = s->sh_cos ? at : 0;
    at += s->sh_cos ? 1 + 2 * (3 + r->n_sh) : 0;
    r->n_columns = at;
    if (s->gates)
        r->gate = 2 * GATE * b->opacity;
    if (s->spins) {
        r->inner.bounds.rotation *= ENDS;
        /* An error e of the logarithm of the ratio changes the rotations between the ends by at
         * most about e / 4 times the angle between the two ends. */
        r->ratio = 4 * RATIO * b->rotation;
    }
    if (s->sh_cos) {
        r->inner.bounds.colour *= MEAN;
        r->inner.bounds.sh *= MEAN;
        r->cosine = 2 * COSINE * NARROWER * b->colour;
        r->cosine_sh = 2 * COSINE * NARROWER * b->sh;
        r->phase = fmin(2 * PHASE / fmax(steepest(r), 1e-9), 1);
    }
}

spin_json *spin_page_rows_json(const struct spin_page_rows *r)
{
    const struct spin_splats_4d *s = r->splats;
    spin_json *j = spin_json_object();

    spin_json_set_integer(j, "ticks", SPIN_PAGE_TICKS);
    spin_json_set_integer(j, "degree", s->degree);
    spin_json_set_integer(j, "octave", r->octave);
    spin_json_set_number(j, "middle", r->middle);
    spin_json_set_bool(j, "plateaus", s->plateaus != NULL);
    if (s->gates)
        spin_json_set_number(j, "gate", r->gate);
    if (s->spins)
        spin_json_set_number(j, "ratio", r->ratio);
    if (s->sh_cos) {
        spin_json_set_number(j, "period", s->period / r->step);
        spin_json_set_number(j, "phase", r->phase);
        spin_json_set_number(j, "cosine", r->cosine);
        spin_json_set_number(j, "cosine_sh", r->cosine_sh);
    }
    return j;
}

/* ---- Time ------------------------------------------------------------------------------------ */

static double time_of(const struct spin_page_rows *r, double tick)
{
    double frame = tick / SPIN_PAGE_TICKS;
    int whole = (int)frame;

    return frame == whole && whole < r->n_frames ? r->times[whole] : r->times[0] + frame * r->step;
}

static double frames_of(const struct spin_page_rows *r, double time)
{
    return (time - r->times[0]) / r->step;
}

static double opacity_at(const struct spin_page_rows *r, size_t i, double t)
{
    return spin_sigmoid_of((double)r->splats->logit_opacities[i]) *
           spin_splats_4d_weight(r->splats, i, t);
}

/* A window has the value 1 from time lo to time hi. Its sides are Gaussian, with a standard
 * deviation of sigma before lo and of sigma2 after hi. */
struct window {
    double lo, hi, sigma, sigma2;
};

static struct window window_of(const struct spin_page_rows *r, size_t i)
{
    const struct spin_splats_4d *s = r->splats;
    const float *p = s->plateaus ? s->plateaus + 3 * i : NULL;

    return (struct window){.lo = (double)(p ? p[0] : s->times[i]),
                           .hi = (double)(p ? p[1] : s->times[i]),
                           .sigma = (double)s->sigmas[i],
                           .sigma2 = (double)(p ? p[2] : s->sigmas[i])};
}

/* Sets *p to the ticks of the clip in which row i is visible. Returns false if there are none. */
static bool find_ticks(const struct spin_page_rows *r, size_t i, struct piece *p)
{
    const struct spin_splats_4d *s = r->splats;
    double opacity = spin_sigmoid_of((double)s->logit_opacities[i]), from, to;
    double faint = fmin(FAINT, 0.5 * r->space.bounds.opacity), slack = 2 * UNEVEN * SPIN_PAGE_TICKS;
    int last = (r->n_frames - 1) * SPIN_PAGE_TICKS;

    from = fmax(s->spans[2 * i], r->times[0]);
    to = fmin(s->spans[2 * i + 1], time_of(r, last));
    if (!s->gates || !(s->gates[i] > 0)) {
        struct window w = window_of(r, i);
        double reach = opacity > faint ? sqrt(2 * log(opacity / faint)) : -1;

        if (reach < 0)
            return false;
        from = fmax(from, w.lo - reach * w.sigma);
        to = fmin(to, w.hi + reach * w.sigma2);
    }
    if (!(from <= to))
        return false;
    p->row = (uint32_t)i;
    p->from = (int32_t)ceil(frames_of(r, from) * SPIN_PAGE_TICKS - slack);
    p->end = (int32_t)floor(frames_of(r, to) * SPIN_PAGE_TICKS + slack) + 1;
    while (p->from < p->end && !spin_splats_4d_is_visible(s, i, time_of(r, p->from)))
        p->from++;
    while (p->from < p->end && !spin_splats_4d_is_visible(s, i, time_of(r, p->end - 1)))
        p->end--;
    return p->from < p->end;
}

/* ---- Rotations ------------------------------------------------------------------------------- */

/* Sets q to the rotation of row i at time t, as a quaternion that is not normalised. */
static void turned_at(const struct spin_page_rows *r, size_t i, double t, double q[4])
{
    const struct spin_splats_4d *s = r->splats;

    for (size_t c = 0; c < 4; c++)
        q[c] = (double)s->quats[4 * i + c] +
               (s->spins ? (t - (double)s->times[i]) * (double)s->spins[4 * i + c] : 0);
}

static double length_of(const double q[4])
{
    return sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
}

static bool unit_of(const double q[4], double out[4])
{
    double length = length_of(q);

    for (int c = 0; c < 4; c++)
        out[c] = length > 0 ? q[c] / length : c == 0;
    return length > 0;
}

/* Sets a and b to the rotations at both ends of a piece and returns the dot product of the
 * normalised quaternions. A piece of a single tick cannot be split: if its ends are more than 90
 * degrees apart, b is set to a. */
static double ends_of(const struct spin_page_rows *r, const struct piece *p, double a[4],
                      double b[4])
{
    double u[4], v[4], dot = 0;

    turned_at(r, p->row, time_of(r, p->from), a);
    turned_at(r, p->row, time_of(r, p->end), b);
    if (unit_of(a, u) && unit_of(b, v))
        for (int c = 0; c < 4; c++)
            dot += u[c] * v[c];
    if (dot < LEAST_DOT && p->end - p->from == 1)
        memcpy(b, a, 4 * sizeof *b);
    return dot;
}

/* ---- Numbers --------------------------------------------------------------------------------- */

static bool quantise(int32_t *key, double x)
{
    if (!(fabs(x) < SPIN_PAGE_MOST - 1))
        return false;
    *key = (int32_t)(x < 0 ? x - 0.5 : x + 0.5);
    return true;
}

static int32_t *extra_columns(const struct spin_page_rows *r, int32_t *key)
{
    return key + SPIN_PAGE_SH + r->n_sh;
}

static double half_of(const int32_t *extra) { return 0.5 * extra[LENGTH] / SPIN_PAGE_TICKS; }

static double centre_of(const int32_t *extra)
{
    return ((double)extra[FROM] + 0.5 * extra[LENGTH]) / SPIN_PAGE_TICKS;
}

/* Returns the exponent of a coded sigma. Code 0 means that the window does not fade, so exponents
 * of 0 or more are coded with an offset of 1. */
static int32_t exponent_of(int32_t number) { return number > 0 ? number - 1 : number; }

static double octave_of(const struct spin_page_rows *r, const int32_t *extra, int32_t number)
{
    return half_of(extra) * exp2(floor((double)exponent_of(number) / r->octave));
}

static bool quantise_side(const struct spin_page_rows *r, const int32_t *extra, double sigma,
                          double middle, int32_t *number, int32_t *at)
{
    if (!quantise(number, r->octave * log2(sigma / half_of(extra))))
        return false;
    if (*number >= 0)
        ++*number;
    return quantise(at, (middle - centre_of(extra)) / (r->middle * octave_of(r, extra, *number)));
}

/* Quantises the window of a piece, and sets *opacity to the opacity that the window multiplies. If
 * the product of opacity and window hardly varies within the piece, sets *opacity to the middle of
 * the product's range and stores no window. */
static bool number_window(const struct spin_page_rows *r, const struct piece *p, int32_t *key,
                          double *opacity)
{
    struct window w = window_of(r, p->row);
    double from = time_of(r, p->from), to = time_of(r, p->end - 1);
    double most = opacity_at(r, p->row, fmin(fmax(w.lo, from), fmin(to, fmax(w.hi, from))));
    double least = fmin(opacity_at(r, p->row, from), opacity_at(r, p->row, to));
    int32_t *extra = extra_columns(r, key);

    if (most - least <= HEIGHT * r->space.bounds.opacity) {
        *opacity = 0.5 * (most + least);
        return true;
    }
    *opacity = spin_sigmoid_of((double)r->splats->logit_opacities[p->row]);
    if (r->gates && !quantise(&key[r->gates], (double)r->splats->gates[p->row] / r->gate))
        return false;
    w = (struct window){frames_of(r, w.lo), frames_of(r, w.hi), w.sigma / r->step,
                        w.sigma2 / r->step};
    if (!r->plateau)
        return quantise_side(r, extra, w.sigma, w.lo, &extra[SIGMA], &extra[MIDDLE]);
    if (w.lo > (double)p->from / SPIN_PAGE_TICKS &&
        !quantise_side(r, extra, w.sigma, w.lo, &extra[SIGMA], &extra[MIDDLE]))
        return false;
    return !(w.hi < (double)(p->end - 1) / SPIN_PAGE_TICKS) ||
           quantise_side(r, extra, w.sigma2, w.hi, &key[r->plateau + 1], &key[r->plateau]);
}

static bool number_path(const struct spin_page_rows *r, const struct piece *p, int32_t *key)
{
    const struct spin_splats_4d *s = r->splats;
    double step = spin_page_step(&r->inner, SPIN_PAGE_PLACE);
    int degree = s->degree;

    for (int c = 0; c < 3; c++) {
        int32_t node[4] = {0};

        for (int j = 0; j <= degree; j++) {
            double share = degree ? (double)j / degree : 0, place[3];
            double t = time_of(r, p->from + share * (p->end - p->from));

            spin_path_at(s->centres + 3 * (size_t)p->row,
                         s->paths ? s->paths + 3 * (size_t)degree * p->row : NULL, degree,
                         t - (double)s->times[p->row], place);
            if (!quantise(&node[j], (place[c] - r->space.centre[c]) / step))
                return false;
        }
        key[SPIN_PAGE_PLACE + c] = node[0];
        for (int k = 1; k <= degree; k++) {
            for (int j = 0; j + k <= degree; j++)
                node[j] = node[j + 1] - node[j];
            key[r->path + 3 * (k - 1) + c] = node[0];
        }
    }
    return true;
}

/* Sets q to the rotation at the beginning of a piece, as a reader decodes it. */
static void rotation_of(const struct spin_page_rows *r, const int32_t *key, double q[4])
{
    double step = spin_page_step(&r->inner, SPIN_PAGE_ROTATION), v[3];

    for (int c = 0; c < 3; c++)
        v[c] = key[SPIN_PAGE_ROTATION + c] * step;
    spin_page_turn_of(v, q);
}

static bool number_turn(const struct spin_page_rows *r, const double a[4], const double b[4],
                        int32_t *key)
{
    double step = spin_page_step(&r->inner, SPIN_PAGE_ROTATION), from[4], to[4], q[4], v[3];

    rotation_of(r, key, from);
    for (int c = 1; c < 4; c++)
        from[c] = -from[c];
    if (!unit_of(b, to))
        return true;
    spin_scene_rotation_join(to, from, q);
    spin_page_vector_of(q, v);
    for (int c = 0; c < 3; c++)
        if (!quantise(&key[r->turn + c], v[c] / step))
            return false;
    return quantise(&key[r->turn + 3], log(length_of(b) / fmax(length_of(a), 1e-30)) / r->ratio);
}

static bool number_cosines(const struct spin_page_rows *r, size_t i, int32_t *key)
{
    const struct spin_splats_4d *s = r->splats;
    double round = ((double)s->times[i] - r->times[0]) / s->period;
    int32_t *to = key + r->cosines;

    if (!quantise(to++, TURN * (round - floor(round)) / r->phase))
        return false;
    for (int k = 0; k < 2; k++)
        for (int c = 0; c < 3 + r->n_sh; c++)
            if (!quantise(to++, cosine_at(r, i, k, c) / (c < 3 ? r->cosine : r->cosine_sh)))
                return false;
    return true;
}

/* Quantises all columns of a piece. Returns false if a number is too large. */
static bool number_piece(const struct spin_page_rows *r, const struct spin_splat_rows *rows,
                         const struct piece *p, int32_t *key)
{
    float value[SPIN_PAGE_WIDTH] = {0}, room[3 * SPIN_SH_MAX];
    int32_t *extra = extra_columns(r, key);
    struct spin_gaussian is;
    double opacity, a[4], b[4], q[4];

    memset(key, 0, (size_t)r->n_columns * sizeof *key);
    extra[FROM] = p->from;
    extra[LENGTH] = p->end - p->from;
    if (!number_window(r, p, key, &opacity))
        return false;
    ends_of(r, p, a, b);
    unit_of(a, q);
    spin_splat_rows_get(rows, p->row, &is);
    for (int c = 0; c < 3; c++) {
        /* The position is quantised by number_path(). Here, the centre of the scene gives 0. */
        value[SPIN_PAGE_PLACE + c] = (float)r->space.centre[c];
        value[SPIN_PAGE_COLOUR + c] = is.colour[c];
        value[SPIN_PAGE_SCALE + c] = is.log_scale[c];
    }
    for (int c = 0; c < 4; c++)
        value[SPIN_PAGE_ROTATION + c] = (float)q[c];
    value[SPIN_PAGE_OPACITY] = (float)opacity;
    if (r->n_sh)
        memcpy(value + SPIN_PAGE_VALUE_SH, spin_splat_rows_sh(rows, p->row, room) + 3,
               (size_t)r->n_sh * sizeof *value);
    return spin_page_number_own(&r->inner, value, r->n_sh, key) && number_path(r, p, key) &&
           (!r->turn || number_turn(r, a, b, key)) &&
           (!r->cosines || number_cosines(r, p->row, key));
}

/* ---- Decoding -------------------------------------------------------------------------------- */

static double side_at(const struct spin_page_rows *r, const int32_t *extra, int32_t sigma,
                      int32_t middle, double frames, bool before)
{
    double z = 0, off;

    if (sigma != 0) {
        off = frames - centre_of(extra) - middle * r->middle * octave_of(r, extra, sigma);
        z = off / (half_of(extra) * exp2((double)exponent_of(sigma) / r->octave));
    }
    return (before ? z < 0 : z > 0) ? exp(-0.5 * z * z) : 1;
}

/* Decodes all values of a piece at a tick, as the page does. */
static void read_piece(const struct spin_page_rows *r, const int32_t *key, int tick, double *value)
{
    const int32_t *extra = key + SPIN_PAGE_SH + r->n_sh,
                  *last = r->plateau ? key + r->plateau : NULL;
    double frames = (double)tick / SPIN_PAGE_TICKS, w;
    double share = (double)(tick - extra[FROM]) / extra[LENGTH], s = share * r->splats->degree;
    int32_t twice[SPIN_PAGE_COLUMNS];

    for (int c = 0; c < SPIN_PAGE_SH + r->n_sh; c++)
        twice[c] = 2 * key[c];
    spin_page_value_of(&r->inner, twice, NULL, r->n_sh, value);
    w = side_at(r, extra, extra[SIGMA], extra[MIDDLE], frames, true) *
        (last ? side_at(r, extra, last[1], last[0], frames, false)
              : side_at(r, extra, extra[SIGMA], extra[MIDDLE], frames, false));
    if (r->gates)
        w = key[r->gates] * r->gate + (1 - key[r->gates] * r->gate) * w;
    value[SPIN_PAGE_OPACITY] *= w;
    for (int c = 0; c < 3 && r->path; c++) {
        const int32_t *d = key + r->path + c;
        double sum = 0;

        for (int k = r->splats->degree; k > 0; k--)
            sum = (d[3 * (k - 1)] + sum) * (s - k + 1) / k;
        value[SPIN_PAGE_PLACE + c] += sum * spin_page_step(&r->inner, SPIN_PAGE_PLACE);
    }
    if (r->turn) {
        double step = spin_page_step(&r->inner, SPIN_PAGE_ROTATION), v[3], by[4], from[4], to[4];
        double more = share * exp(key[r->turn + 3] * r->ratio);

        for (int c = 0; c < 3; c++)
            v[c] = key[r->turn + c] * step;
        spin_page_turn_of(v, by);
        memcpy(from, value + SPIN_PAGE_ROTATION, sizeof from);
        spin_scene_rotation_join(by, from, to);
        for (int c = 0; c < 4; c++)
            from[c] = (1 - share) * from[c] + more * to[c];
        unit_of(from, value + SPIN_PAGE_ROTATION);
    }
    if (r->cosines) {
        const int32_t *c0 = key + r->cosines + 1, *c1 = c0 + 3 + r->n_sh;
        double turn = TURN * frames * r->step / r->splats->period - key[r->cosines] * r->phase;

        for (int c = 0; c < 3 + r->n_sh; c++)
            value[c < 3 ? SPIN_PAGE_COLOUR + c : SPIN_PAGE_VALUE_SH + c - 3] +=
                (c < 3 ? r->cosine : r->cosine_sh) * (cos(turn) * c0[c] + cos(2 * turn) * c1[c]);
    }
}

/* Sets `value` to the exact values of row i of the source at time t. */
static void true_piece(const struct spin_page_rows *r, const struct spin_splat_rows *rows, size_t i,
                       double t, double *value)
{
    const struct spin_splats_4d *s = r->splats;
    size_t width = 3 * (size_t)spin_sh_count(s->sh_degree);
    double d = t - (double)s->times[i], turn = s->sh_cos ? TURN * d / s->period : 0, q[4];
    float room[3 * SPIN_SH_MAX];
    const float *sh = spin_splat_rows_sh(rows, i, room);

    spin_path_at(s->centres + 3 * i, s->paths ? s->paths + 3 * (size_t)s->degree * i : NULL,
                 s->degree, d, value);
    for (size_t c = 0; c < 3 + (size_t)r->n_sh; c++) {
        const float *cosine = s->sh_cos ? s->sh_cos + 2 * width * i + c : NULL;
        double v = (double)sh[c];

        if (cosine)
            v += cos(turn) * (double)cosine[0] + cos(2 * turn) * (double)cosine[width];
        value[c < 3 ? SPIN_PAGE_COLOUR + c : SPIN_PAGE_VALUE_SH + c - 3] =
            c < 3 ? 0.5 + SPIN_SH_C0 * v : v;
    }
    value[SPIN_PAGE_OPACITY] = opacity_at(r, i, t);
    for (size_t c = 0; c < 3; c++)
        value[SPIN_PAGE_SCALE + c] = (double)s->log_scales[3 * i + c];
    turned_at(r, i, t, q);
    unit_of(q, value + SPIN_PAGE_ROTATION);
}

/* ---- A block --------------------------------------------------------------------------------- */

struct block {
    struct spin_page_rows *r;
    const struct spin_splat_rows *rows;
    const struct piece *piece; /* [n] */
    size_t n;
    struct spin_keyed *order;       /* [n] */
    int32_t *key;                   /* [n][columns] */
    struct spin_quant_error *quant; /* [tasks] */
    uint64_t *n_values;             /* [tasks] */
    _Atomic bool failed;
};

/* Adds the errors of a piece at CHECKED evenly spaced ticks, or at all of its ticks if it has
 * fewer, and at the four ticks nearest to the ends of its plateau and to one sigma beyond these
 * ends. */
static void check_piece(const struct block *b, const struct piece *p, const int32_t *key, int task)
{
    const struct spin_page_rows *r = b->r;
    struct window w = window_of(r, p->row);
    const double bend[] = {w.lo - w.sigma, w.lo, w.hi, w.hi + w.sigma2};
    double is[SPIN_PAGE_WIDTH], want[SPIN_PAGE_WIDTH];
    int length = p->end - p->from, most = length < CHECKED ? length : CHECKED;

    for (int k = 0; k < most + 4; k++) {
        double at = k < most ? p->from + (double)k * (length - 1) / (most > 1 ? most - 1 : 1)
                             : frames_of(r, bend[k - most]) * SPIN_PAGE_TICKS;
        int tick = (int)floor(fmin(fmax(at, p->from), p->end - 1) + 0.5);

        read_piece(r, key, tick, is);
        true_piece(r, b->rows, p->row, time_of(r, tick), want);
        spin_page_errors_add(&b->quant[task], is, want, true, r->n_sh);
        b->n_values[task] += SPIN_PAGE_VALUE_SH + (uint64_t)r->n_sh;
    }
}

/* Returns a key that sorts static rows before dynamic rows, and rows of the same class by their
 * first visible tick. */
static uint64_t class_of(const struct spin_page_rows *r, int32_t *key)
{
    uint64_t moves = 0;

    for (int c = 0; r->path && c < 3 * r->splats->degree; c++)
        moves |= key[r->path + c] != 0;
    return moves << 32 | (uint64_t)(extra_columns(r, key)[FROM]);
}

static void number_task(void *context, int task)
{
    struct block *b = context;
    struct spin_page_rows *r = b->r;
    size_t from = (size_t)task * SPIN_ROWS_BLOCK, to = from + SPIN_ROWS_BLOCK;

    for (size_t k = from; k < (to < b->n ? to : b->n); k++) {
        int32_t *key = b->key + k * (size_t)r->n_columns;
        float place[3];

        if (!number_piece(r, b->rows, &b->piece[k], key)) {
            b->failed = true;
            return;
        }
        check_piece(b, &b->piece[k], key, task);
        for (int c = 0; c < 3; c++)
            place[c] =
                (float)(key[SPIN_PAGE_PLACE + c] * spin_page_step(&r->inner, SPIN_PAGE_PLACE) +
                        r->space.centre[c]);
        b->order[k] =
            (struct spin_keyed){.key = spin_page_place_key(&r->inner, place), .row = (uint32_t)k};
    }
}

/* Copies column c of all rows, in the order of the file, to out. */
static void column_of(const struct block *b, size_t c, int32_t *out)
{
    for (size_t k = 0; k < b->n; k++)
        out[k] = b->key[b->order[k].row * (size_t)b->r->n_columns + c];
}

static spin_status pack_block(const struct block *b, spin_page_rows_sink sink, void *context)
{
    struct spin_page_rows_block out = {.n = b->n, .from = b->piece[0].from, .end = b->piece[0].end};
    SPIN_LEAVES(spin_page_bytes_free) struct spin_page_bytes bytes = {0};
    int32_t *again;
    SPIN_FREED int32_t *column = NULL;
    SPIN_FREED unsigned char *packed = NULL, *back = NULL;
    size_t n_room = 0, n_back = 0, at = 0;

    for (size_t k = 0; k < b->n; k++) {
        out.from = b->piece[k].from < out.from ? b->piece[k].from : out.from;
        out.end = b->piece[k].end > out.end ? b->piece[k].end : out.end;
    }
    SPIN_TRY(spin_alloc(b->n, 3 * sizeof *column, (void **)&column));
    for (int c = 0; c < b->r->n_columns; c++) {
        int32_t *now = column + (size_t)(c & 1) * b->n;

        column_of(b, (size_t)c, now);
        SPIN_TRY(spin_page_encode_column(&bytes, now, c ? column + (size_t)(~c & 1) * b->n : NULL,
                                         b->n));
    }
    SPIN_TRY(spin_gzip_write(b->r->pool, 6, bytes.data, bytes.n, &packed, &n_room, &out.n_bytes));
    SPIN_TRY(spin_alloc(bytes.n + 1, 1, (void **)&back));
    SPIN_TRY(spin_gzip_read(packed, out.n_bytes, back, bytes.n + 1, &n_back));
    again = column + 2 * b->n;
    for (int c = 0; c < b->r->n_columns; c++) {
        int32_t *now = column + (size_t)(c & 1) * b->n;

        column_of(b, (size_t)c, now);
        SPIN_TRY(spin_page_decode_column(back, n_back, &at, again,
                                         c ? column + (size_t)(~c & 1) * b->n : NULL, b->n));
        if (memcmp(now, again, b->n * sizeof *now) != 0)
            return spin_malformed(
                "a block of the page decodes to other values than were encoded: a bug in spin4d");
    }
    out.data = packed;
    return sink(context, &out);
}

static spin_status write_block(struct spin_page_rows *r, const struct spin_splat_rows *rows,
                               const struct piece *piece, size_t n, spin_page_rows_sink sink,
                               void *context)
{
    struct block b = {.r = r, .rows = rows, .piece = piece, .n = n};
    struct spin_sort_rows order = {.n = n};
    int n_tasks = (int)((n + SPIN_ROWS_BLOCK - 1) / SPIN_ROWS_BLOCK);
    spin_status status;

    SPIN_TRY_OUT(spin_alloc(n, (size_t)r->n_columns * sizeof *b.key, (void **)&b.key));
    SPIN_TRY_OUT(spin_alloc(n, sizeof *order.item, (void **)&order.item));
    SPIN_TRY_OUT(spin_alloc(n, sizeof *order.spare, (void **)&order.spare));
    SPIN_TRY_OUT(spin_alloc((size_t)n_tasks, sizeof *b.quant, (void **)&b.quant));
    SPIN_TRY_OUT(spin_alloc((size_t)n_tasks, sizeof *b.n_values, (void **)&b.n_values));
    b.order = order.item;
    spin_pool_run(r->pool, n_tasks, number_task, &b);
    if (b.failed)
        SPIN_TRY_OUT(spin_unsupported(
            "a splat is too far from the others, or visible for too short a time, to store "
            "positions in steps of %g: set a larger --bound-place",
            2 * r->space.bounds.place));
    for (int t = 0; t < n_tasks; t++) {
        r->n_values += b.n_values[t];
        spin_quant_error_merge(&r->quant, &b.quant[t]);
    }
    SPIN_TRY_OUT(spin_page_errors_check(&r->quant, &r->space.bounds));
    spin_sort_rows_sort(&order);
    for (size_t k = 0; k < n; k++)
        order.item[k].key = class_of(r, b.key + order.item[k].row * (size_t)r->n_columns);
    /* This sort is stable, so rows of one class stay in Morton order. */
    spin_sort_rows_sort(&order);
    b.order = order.item;
    status = pack_block(&b, sink, context);
out:
    free(b.key);
    free(b.quant);
    free(b.n_values);
    spin_sort_rows_free(&order);
    return status;
}

/* ---- The whole clip -------------------------------------------------------------------------- */

struct pieces {
    struct piece *at;
    size_t n, room;
};

static spin_status add_piece(const struct spin_page_rows *r, struct pieces *to, struct piece p)
{
    double a[4], b[4];

    if (r->turn && p.end - p.from > 1 && ends_of(r, &p, a, b) < LEAST_DOT) {
        int32_t middle = p.from + (p.end - p.from) / 2;

        SPIN_TRY(add_piece(r, to, (struct piece){p.row, p.from, middle}));
        return add_piece(r, to, (struct piece){p.row, middle, p.end});
    }
    SPIN_TRY(spin_array_grow(to->n, &to->room, sizeof *to->at, (void **)&to->at));
    to->at[to->n++] = p;
    return SPIN_OK;
}

/* Returns the block of a piece: 0 if the piece lasts more than two key intervals, else 1 + the
 * index of the key interval in which the piece begins. */
static int block_of(const struct spin_page_rows *r, const struct piece *p)
{
    int long_one = r->key_every * SPIN_PAGE_TICKS;

    return p->end - p->from > 2 * long_one ? 0 : 1 + p->from / long_one;
}

static spin_status sort_by_block(const struct spin_page_rows *r, struct pieces *p)
{
    SPIN_LEAVES(spin_sort_rows_free) struct spin_sort_rows order = {.n = p->n};
    struct piece *sorted = NULL;

    SPIN_TRY(spin_alloc(p->n + 1, sizeof *order.item, (void **)&order.item));
    SPIN_TRY(spin_alloc(p->n + 1, sizeof *order.spare, (void **)&order.spare));
    SPIN_TRY(spin_alloc(p->n + 1, sizeof *sorted, (void **)&sorted));
    for (size_t k = 0; k < p->n; k++)
        order.item[k] =
            (struct spin_keyed){.key = (uint64_t)block_of(r, &p->at[k]), .row = (uint32_t)k};
    spin_sort_rows_sort(&order);
    for (size_t k = 0; k < p->n; k++)
        sorted[k] = p->at[order.item[k].row];
    free(p->at);
    p->at = sorted;
    return SPIN_OK;
}

spin_status spin_page_rows_write(struct spin_page_rows *r, const struct spin_splat_rows *rows,
                                 spin_page_rows_sink sink, void *context)
{
    struct pieces pieces = {0};
    struct piece p;
    size_t from = 0;
    spin_status status = SPIN_OK;

    for (size_t i = 0; i < r->splats->n; i++)
        if (rows->keep[i] && find_ticks(r, i, &p))
            SPIN_TRY_OUT(add_piece(r, &pieces, p));
    if (pieces.n == 0)
        SPIN_TRY_OUT(spin_unsupported("no splat is visible in the selected frames: check --range"));
    SPIN_TRY_OUT(sort_by_block(r, &pieces));
    for (size_t k = 1; k <= pieces.n; k++) {
        if (k < pieces.n && block_of(r, &pieces.at[k]) == block_of(r, &pieces.at[from]))
            continue;
        SPIN_TRY_OUT(write_block(r, rows, pieces.at + from, k - from, sink, context));
        from = k;
    }
out:
    free(pieces.at);
    return status;
}
