#include "geometry/voxels.h"

#include "base/base.h"
#include "math/activate.h"
#include "math/covariance.h"

#define NEEDED (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES)
/* A scene is unbounded if it is wider than its detailed part by more than this factor. */
#define UNBOUNDED 16.0
#define CONTEXT 1.5 /* sides of the detailed part by which the grid extends beyond it */
#define LARGE 4.0   /* standard deviation of a large splat, in cells */
#define EXTENT 2.5  /* of a large splat, in standard deviations */
enum {
    MOST_SPLATS = 100000,
    MOST_SAMPLES = 150, /* of a large splat, along half an axis */
};

/* ---- Splats ---------------------------------------------------------------------------------- */

/* Returns the integral of a Gaussian with these log scales over the plane of its two longest axes.
 */
static double cross_section(const float scale[3])
{
    double least = (double)fminf(scale[0], fminf(scale[1], scale[2]));

    return 2 * M_PI * exp((double)scale[0] + (double)scale[1] + (double)scale[2] - least);
}

static bool is_finite(const struct spin_splats *s, size_t i)
{
    bool finite = isfinite(s->logit_opacities[i]);

    for (size_t c = 0; c < 3; c++)
        finite &= isfinite(s->means[3 * i + c]) && isfinite(s->log_scales[3 * i + c]);
    return finite;
}

/* Sets the two longest axes, each one standard deviation long. */
static void set_axes(const float quat[4], const float scale[3], struct spin_voxel_splat *out)
{
    const double q[4] = {(double)quat[0], (double)quat[1], (double)quat[2], (double)quat[3]};
    size_t shortest = scale[0] < scale[1] ? 0 : 1, n = 0;
    double r[9];

    spin_matrix_of_quat(q, r);
    shortest = scale[2] < scale[shortest] ? 2 : shortest;
    for (size_t k = 0; k < 3; k++) {
        if (k == shortest)
            continue;
        for (size_t c = 0; c < 3; c++)
            out->axis[n][c] = (float)(exp((double)scale[k]) * r[3 * c + k]);
        n++;
    }
}

static struct spin_voxel_splat make_splat(const struct spin_splats *s, size_t i, int frame)
{
    size_t n_sh = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
    const float *scale = s->log_scales + 3 * i;
    struct spin_voxel_splat out = {.frame = frame};

    out.opacity = (float)spin_sigmoid_of((double)s->logit_opacities[i]);
    out.area = (float)((double)out.opacity * cross_section(scale));
    out.largest = expf(fmaxf(scale[0], fmaxf(scale[1], scale[2])));
    set_axes(s->quats + 4 * i, scale, &out);
    for (size_t c = 0; c < 3; c++) {
        out.at[c] = s->means[3 * i + c];
        out.rgb[c] = fminf(fmaxf(0.5f + 0.28209479f * s->sh[n_sh * i + c], 0), 1);
    }
    return out;
}

/* Adds the splats of a frame or, if the frame is large, every n-th of them. */
static spin_status add_frame(struct spin_voxels *v, const struct spin_splats *s)
{
    size_t stride = 1 + s->n / MOST_SPLATS, before = v->n_splats;

    for (size_t i = 0; i < s->n; i += stride) {
        if (!is_finite(s, i))
            continue;
        SPIN_TRY(spin_array_grow(v->n_splats, &v->capacity, sizeof *v->splat, (void **)&v->splat));
        v->splat[v->n_splats] = make_splat(s, i, v->n_frames);
        v->splat[v->n_splats++].count = (float)stride;
    }
    v->n_frames += v->n_splats > before;
    return SPIN_OK;
}

static spin_status read_frames(struct spin_voxels *v, int n_frames, spin_voxel_read_fn read,
                               void *context)
{
    int stride = n_frames > SPIN_VOXEL_FRAMES ? n_frames / SPIN_VOXEL_FRAMES : 1;

    for (int f = 0; f < n_frames && v->n_frames < SPIN_VOXEL_FRAMES; f += stride) {
        const struct spin_splats *s;

        SPIN_TRY(read(context, f, &s));
        if (s->n > 0 && !(s->logit_opacities && s->log_scales && s->sh))
            return spin_unsupported("the frames contain positions without opacities and scales");
        SPIN_TRY(add_frame(v, s));
    }
    return v->n_splats > 0 ? SPIN_OK : spin_unsupported("no frame contains a splat");
}

/* ---- The grid -------------------------------------------------------------------------------- */

struct coordinate {
    float at, weight;
};

/* Returns the smallest coordinate that is not exceeded by a share of the weights of n sorted
 * coordinates. */
static double weighted_quantile(const struct coordinate *x, size_t n, double share)
{
    double all = 0, sum = 0;
    size_t k = 0;

    for (size_t i = 0; i < n; i++)
        all += (double)x[i].weight;
    for (; k + 1 < n && (sum += (double)x[k].weight) < share * all; k++)
        ;
    return (double)x[k].at;
}

