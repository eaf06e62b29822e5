/* Places the backdrop behind the farthest points along the rays of the training cameras.
 *
 * The image of each view is divided into a grid of cells. The farthest points that project into a
 * cell form the outermost surface of the cell. A flat splat of about the size of the cell is placed
 * behind that surface, so far behind that sorting by depth always puts it behind the splats of the
 * surface. While the splat is in front of the outermost surface of any other view, it is moved away
 * from the camera. It is dropped if the backdrop already has a splat at that position.
 *
 * Finally, surfaces are extended into directions that no training view shows: holes in the
 * surroundings, and a margin of 14 degrees around them. Their radius and colour are interpolated.
 */
#include "train/backdrop.h"

#include "base/base.h"
#include "eval/matte.h"
#include "math/covariance.h"
#include "math/sh.h"
#include "scene/columns.h"

enum {
    MOST_FRAMES = 16,    /* largest number of frames whose points are sampled */
    MOST_POINTS = 20000, /* largest number of points sampled in a frame */
    MOST_VIEWS = 64,     /* largest number of views for which splats are placed */
    LEAST_COLUMNS = 8,   /* limits of the number of cells along the width of an image */
    MOST_COLUMNS = 40,
    MOST_ROWS = 64,
    CELL_POINTS = 12, /* number of points of a frame that a cell contains on average */
    N_BINS = 96,      /* bins of log depth in a cell */
    DEPTH_BINS = 3,   /* number of adjacent bins that form a surface */
    MOST_SPLATS = 20000,
    MOST_STEPS = 40,       /* largest number of steps of 5 % away from the camera: 7 times as far */
    N_DIRECTIONS = 2048,   /* directions from the centre of the scene, 4.5 degrees apart */
    N_SECTORS = 8,         /* sectors around a direction, */
    ENCLOSING_SECTORS = 6, /* and how many of them must contain visible surfaces */
    /* With fewer splats per frame, --backdrop auto means off: too few splats do not locate the
       surfaces. */
    FEWEST_SPLATS = 1000
};
/* The farthest points of a cell, up to this share of its points, are ignored as outliers. */
static const double far_share = 0.005;
static const double behind = 2; /* distance of a splat from the surface, in cells */
/* Standard deviation along the surface, in units of the spacing of splats. */
static const double scale = 1;
static const double most_scale = 2; /* largest spacing of splats on slanted surfaces, in cells */
/* Standard deviation perpendicular to the surface, in units of the spacing of splats. */
static const double thickness = 0.1;
/* Radius of the rim of a splat, in standard deviations. The centre and four points of the rim must
 * not be in front of a surface. */
static const double reach = 2;
/* A splat is in front of a surface if its log depth is smaller than that of the surface by more
 * than this value. */
static const double tolerance = 0.03;
/* A splat is dropped if its distance from an earlier splat is less than this, in units of the
 * larger spacing of the two splats. */
static const double covered = 0.7;
/* Minimum of a colour channel, since a channel at 0 would have no gradient. */
static const double darkest = 0.02;
/* A direction that no view shows is closed if some view shows a direction within the first angle
 * (radians) of it, or if views show directions within the second angle in ENCLOSING_SECTORS of the
 * sectors around it. */
static const double adjoining_angle = 0.25, enclosing_angle = 1.3;
static const float logit_opacity = 5; /* opacity 0.993 */

struct cell {
    bool known;
    double log_depth, colour[3];
    double at[3]; /* world position of the surface at the centre of the cell */
};

struct view {
    const struct spin_camera *camera;
    int columns, rows;
    struct cell *cell;
};

struct layout {
    float *point, *colour; /* [n][3] */
    size_t n;
    int n_frames; /* number of sampled frames */
    struct view view[MOST_VIEWS];
    int n_views;
    struct spin_backdrop *out;
    float *spacing; /* [MOST_SPLATS] result of spacing_of() for each splat of the backdrop */
};

static void close_layout(struct layout *l)
{
    free(l->point);
    free(l->spacing);
    for (int i = 0; i < l->n_views; i++)
        free(l->view[i].cell);
}

/* ---- Points ---------------------------------------------------------------------------------- */

