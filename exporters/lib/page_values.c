#include "exporters/lib/page_values.h"

#include "base/base.h"
#include "exporters/lib/page_bytes.h"
#include "math/morton.h"
#include "math/scene_rotation.h"

#define PI 3.14159265358979323846
/* Steps are slightly narrower than the bounds allow, as a margin for float rounding. */
#define NARROWER 0.999

/* ---- Bounds ---------------------------------------------------------------------------------- */

spin_status spin_page_bounds_from(const struct spin_plugin_values *v, double size,
                                  struct spin_page_bounds *out)
{
    /* Columns: position in world units; position as a share of the scene's size (the larger of the
     * two bounds applies); colour and opacity in 255ths; scale in percent; rotation in degrees; SH
     * coefficient. */
    static const double level[3][6] = {{0.00025, 0.000125, 1, 0.5, 0.25, 0.01},
                                       {0.001, 0.0005, 3, 2, 1, 0.02},
                                       {0.002, 0.0005, 4, 5, 3, 0.04}};
    const char *word = spin_plugin_value(v, "level", NULL);
    int which = 1;
    double colour, percent, degrees;

    if (word)
        SPIN_TRY(spin_option_word(v, "level", "fine|normal|coarse", &which));
    out->place = fmax(level[which][0], level[which][1] * size);
    colour = level[which][2];
    percent = level[which][3];
    degrees = level[which][4];
    out->sh = level[which][5];
    SPIN_TRY(spin_option_number(v, "bound-place", 1e-9, 1e9, &out->place));
    SPIN_TRY(spin_option_number(v, "bound-colour", 0.01, 100, &colour));
    SPIN_TRY(spin_option_number(v, "bound-scale", 0.001, 100, &percent));
    SPIN_TRY(spin_option_number(v, "bound-rotation", 0.001, 45, &degrees));
    SPIN_TRY(spin_option_number(v, "bound-sh", 1e-4, 1, &out->sh));
    out->colour = out->opacity = colour / 255;
    out->scale = log(1 + percent / 100);
    out->rotation = degrees * PI / 180;
    return SPIN_OK;
}

double spin_page_step(const struct spin_page_space *space, int column)
{
    const struct spin_page_bounds *b = &space->bounds;
    double bound = column < SPIN_PAGE_COLOUR     ? b->place
                   : column < SPIN_PAGE_OPACITY  ? b->colour
                   : column < SPIN_PAGE_SCALE    ? b->opacity
                   : column < SPIN_PAGE_ROTATION ? b->scale
                   : column < SPIN_PAGE_SH       ? b->rotation / sqrt(3)
                                                 : b->sh;

    return 2 * NARROWER * bound;
}

/* ---- Rotations ------------------------------------------------------------------------------- */

static double length_of(const double v[3]) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

void spin_page_turn_of(const double v[3], double q[4])
{
    double angle = length_of(v), k = angle > 1e-9 ? sin(angle / 2) / angle : 0.5;

    q[0] = cos(angle / 2);
    for (int c = 0; c < 3; c++)
        q[c + 1] = k * v[c];
}

void spin_page_vector_of(const double q[4], double v[3])
{
    double sine = length_of(q + 1), sign = q[0] < 0 ? -1 : 1;
    double k = sine > 1e-9 ? sign * 2 * atan2(sine, sign * q[0]) / sine : sign * 2;

    for (int c = 0; c < 3; c++)
        v[c] = k * q[c + 1];
}

/* Sets v to the rotation vector from the quaternion `from` to the quaternion in `value`. A rotation
 * has two such vectors, of opposite directions: v is the one nearer to `last`, so that v is
 * continuous over time; if `last` is NULL, v is the shorter one. */
static void vector_from(const double from[4], const float *value, const double *last, double v[3])
{
    double back[4] = {from[0], -from[1], -from[2], -from[3]}, to[4], q[4], angle, other, near = 0,
           far = 0;

    for (int c = 0; c < 4; c++)
        to[c] = (double)value[SPIN_PAGE_ROTATION + c];
    spin_scene_rotation_join(to, back, q);
    spin_page_vector_of(q, v);
    angle = length_of(v);
    if (!last || angle < 1e-9)
        return;
    other = 1 - 2 * PI / angle;
    for (int c = 0; c < 3; c++) {
        near += (v[c] - last[c]) * (v[c] - last[c]);
        far += (other * v[c] - last[c]) * (other * v[c] - last[c]);
    }
    for (int c = 0; c < 3 && far < near; c++)
        v[c] *= other;
}

/* ---- Errors ---------------------------------------------------------------------------------- */