/* Sets low and high to the 1st and the 99th percentile of the positions of visible splats along
 * each axis. detail: small splats count more than large ones, by the inverse of their area. */
static spin_status find_bounds(const struct spin_voxels *v, bool detail, double low[3],
                               double high[3])
{
    SPIN_FREED struct coordinate *x = NULL;

    SPIN_TRY(spin_alloc(v->n_splats, sizeof *x, (void **)&x));
    for (int c = 0; c < 3; c++) {
        size_t n = 0;

        for (size_t i = 0; i < v->n_splats; i++)
            if (v->splat[i].opacity > 0.05f) {
                x[n].at = v->splat[i].at[c];
                x[n++].weight = detail ? powf(fmaxf(v->splat[i].largest, 1e-9f), -2) : 1;
            }
        if (n == 0)
            return spin_unsupported("all splats are transparent");
        qsort(x, n, sizeof *x, spin_by_float);
        low[c] = detail ? weighted_quantile(x, n, 0.01) : (double)x[n / 100].at;
        high[c] = detail ? weighted_quantile(x, n, 0.99) : (double)x[n - 1 - n / 100].at;
    }
    return SPIN_OK;
}

static double longest_side(const double low[3], const double high[3])
{
    return fmax(high[0] - low[0], fmax(high[1] - low[1], high[2] - low[2]));
}

/* Sets low and high to the bounding box of the scene. An unbounded scene, with a sky or a wide
 * landscape of large splats, is reduced to its detailed part. */
static spin_status find_scene(const struct spin_voxels *v, double low[3], double high[3])
{
    double near[2][3];

    SPIN_TRY(find_bounds(v, false, low, high));
    SPIN_TRY(find_bounds(v, true, near[0], near[1]));
    if (longest_side(low, high) <= UNBOUNDED * longest_side(near[0], near[1]))
        return SPIN_OK;
    for (int c = 0; c < 3; c++) {
        double margin = CONTEXT * longest_side(near[0], near[1]);

        low[c] = fmax(low[c], near[0][c] - margin);
        high[c] = fmin(high[c], near[1][c] + margin);
    }
    return SPIN_OK;
}

/* Centres the grid on the bounding box, so that a scene that is turned upside down gets the same
 * cells. */
static spin_status set_grid(struct spin_voxels *v)
{
    double low[3], high[3], side;

    SPIN_TRY(find_scene(v, low, high));
    side = longest_side(low, high);
    side = side > 0 ? side : 1;
    v->cell = 1.1 * side / SPIN_VOXEL_SIDE;
    v->n = 1;
    for (int c = 0; c < 3; c++) {
        v->dim[c] = (int)ceil((high[c] - low[c] + 0.1 * side) / v->cell - 1e-6);
        v->low[c] = 0.5 * (low[c] + high[c]) - 0.5 * v->dim[c] * v->cell;
        v->n *= (size_t)v->dim[c];
    }
    return SPIN_OK;
}

size_t spin_voxels_find(const struct spin_voxels *v, const double at[3])
{
    size_t cell = 0;

    for (int c = 0; c < 3; c++) {
        double i = floor((at[c] - v->low[c]) / v->cell);

        if (!(i >= 0 && i < v->dim[c]))
            return SIZE_MAX;
        cell = cell * (size_t)v->dim[c] + (size_t)i;
    }
    return cell;
}

void spin_voxels_centre(const struct spin_voxels *v, size_t cell, double out[3])
{
    for (int c = 2; c >= 0; c--) {
        out[c] = v->low[c] + v->cell * ((double)(cell % (size_t)v->dim[c]) + 0.5);
        cell /= (size_t)v->dim[c];
    }
}

/* Returns the cell that contains part k of a splat: its centre or an end of one of its axes. */
static size_t cell_of_part(const struct spin_voxels *v, const struct spin_voxel_splat *s, int k)
{
    double at[3], side = k == 0 ? 0 : k % 2 ? 1 : -1;

    for (int c = 0; c < 3; c++)
        at[c] = (double)s->at[c] + side * (double)s->axis[k > 2][c];
    return spin_voxels_find(v, at);
}

static size_t cell_of(const struct spin_voxels *v, const struct spin_voxel_splat *s)
{
    const double at[3] = {(double)s->at[0], (double)s->at[1], (double)s->at[2]};

    return spin_voxels_find(v, at);
}

/* Replaces each cell by the mean over its neighbourhood of 3 x 3 x 3 cells, where cells outside the
 * grid count as 0. */