static void add_point(struct layout *l, const struct spin_splats *s, size_t i)
{
    size_t width = spin_column_width(SPIN_COL_SH, s->sh_degree);

    for (size_t c = 0; c < 3; c++) {
        l->point[3 * l->n + c] = s->means[3 * i + c];
        l->colour[3 * l->n + c] = s->rgb  ? s->rgb[3 * i + c]
                                  : s->sh ? (float)SPIN_SH_C0 * s->sh[i * width + c] + 0.5f
                                          : 0.5f;
    }
    l->n++;
}

static spin_status sample_points(struct layout *l, struct spin_plan *plan)
{
    int n_frames = plan->clip.n_frames, used = n_frames < MOST_FRAMES ? n_frames : MOST_FRAMES;
    size_t most = (size_t)used * MOST_POINTS;
    unsigned colours = plan->clip.bundle.meta.columns & (SPIN_COL_RGB | SPIN_COL_SH);
    SPIN_LEAVES(spin_splats_free) struct spin_splats s = {0};

    SPIN_TRY(spin_alloc(most, 6 * sizeof *l->point, (void **)&l->point));
    l->colour = l->point + 3 * most;
    l->n_frames = used;
    for (int k = 0; k < used; k++) {
        int frame = (int)((int64_t)k * n_frames / used);
        size_t step;

        SPIN_TRY(spin_bundle_frame(&plan->clip.bundle, spin_plan_index(plan, frame),
                                   SPIN_COL_MEANS | colours, &s));
        SPIN_TRY(spin_plan_check_means(plan, frame, false, &s));
        step = s.n / MOST_POINTS + 1;
        for (size_t i = (size_t)k % step; i < s.n; i += step)
            add_point(l, &s, i);
    }
    return SPIN_OK;
}

/* ---- Surfaces -------------------------------------------------------------------------------- */

/* Returns the cell of a view into which a point projects, and sets *depth to the depth of the
 * point. Returns NULL if the projection is outside the image. */
static struct cell *cell_of(const struct view *v, const float point[3], double *depth)
{
    double p[3], x, y;

    if (!spin_camera_project(v->camera, point, p))
        return NULL;
    x = floor(p[0] / v->camera->width * v->columns);
    y = floor(p[1] / v->camera->height * v->rows);
    *depth = p[2];
    return x >= 0 && y >= 0 && x < v->columns && y < v->rows
               ? &v->cell[(size_t)y * (size_t)v->columns + (size_t)x]
               : NULL;
}

struct bin {
    double n, log_depth, colour[3];
};

/* Sets the surface of a cell to the mean of its farthest points: skips outliers, beginning with the
 * farthest bin, then averages the farthest remaining bin and the DEPTH_BINS - 1 bins in front of
 * that bin. */
static void find_surface(const struct bin *bin, struct cell *cell)
{
    double all = 0, behind_it = 0;
    struct bin sum = {0};
    int k = N_BINS - 1;

    for (int i = 0; i < N_BINS; i++)
        all += bin[i].n;
    cell->known = all > 0;
    if (!cell->known)
        return;
    while (k > 0 && behind_it + bin[k].n < fmin(all, fmax(2, far_share * all)))
        behind_it += bin[k--].n;
    for (int i = k; i >= 0 && i > k - DEPTH_BINS; i--) {
        sum.n += bin[i].n;
        sum.log_depth += bin[i].log_depth;
        for (int c = 0; c < 3; c++)
            sum.colour[c] += bin[i].colour[c];
    }
    cell->log_depth = sum.log_depth / sum.n;
    for (int c = 0; c < 3; c++)
        cell->colour[c] = sum.colour[c] / sum.n;
}

static spin_status find_surfaces(const struct layout *l, struct view *v)
{
    int n = v->columns * v->rows;
    double near = INFINITY, far = 0, depth;
    SPIN_FREED struct bin *bin = NULL;

    SPIN_TRY(spin_alloc((size_t)n, N_BINS * sizeof *bin, (void **)&bin));
    for (size_t i = 0; i < l->n; i++)
        if (cell_of(v, l->point + 3 * i, &depth)) {
            near = fmin(near, depth);
            far = fmax(far, depth);
        }
    for (size_t i = 0; i < l->n; i++) {
        const struct cell *cell = cell_of(v, l->point + 3 * i, &depth);
        struct bin *to;

        if (!cell)
            continue;
        to = bin + (cell - v->cell) * N_BINS +
             (int)fmin(N_BINS - 1, log(depth / near) / log(far / near + 1e-9) * N_BINS);
        to->n++;
        to->log_depth += log(depth);
        for (int c = 0; c < 3; c++)
            to->colour[c] += (double)l->colour[3 * i + (size_t)c];
    }
    for (int i = 0; i < n; i++)
        find_surface(bin + i * N_BINS, &v->cell[i]);
    return SPIN_OK;
}