void spin_page_errors_add(struct spin_quant_error *q, const double *is, const double *want,
                          bool present, int n_sh)
{
    double dot = 0, apart = 0;

    if (!present) {
        spin_quant_error_add(q, SPIN_QUANT_OPACITY, is[SPIN_PAGE_OPACITY]);
        return;
    }
    for (int c = 0; c < 3; c++) {
        spin_quant_error_add(q, SPIN_QUANT_PLACE, is[c] - want[c]);
        spin_quant_error_add(q, SPIN_QUANT_COLOUR, is[3 + c] - want[3 + c]);
        spin_quant_error_add(q, SPIN_QUANT_SCALE, is[7 + c] - want[7 + c]);
    }
    spin_quant_error_add(q, SPIN_QUANT_OPACITY, is[SPIN_PAGE_OPACITY] - want[SPIN_PAGE_OPACITY]);
    for (int c = 10; c < 14; c++)
        dot += is[c] * want[c];
    for (int c = 10; c < 14; c++)
        apart += pow(is[c] - (dot < 0 ? -1 : 1) * want[c], 2);
    spin_quant_error_add(q, SPIN_QUANT_ROTATION, 4 * asin(fmin(sqrt(apart) / 2, 1)));
    for (int c = 0; c < n_sh; c++)
        spin_quant_error_add(q, SPIN_QUANT_SH,
                             is[SPIN_PAGE_VALUE_SH + c] - want[SPIN_PAGE_VALUE_SH + c]);
}

spin_status spin_page_errors_check(const struct spin_quant_error *q,
                                   const struct spin_page_bounds *b)
{
    static const char *const name[] = {"position", "scale", "rotation", "opacity", "colour", "SH"};
    const double bound[] = {b->place, b->scale, b->rotation, b->opacity, b->colour, b->sh};

    for (int p = 0; p < SPIN_QUANT_PARTS; p++)
        if (!(q->part[p].largest <= bound[p]) || !isfinite(q->part[p].squares))
            return spin_malformed("%s has an error of %g, above its bound of %g: a bug in spin4d",
                                  name[p], q->part[p].largest, bound[p]);
    return SPIN_OK;
}

/* ---- Positions ------------------------------------------------------------------------------- */

uint64_t spin_page_place_key(const struct spin_page_space *space, const float place[3])
{
    double step = fmax(4 * space->bounds.place, 1e-12);
    uint64_t key = 0;

    for (int c = 0; c < 3; c++) {
        double at = ((double)place[c] - space->centre[c]) / step + 524288;

        key |= spin_morton_spread((uint64_t)fmin(fmax(at, 0), 1048575)) << c;
    }
    return key;
}

/* ---- Numbers --------------------------------------------------------------------------------- */

static bool in_range(double x) { return fabs(x) < SPIN_PAGE_MOST - 1; }

static inline int32_t nearest(double x) { return (int32_t)(x < 0 ? x - 0.5 : x + 0.5); }

static inline unsigned cost_of(int32_t d)
{
    uint32_t u = (uint32_t)(d < 0 ? -d : d);

    return u ? 35 - (unsigned)__builtin_clz(u) : 0;
}

/* Chooses the key that minimises the encoded size of the numbers of later frames. The key is in
 * units of half a step, and differs from x[0] by at most half a step. Returns false if a value is
 * out of range. */
static bool choose_key(const double *x, int n, double step, int32_t *key)
{
    double half = step / 2, least = (double)UINT32_MAX;
    double from = ceil((x[0] - half) / half), to = floor((x[0] + half) / half);

    for (int f = 0; f < n; f++)
        if (!in_range(x[f] / half))
            return false;
    *key = nearest(x[0] / half);
    for (double k = from; k <= to; k++) {
        double cost = 0;
        int32_t last = 0;

        for (int f = 0; f < n; f++) {
            double at = (x[f] - k * half) / step;
            int32_t now = f ? nearest(at) : 0;

            /* The cost is the coded size in bits. If two keys lead to the same size, the one with
             * the smaller squared rounding errors costs less. */
            cost += cost_of(now - last) + 0.2 * (at - now) * (at - now);
            last = now;
        }
        if (cost < least) {
            least = cost;
            *key = (int32_t)k;
        }
    }
    return true;
}