static spin_status blur(const struct spin_voxels *v, float *field)
{
    size_t step[3] = {(size_t)v->dim[1] * (size_t)v->dim[2], (size_t)v->dim[2], 1};
    SPIN_FREED float *copy = NULL;

    SPIN_TRY(spin_alloc(v->n, sizeof *copy, (void **)&copy));
    for (int c = 0; c < 3; c++) {
        memcpy(copy, field, v->n * sizeof *copy);
        for (size_t i = 0; i < v->n; i++) {
            size_t at = i / step[c] % (size_t)v->dim[c];
            float before = at > 0 ? copy[i - step[c]] : 0;
            float after = at + 1 < (size_t)v->dim[c] ? copy[i + step[c]] : 0;

            field[i] = (before + copy[i] + after) / 3;
        }
    }
    return SPIN_OK;
}

double spin_voxels_area(const struct spin_voxels *v, const struct spin_voxel_splat *s)
{
    return (double)s->count * fmin((double)s->area, (double)s->opacity * v->cell * v->cell);
}

/* Adds the areas of the splats of sampled frame f, or of all frames if f is -1, to the cells of
 * `field`. Each area is multiplied by the factor that `channel` selects. 0 to 2: this channel of
 * the splat's colour; 3: the squared length of the colour; -1: no factor. */
static void add_mass(const struct spin_voxels *v, int f, int channel, float *field)
{
    for (size_t i = 0; i < v->n_splats; i++) {
        const struct spin_voxel_splat *s = &v->splat[i];
        size_t cell = f < 0 || s->frame == f ? cell_of(v, s) : SIZE_MAX;
        float area = (float)spin_voxels_area(v, s);

        if (cell == SIZE_MAX)
            continue;
        if (channel == 3)
            area *= s->rgb[0] * s->rgb[0] + s->rgb[1] * s->rgb[1] + s->rgb[2] * s->rgb[2];
        field[cell] += channel < 0 || channel == 3 ? area : area * s->rgb[channel];
    }
}

/* Returns whether a splat may extend into the grid. */
static bool touches_grid(const struct spin_voxels *v, const struct spin_voxel_splat *s)
{
    double reach = EXTENT * (double)s->largest;

    for (int c = 0; c < 3; c++) {
        double at = (double)s->at[c] - v->low[c];

        if (at < -reach || at > v->dim[c] * v->cell + reach)
            return false;
    }
    return true;
}

/* Adds a splat as samples of the ellipse of its two longest axes. The samples are at most a third
 * of a cell apart, unless the splat is very large. */
static void add_large(const struct spin_voxels *v, const struct spin_voxel_splat *s, float *field)
{
    double step[2], weight = (double)(s->area * s->count) / (2 * M_PI);
    int n[2];

    for (int axis = 0; axis < 2; axis++) {
        const float *x = s->axis[axis];
        double length = sqrt((double)(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]));

        n[axis] = (int)fmin(ceil(3 * EXTENT * length / v->cell) + 1, MOST_SAMPLES);
        step[axis] = EXTENT / n[axis];
        weight *= step[axis];
    }
    for (int i = 0; i < 2 * n[0]; i++)
        for (int k = 0; k < 2 * n[1]; k++) {
            double a = (i + 0.5 - n[0]) * step[0], b = (k + 0.5 - n[1]) * step[1], at[3];
            size_t cell;

            for (int c = 0; c < 3; c++)
                at[c] = (double)s->at[c] + a * (double)s->axis[0][c] + b * (double)s->axis[1][c];
            cell = spin_voxels_find(v, at);
            if (cell != SIZE_MAX)
                field[cell] += (float)(weight * exp(-0.5 * (a * a + b * b)));
        }
}

/* Adds a splat to a field. If it is larger than a cell, its parts are added to several cells. */
static void add_parts(const struct spin_voxels *v, const struct spin_voxel_splat *s, float *field)
{
    int n = (double)s->largest < 0.5 * v->cell ? 1 : 5;
    double most = (double)s->opacity * v->cell * v->cell;

    for (int k = 0; k < n; k++) {
        size_t cell = cell_of_part(v, s, k);

        if (cell != SIZE_MAX)
            field[cell] += s->count * (float)fmin((double)s->area / n, most);
    }
}

static void add_extents(struct spin_voxels *v)
{
    for (size_t i = 0; i < v->n_splats; i++) {
        const struct spin_voxel_splat *s = &v->splat[i];

        add_parts(v, s, v->opacity);
        if ((double)s->largest <= LARGE * v->cell)
            add_parts(v, s, v->haze);
        else if (touches_grid(v, s))
            add_large(v, s, v->haze);
    }
}