static const struct cell *neighbour(const struct view *v, int i, int dx, int dy)
{
    int x = i % v->columns + dx, y = i / v->columns + dy;

    return x >= 0 && y >= 0 && x < v->columns && y < v->rows ? &v->cell[y * v->columns + x] : NULL;
}

/* Fills cells without points: sets each to the mean of its known neighbours, and repeats this until
 * all cells are known. */
static spin_status fill_cells(struct view *v)
{
    int n = v->columns * v->rows;
    bool changed = true;
    SPIN_FREED struct cell *next = NULL;

    SPIN_TRY(spin_alloc((size_t)n, sizeof *next, (void **)&next));
    while (changed) {
        changed = false;
        memcpy(next, v->cell, (size_t)n * sizeof *next);
        for (int i = 0; i < n; i++) {
            double count = 0;
            struct cell mean = {0};

            for (int k = 0; k < 9 && !v->cell[i].known; k++) {
                const struct cell *from = neighbour(v, i, k % 3 - 1, k / 3 - 1);

                if (!from || !from->known)
                    continue;
                count++;
                mean.log_depth += from->log_depth;
                for (int c = 0; c < 3; c++)
                    mean.colour[c] += from->colour[c];
            }
            if (count == 0)
                continue;
            changed = next[i].known = true;
            next[i].log_depth = mean.log_depth / count;
            for (int c = 0; c < 3; c++)
                next[i].colour[c] = mean.colour[c] / count;
        }
        memcpy(v->cell, next, (size_t)n * sizeof *next);
    }
    return SPIN_OK;
}

/* Computes the world position of the surface at the centre of cell i. */
static void unproject_cell(const struct view *v, int i)
{
    const struct spin_camera *c = v->camera;
    const double *m = c->w2c;
    double z = exp(v->cell[i].log_depth), p[3];

    p[0] = ((i % v->columns + 0.5) / v->columns * c->width - c->cx) / c->fx * z - m[3];
    p[1] = ((i / v->columns + 0.5) / v->rows * c->height - c->cy) / c->fy * z - m[7];
    p[2] = z - m[11];
    for (int k = 0; k < 3; k++)
        v->cell[i].at[k] = m[k] * p[0] + m[4 + k] * p[1] + m[8 + k] * p[2];
}

/* Returns the number of columns of a grid whose cells contain CELL_POINTS points of a frame on
 * average. In smaller cells, the outermost surface is unreliable, and the backdrop could occlude
 * real surfaces: on the clip "court-mini" (docs/results.md), the backdrop lowers the PSNR by 0.6 dB
 * with a finer grid of 40 columns, and raises it by 0.6 dB with the grid chosen here. */
static int choose_columns(const struct layout *l, const struct spin_camera *camera)
{
    double visible = 0, columns, p[3];

    for (size_t i = 0; i < l->n; i++)
        visible += spin_camera_project_visible(camera, l->point + 3 * i, p);
    columns = sqrt(visible / l->n_frames / CELL_POINTS * camera->width / camera->height);
    return (int)fmin(MOST_COLUMNS, fmax(LEAST_COLUMNS, round(columns)));
}

static spin_status open_view(struct layout *l, const struct spin_camera *camera)
{
    struct view *v = &l->view[l->n_views];
    double rows;

    v->camera = camera;
    v->columns = choose_columns(l, camera);
    rows = round((double)v->columns * camera->height / camera->width);
    v->rows = rows < 1 ? 1 : rows > MOST_ROWS ? MOST_ROWS : (int)rows;
    SPIN_TRY(spin_alloc((size_t)(v->columns * v->rows), sizeof *v->cell, (void **)&v->cell));
    l->n_views++;
    SPIN_TRY(find_surfaces(l, v));
    SPIN_TRY(fill_cells(v));
    for (int i = 0; i < v->columns * v->rows; i++)
        unproject_cell(v, i);
    return SPIN_OK;
}