static void number_rotation(const struct spin_page_space *space, const float *const *value,
                            int n_frames, double *x, int32_t *key, int32_t *number, size_t pitch)
{
    double step = spin_page_step(space, SPIN_PAGE_ROTATION), base[4], first[4], off[3], part[4],
           v[3], last[3] = {0};

    /* Find an offset from the first frame's rotation that minimises the coded size of the later
     * frames' numbers, as choose_key() does. */
    for (int c = 0; c < 4; c++)
        first[c] = (double)value[0][SPIN_PAGE_ROTATION + c];
    for (int f = 0; f < n_frames; f++) {
        vector_from(first, value[f], f ? last : NULL, v);
        for (int c = 0; c < 3; c++)
            x[c * n_frames + f] = last[c] = v[c];
    }
    for (int c = 0; c < 3; c++) {
        int32_t k;

        choose_key(x + (ptrdiff_t)c * n_frames, n_frames, step, &k);
        /* Half of the allowed offset: rounding the key may cause an error of the same size. */
        off[c] = 0.5 * step / 2 * k;
    }
    spin_page_turn_of(off, part);
    spin_scene_rotation_join(part, first, base);
    spin_page_vector_of(base, v);
    for (int c = 0; c < 3; c++) {
        key[SPIN_PAGE_ROTATION + c] = nearest(v[c] / (step / 2));
        v[c] = key[SPIN_PAGE_ROTATION + c] * (step / 2);
    }
    spin_page_turn_of(v, base);
    for (int f = 0; f < n_frames; f++) {
        vector_from(base, value[f], f ? last : NULL, v);
        for (int c = 0; c < 3; c++) {
            last[c] = v[c];
            number[(size_t)(SPIN_PAGE_ROTATION + c) * pitch + (size_t)f] =
                f ? nearest(v[c] / step) : 0;
        }
    }
}

bool spin_page_number_row(const struct spin_page_space *space, const float *const *value,
                          const uint8_t *present, int n_frames, int n_sh, int32_t *key,
                          int32_t *number, size_t pitch)
{
    double x[3 * 256];

    for (int c = 0; c < SPIN_PAGE_SH + n_sh; c++) {
        double step = spin_page_step(space, c);
        double centre = c < SPIN_PAGE_COLOUR ? space->centre[c] : 0;

        if (c == SPIN_PAGE_ROTATION) {
            number_rotation(space, value, n_frames, x, key, number, pitch);
            c += 2;
            continue;
        }
        for (int f = 0; f < n_frames; f++) {
            x[f] = (double)value[f][c < SPIN_PAGE_SH ? c : c + 1] - centre;
            if (c == SPIN_PAGE_OPACITY && !present[f])
                x[f] = 0;
        }
        if (!choose_key(x, n_frames, step, &key[c]))
            return false;
        if (c == SPIN_PAGE_OPACITY && !present[0])
            key[c] = 0;
        number[(size_t)c * pitch] = 0;
        for (int f = 1; f < n_frames; f++) {
            double at = x[f] / step - 0.5 * key[c];

            /* round down the opacity: an absent splat must not become visible */
            if (c == SPIN_PAGE_OPACITY && !present[f])
                at = floor(at);
            number[(size_t)c * pitch + (size_t)f] = nearest(at);
        }
    }
    return true;
}

bool spin_page_number_own(const struct spin_page_space *space, const float *value, int n_sh,
                          int32_t *key)
{
    double q[4], v[3];

    for (int c = 0; c < 4; c++)
        q[c] = (double)value[SPIN_PAGE_ROTATION + c];
    spin_page_vector_of(q, v);
    for (int c = 0; c < SPIN_PAGE_SH + n_sh; c++) {
        double x = c < SPIN_PAGE_ROTATION ? (double)value[c]
                   : c < SPIN_PAGE_SH     ? v[c - SPIN_PAGE_ROTATION]
                                          : (double)value[c + 1];

        x = (x - (c < SPIN_PAGE_COLOUR ? space->centre[c] : 0)) / spin_page_step(space, c);
        if (!in_range(2 * x))
            return false;
        key[c] = nearest(x);
    }
    return true;
}

void spin_page_value_of(const struct spin_page_space *space, const int32_t *key,
                        const int32_t *number, int n_sh, double *value)
{
    double step = spin_page_step(space, SPIN_PAGE_ROTATION), v[3], w[3] = {0}, from[4], by[4];

    for (int c = 0; c < SPIN_PAGE_SH + n_sh; c++) {
        double at = 0.5 * key[c] + (number ? number[c] : 0);

        if (c < SPIN_PAGE_ROTATION || c >= SPIN_PAGE_SH)
            value[c < SPIN_PAGE_SH ? c : c + 1] =
                at * spin_page_step(space, c) + (c < SPIN_PAGE_COLOUR ? space->centre[c] : 0);
    }
    value[SPIN_PAGE_OPACITY] = fmin(fmax(value[SPIN_PAGE_OPACITY], 0), 1);
    for (int c = 0; c < 3; c++) {
        v[c] = key[SPIN_PAGE_ROTATION + c] * (step / 2);
        w[c] = number ? number[SPIN_PAGE_ROTATION + c] * step : 0;
    }
    spin_page_turn_of(v, from);
    spin_page_turn_of(w, by);
    spin_scene_rotation_join(by, from, value + SPIN_PAGE_ROTATION);
}