static spin_status make_masses(struct spin_voxels *v)
{
    SPIN_TRY(spin_alloc(v->n, sizeof(float), (void **)&v->mean));
    for (int f = 0; f < v->n_frames; f++) {
        SPIN_TRY(spin_alloc(v->n, sizeof(float), (void **)&v->mass[f]));
        add_mass(v, f, -1, v->mass[f]);
        SPIN_TRY(blur(v, v->mass[f]));
        for (size_t i = 0; i < v->n; i++)
            v->mean[i] += v->mass[f][i] / (float)v->n_frames;
    }
    return SPIN_OK;
}

static spin_status make_colours(struct spin_voxels *v)
{
    for (int c = 0; c < 4; c++) {
        SPIN_TRY(spin_alloc(v->n, sizeof(float), (void **)&v->colour[c]));
        add_mass(v, -1, c, v->colour[c]);
        SPIN_TRY(blur(v, v->colour[c]));
        for (size_t i = 0; i < v->n; i++)
            v->colour[c][i] /= fmaxf(v->mean[i] * (float)v->n_frames, 1e-30f);
    }
    return SPIN_OK;
}

/* Returns the 40th percentile of the masses of one cell over the frames. It is small where an
 * object only passes by, and large in a flickering wall. */
static float wall_mass(const struct spin_voxels *v, size_t cell)
{
    float mass[SPIN_VOXEL_FRAMES];
    double at = 0.4 * (v->n_frames - 1);
    int k = (int)at;

    for (int f = 0; f < v->n_frames; f++)
        mass[f] = v->mass[f][cell];
    qsort(mass, (size_t)v->n_frames, sizeof *mass, spin_by_float);
    return k + 1 < v->n_frames ? mass[k] + (float)(at - k) * (mass[k + 1] - mass[k]) : mass[k];
}

static spin_status make_extinctions(struct spin_voxels *v)
{
    float volume = (float)(v->cell * v->cell * v->cell);

    SPIN_TRY(spin_alloc(v->n, sizeof(float), (void **)&v->opacity));
    SPIN_TRY(spin_alloc(v->n, sizeof(float), (void **)&v->walls));
    SPIN_TRY(spin_alloc(v->n, sizeof(float), (void **)&v->haze));
    add_extents(v);
    for (size_t i = 0; i < v->n; i++) {
        v->opacity[i] /= volume * (float)v->n_frames;
        v->haze[i] /= volume * (float)v->n_frames;
        v->walls[i] = wall_mass(v, i) / volume;
    }
    return SPIN_OK;
}

spin_status spin_voxels_open(struct spin_voxels *v, int n_frames, spin_voxel_read_fn read,
                             void *context)
{
    spin_status status;

    memset(v, 0, sizeof *v);
    SPIN_TRY_OUT(read_frames(v, n_frames, read, context));
    SPIN_TRY_OUT(set_grid(v));
    SPIN_TRY_OUT(make_masses(v));
    SPIN_TRY_OUT(make_colours(v));
    SPIN_TRY_OUT(make_extinctions(v));
    return SPIN_OK;
out:
    spin_voxels_close(v);
    return status;
}

void spin_voxels_close(struct spin_voxels *v)
{
    for (int f = 0; f < SPIN_VOXEL_FRAMES; f++)
        free(v->mass[f]);
    for (int c = 0; c < 4; c++)
        free(v->colour[c]);
    free(v->mean);
    free(v->opacity);
    free(v->haze);
    free(v->walls);
    free(v->splat);
    memset(v, 0, sizeof *v);
}

/* ---- Queries --------------------------------------------------------------------------------- */

double spin_voxels_depth(const struct spin_voxels *v, const float *field, const double from[3],
                         const double along[3], int n)
{
    double sum = 0, length = 0;

    for (int k = 0; k < n; k++) {
        double t = (k + 0.5) / n;
        double at[3] = {from[0] + t * along[0], from[1] + t * along[1], from[2] + t * along[2]};
        size_t cell = spin_voxels_find(v, at);

        sum += cell == SIZE_MAX ? 0 : (double)field[cell];
    }
    for (int c = 0; c < 3; c++)
        length += along[c] * along[c];
    return sum * sqrt(length) / n;
}

bool spin_voxels_moves(const struct spin_voxels *v, const struct spin_voxel_splat *s)
{
    size_t cell = cell_of(v, s);
    double mean[3], off = 0, square = 0, spread;
    int present = 0;

    if (cell == SIZE_MAX || v->n_frames < 2)
        return false;
    for (int f = 0; f < v->n_frames; f++)
        present += v->mass[f][cell] > 0.35f * v->mean[cell];
    for (int c = 0; c < 3; c++) {
        mean[c] = (double)v->colour[c][cell];
        square += mean[c] * mean[c];
        off += ((double)s->rgb[c] - mean[c]) * ((double)s->rgb[c] - mean[c]);
    }
    spread = sqrt(fmax((double)v->colour[3][cell] - square, 0));
    return present < 0.8 * v->n_frames || sqrt(off) > 0.12 + 2 * spread;
}