/* ---- Splats ---------------------------------------------------------------------------------- */

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Scales a vector to length 1; leaves a zero vector unchanged. Returns the original length. */
static double normalise(double v[3])
{
    double length = sqrt(dot(v, v));

    for (int c = 0; c < 3; c++)
        v[c] /= length > 0 ? length : 1;
    return length;
}

static void cross(const double a[3], const double b[3], double out[3])
{
    for (int c = 0; c < 3; c++)
        out[c] = a[(c + 1) % 3] * b[(c + 2) % 3] - a[(c + 2) % 3] * b[(c + 1) % 3];
}

/* A flat splat under construction. */
struct patch {
    /* Centre, and unit axes: two along the surface, and the normal, which points away from the
     * camera. */
    double at[3], axis[3][3];
    double size[2]; /* distance of adjacent splats along the first two axes */
};

/* out = derivative of the surface's position along the direction (dx, dy) at cell i, per cell, by
 * central differences; one-sided at the border of the image. */
static void find_surface_step(const struct view *v, int i, int dx, int dy, double out[3])
{
    const struct cell *from = neighbour(v, i, -dx, -dy), *to = neighbour(v, i, dx, dy);
    double cells = from && to ? 2 : 1;

    from = from ? from : &v->cell[i];
    to = to ? to : &v->cell[i];
    for (int c = 0; c < 3; c++)
        out[c] = (to->at[c] - from->at[c]) / cells;
}

static void init_patch(const struct view *v, int i, struct patch *p)
{
    double cell = exp(v->cell[i].log_depth) * v->camera->width / v->camera->fx / v->columns, ray[3];
    struct spin_camera_f32 camera = spin_camera_f32_from(v->camera);

    for (int c = 0; c < 3; c++)
        ray[c] = v->cell[i].at[c] - (double)camera.centre[c];
    find_surface_step(v, i, 1, 0, p->axis[0]);
    find_surface_step(v, i, 0, 1, p->axis[1]);
    p->size[0] = normalise(p->axis[0]);
    cross(p->axis[0], p->axis[1], p->axis[2]);
    normalise(p->axis[2]);
    for (int c = 0; c < 3 && dot(p->axis[2], ray) < 0; c++)
        p->axis[2][c] = -p->axis[2][c];
    p->size[1] = sqrt(dot(p->axis[1], p->axis[1]));
    cross(p->axis[2], p->axis[0], p->axis[1]);
    for (int k = 0; k < 2; k++)
        p->size[k] = fmin(p->size[k], most_scale * cell);
    for (int c = 0; c < 3; c++)
        p->at[c] = v->cell[i].at[c] + behind * cell * p->axis[2][c];
}

static bool is_in_front(const struct layout *l, const struct patch *p, double x, double y)
{
    float at[3];

    for (int c = 0; c < 3; c++)
        at[c] = (float)(p->at[c] + x * scale * p->size[0] * p->axis[0][c] +
                        y * scale * p->size[1] * p->axis[1][c]);
    for (int k = 0; k < l->n_views; k++) {
        double depth;
        const struct cell *cell = cell_of(&l->view[k], at, &depth);

        if (cell && cell->known && log(depth) < cell->log_depth - tolerance)
            return true;
    }
    return false;
}

/* True if the centre or one of four points of the rim of the splat is in front of the outermost
 * surface of any view. */
static bool sticks_out(const struct layout *l, const struct patch *p)
{
    return is_in_front(l, p, 0, 0) || is_in_front(l, p, reach, 0) || is_in_front(l, p, -reach, 0) ||
           is_in_front(l, p, 0, reach) || is_in_front(l, p, 0, -reach);
}

static double spacing_of(const struct patch *p) { return sqrt(p->size[0] * p->size[1]); }

static bool is_covered(const struct layout *l, const struct patch *p)
{
    for (size_t i = 0; i < l->out->n; i++) {
        double d2 = 0, least = covered * fmax(spacing_of(p), (double)l->spacing[i]);

        for (int c = 0; c < 3; c++)
            d2 += pow(p->at[c] - (double)l->out->row[i].pos_w[c], 2);
        if (d2 < least * least)
            return true;
    }
    return false;
}

static void push_back(const struct view *v, struct patch *p)
{
    const double step = 1.05;
    struct spin_camera_f32 camera = spin_camera_f32_from(v->camera);

    for (int c = 0; c < 3; c++)
        p->at[c] = (double)camera.centre[c] + step * (p->at[c] - (double)camera.centre[c]);
    for (int k = 0; k < 2; k++)
        p->size[k] *= step;
}

static void add_splat(struct layout *l, const struct patch *p, const double colour[3])
{
    const double sigma[3] = {scale * p->size[0], scale * p->size[1], thickness * spacing_of(p)};
    double r[9], q[4];
    struct spin_refine_row *row = &l->out->row[l->out->n];

    for (int k = 0; k < 9; k++)
        r[k] = p->axis[k % 3][k / 3];
    spin_quat_of_matrix(r, q);
    for (int k = 0; k < 4; k++)
        row->rotation[k] = (float)q[k];
    for (int c = 0; c < 3; c++) {
        row->pos_w[c] = (float)p->at[c];
        row->log_scale[c] = (float)log(fmax(sigma[c], 1e-12));
        row->dc[c] = (float)((fmax(colour[c], darkest) - 0.5) / SPIN_SH_C0);
    }
    row->logit_opacity = logit_opacity;
    l->spacing[l->out->n++] = (float)spacing_of(p);
}

static void add_view(struct layout *l, const struct view *v)
{
    for (int i = 0; i < v->columns * v->rows && l->out->n < MOST_SPLATS; i++) {
        struct patch p;
        int steps = 0;

        if (!v->cell[i].known)
            continue;
        init_patch(v, i, &p);
        while (!is_covered(l, &p) && sticks_out(l, &p) && steps++ < MOST_STEPS)
            push_back(v, &p);
        if (steps <= MOST_STEPS && !is_covered(l, &p))
            add_splat(l, &p, v->cell[i].colour);
    }
}

/* ---- Directions that no view shows ----------------------------------------------------------- */

/* The surroundings in one direction from the mean position of the cameras. */
struct direction {
    double axis[3]; /* unit vector */
    double n;       /* number of cells of the views in this direction */
    double log_radius, colour[3];
};

/* Sets the axes to N_DIRECTIONS unit vectors that cover the sphere evenly: a Fibonacci lattice. */
static void spread_directions(struct direction *d)
{
    const double golden_angle = M_PI * (3 - sqrt(5));

    for (int i = 0; i < N_DIRECTIONS; i++) {
        double y = 1 - (2 * i + 1.0) / N_DIRECTIONS, r = sqrt(1 - y * y);

        d[i].axis[0] = r * cos(golden_angle * i);
        d[i].axis[1] = y;
        d[i].axis[2] = r * sin(golden_angle * i);
    }
}

/* Adds the surface of a cell to the nearest direction. */
static void add_cell(const struct cell *cell, const double centre[3], struct direction *d)
{
    double ray[3], radius, largest = -2;
    struct direction *nearest = d;

    for (int c = 0; c < 3; c++)
        ray[c] = cell->at[c] - centre[c];
    radius = normalise(ray);
    if (!cell->known || !(radius > 0))
        return;
    for (int i = 0; i < N_DIRECTIONS; i++) {
        double cosine = dot(ray, d[i].axis);

        if (cosine > largest) {
            largest = cosine;
            nearest = &d[i];
        }
    }
    nearest->n++;
    nearest->log_radius += log(radius);
    for (int c = 0; c < 3; c++)
        nearest->colour[c] += cell->colour[c];
}

static void find_directions(const struct layout *l, const double centre[3], struct direction *d)
{
    spread_directions(d);
    for (int k = 0; k < l->n_views; k++)
        for (int i = 0; i < l->view[k].columns * l->view[k].rows; i++)
            add_cell(&l->view[k].cell[i], centre, d);
    for (int i = 0; i < N_DIRECTIONS; i++) {
        double n = fmax(1, d[i].n);

        d[i].log_radius /= n;
        for (int c = 0; c < 3; c++)
            d[i].colour[c] /= n;
    }
}

/* Sets two unit vectors perpendicular to a unit vector and to each other. */
static void find_tangents(const double axis[3], double a[3], double b[3])
{
    const double helper[3] = {fabs(axis[0]) <= 0.7, fabs(axis[0]) > 0.7, 0};

    cross(axis, helper, a);
    normalise(a);
    cross(axis, a, b);
}

/* Sets the radius and colour of a direction to means of those that views show, weighted by the
 * inverse cube of the angle. Returns false if the direction is at an open side of the scene, where
 * a wall would hide the scene from the outside. */
static bool extrapolate(const struct direction *d, struct direction *to)
{
    double a[3], b[3], nearest = M_PI, sum = 0;
    unsigned sectors = 0;

    find_tangents(to->axis, a, b);
    for (int i = 0; i < N_DIRECTIONS; i++) {
        double angle, weight, turn;

        if (d[i].n == 0)
            continue;
        angle = acos(fmin(1, fmax(-1, dot(d[i].axis, to->axis))));
        turn = atan2(dot(d[i].axis, b), dot(d[i].axis, a)) / (2 * M_PI) + 0.5;
        if (angle < enclosing_angle)
            sectors |= 1U << (int)fmin(N_SECTORS - 1, turn * N_SECTORS);
        nearest = fmin(nearest, angle);
        weight = pow(angle, -3);
        sum += weight;
        to->log_radius += weight * d[i].log_radius;
        for (int c = 0; c < 3; c++)
            to->colour[c] += weight * d[i].colour[c];
    }
    to->log_radius /= sum;
    for (int c = 0; c < 3; c++)
        to->colour[c] /= sum;
    return nearest < adjoining_angle || __builtin_popcount(sectors) >= ENCLOSING_SECTORS;
}

/* Returns the smallest radius at which a splat in this direction is behind all cameras near it. */
static double radius_behind_cameras(const struct layout *l, const double centre[3],
                                    const double axis[3])
{
    const double near_cosine = 0.866, distance_behind = 1.2;
    double radius = 0;

    for (int k = 0; k < l->n_views; k++) {
        struct spin_camera_f32 camera = spin_camera_f32_from(l->view[k].camera);
        double ray[3], distance;

        for (int c = 0; c < 3; c++)
            ray[c] = (double)camera.centre[c] - centre[c];
        distance = normalise(ray);
        if (dot(ray, axis) > near_cosine)
            radius = fmax(radius, distance_behind * distance);
    }
    return radius;
}

/* Adds a splat in a direction. While it is in front of a surface of a view, its radius is
 * increased. */
static void close_direction(struct layout *l, const double centre[3], const struct direction *to)
{
    const double spacing = sqrt(4 * M_PI / N_DIRECTIONS), step = 1.05;
    double radius = fmax(step * exp(to->log_radius), radius_behind_cameras(l, centre, to->axis));
    struct patch p;

    memcpy(p.axis[2], to->axis, sizeof p.axis[2]);
    find_tangents(to->axis, p.axis[0], p.axis[1]);
    for (int k = 0; k < MOST_STEPS && l->out->n < MOST_SPLATS; k++, radius *= step) {
        for (int c = 0; c < 3; c++)
            p.at[c] = centre[c] + radius * to->axis[c];
        p.size[0] = p.size[1] = spacing * radius;
        if (sticks_out(l, &p))
            continue;
        if (!is_covered(l, &p))
            add_splat(l, &p, to->colour);
        return;
    }
}

/* Extends the surfaces into directions that no training view shows. */
static spin_status close_directions(struct layout *l)
{
    double centre[3] = {0};
    SPIN_FREED struct direction *d = NULL;

    SPIN_TRY(spin_alloc(N_DIRECTIONS, sizeof *d, (void **)&d));
    for (int k = 0; k < l->n_views; k++)
        for (int c = 0; c < 3; c++)
            centre[c] += (double)spin_camera_f32_from(l->view[k].camera).centre[c] / l->n_views;
    find_directions(l, centre, d);
    for (int i = 0; i < N_DIRECTIONS; i++) {
        struct direction to = d[i];

        if (to.n == 0 && extrapolate(d, &to))
            close_direction(l, centre, &to);
    }
    return SPIN_OK;
}

static size_t common_divisor(size_t a, size_t b)
{
    while (b > 0) {
        size_t rest = a % b;

        a = b;
        b = rest;
    }
    return a;
}

static spin_status place_splats(struct spin_plan *plan)
{
    size_t n = plan->n_train < MOST_VIEWS ? plan->n_train : MOST_VIEWS;
    size_t step = plan->n_train / n + 1;
    SPIN_LEAVES(close_layout) struct layout l = {.out = &plan->backdrop};

    SPIN_TRY(sample_points(&l, plan));
    SPIN_TRY(spin_alloc(MOST_SPLATS, sizeof *l.spacing, (void **)&l.spacing));
    SPIN_TRY(spin_alloc(MOST_SPLATS, sizeof *l.out->row, (void **)&l.out->row));
    /* If the step and the number of cameras had a common divisor, only some of the cameras would be
     * used. */
    while (common_divisor(step, plan->n_train) > 1)
        step++;
    for (size_t i = 0; i < n; i++)
        SPIN_TRY(open_view(
            &l, &plan->clip.views.view[plan->train[i * step % plan->n_train].view].camera));
    for (int i = 0; i < l.n_views; i++)
        add_view(&l, &l.view[i]);
    return close_directions(&l);
}

/* ---- Tracks ---------------------------------------------------------------------------------- */

spin_status spin_backdrop_choose(struct spin_plan *plan, struct spin_photos *photos)
{
    enum spin_backdrop_choice *choice = &plan->report->options.backdrop;
    enum spin_surroundings surroundings;
    float colour[3];

    if (!plan->o->tracks || plan->o->refine > 0 || plan->o->method == SPIN_METHOD_4D)
        *choice = SPIN_BACKDROP_OFF;
    if (*choice == SPIN_BACKDROP_AUTO && plan->clip.n_mean < FEWEST_SPLATS)
        *choice = SPIN_BACKDROP_OFF;
    if (*choice != SPIN_BACKDROP_AUTO)
        return SPIN_OK;
    SPIN_TRY(spin_surroundings_find(&plan->clip.views, &photos->cache, plan->train, plan->n_train,
                                    &surroundings, colour));
    *choice = surroundings == SPIN_SURROUNDED_BY_SCENE ? SPIN_BACKDROP_ON : SPIN_BACKDROP_OFF;
    return SPIN_OK;
}

spin_status spin_backdrop_add(struct spin_plan *plan, struct spin_tracks *t)
{
    const struct spin_backdrop *b = &plan->backdrop;

    if (plan->o->backdrop != SPIN_BACKDROP_ON)
        return SPIN_OK;
    SPIN_TRY(place_splats(plan));
    SPIN_TRY(spin_grow((t->n + b->n + 1), 3 * sizeof *t->place, (void **)&t->place));
    for (size_t i = 0; i < b->n; i++)
        memcpy(t->place + 3 * (t->n + i), b->row[i].pos_w, 3 * sizeof *t->place);
    for (int f = 0; f < t->n_frames; f++) {
        size_t n = plan->counts[f];

        SPIN_TRY(spin_grow(n + b->n + 1, sizeof **t->of, (void **)&t->of[f]));
        for (size_t i = 0; i < b->n; i++)
            t->of[f][n + i] = (uint32_t)(t->n + i);
        plan->counts[f] += b->n;
    }
    t->n += b->n;
    t->n_backdrop = b->n;
    return SPIN_OK;
}

spin_status spin_backdrop_append(const struct spin_backdrop *b, struct spin_splats *s)
{
    struct spin_splats all = {0};
    unsigned columns = 0;

    if (b->n == 0)
        return SPIN_OK;
    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1)
        columns |= *spin_column_of(s, column) ? column : 0;
    SPIN_TRY(spin_splats_reserve(&all, s->n + b->n, columns, s->sh_degree));
    all.antialias = s->antialias;
    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) {
        size_t width = spin_column_width(column, s->sh_degree);
        float *to = *spin_column_of(&all, column);

        if (!(columns & column))
            continue;
        memcpy(to, *spin_column_of(s, column), s->n * width * sizeof *to);
        memset(to + s->n * width, 0, b->n * width * sizeof *to);
    }
    for (size_t i = 0; i < b->n; i++)
        memcpy(all.means + 3 * (s->n + i), b->row[i].pos_w, 3 * sizeof *all.means);
    spin_splats_free(s);
    *s = all;
    return SPIN_OK;
}

void spin_backdrop_first_values(const struct spin_backdrop *b, struct spin_refine_cloud *cloud)
{
    for (size_t i = 0; i < b->n; i++) {
        struct spin_refine_point *to = &cloud->point[cloud->n - b->n + i];

        to->p = b->row[i];
        to->seen = 1;
    }
}
