/* Outliers by median and median absolute deviation: up to half of the views may be wrong. */
#include "run/camera_check.h"

#include <math.h>
#include <stdlib.h>

#include "base/err.h"
#include "base/mem.h"
#include "base/number.h"
#include "run/camera_overlay.h"

/* Points that are looked at, evenly from all of them. */
#define POINTS 4096
/* Of fewer views there is no telling which is wrong. */
#define LEAST_VIEWS 4
/* How far below the median counts: so many standard deviations, estimated from the MAD, and at least
 * this share of the points. Cameras of one rig may well differ by less. */
#define DEVIATIONS 6
#define LEAST_GAP 0.25

struct look {
    size_t view;
    double share[2]; /* in front, inside */
};

static double median(double *values, size_t n)
{
    qsort(values, n, sizeof *values, spin_by_double);
    return n % 2 ? values[n / 2] : 0.5 * (values[n / 2 - 1] + values[n / 2]);
}

/* The median of one share over all views, and what lies below `limit` is far from it. */
static void judge(const struct look *look, size_t n, int which, double *values, double *middle,
                  double *limit)
{
    for (size_t i = 0; i < n; i++)
        values[i] = look[i].share[which];
    *middle = median(values, n);
    for (size_t i = 0; i < n; i++)
        values[i] = fabs(look[i].share[which] - *middle);
    *limit = *middle - fmax(LEAST_GAP, DEVIATIONS * 1.4826 * median(values, n));
}

/* The same camera in another view: what lies apart is kept, then what is lower. */
static bool is_lower(const struct spin_camera_share *a, const struct spin_camera_share *b)
{
    return a->apart != b->apart ? a->apart : a->inside < b->inside;
}

static void put(const struct spin_views *views, const struct spin_camera_share *one,
                struct spin_camera_shares *out)
{
    int id = views->view[one->view].camera_id;
    size_t k = 0;

    while (k < out->n && views->view[out->camera[k].view].camera_id != id)
        k++;
    if (k == out->n || is_lower(one, &out->camera[k]))
        out->camera[k] = *one;
    out->n += k == out->n;
}

/* Every view of the rows. */
static size_t look_at(const struct spin_views *views, const int *rows, int n_rows,
                      const struct spin_splats *s, struct look *look)
{
    size_t n = 0;

    for (int r = 0; r < n_rows; r++) {
        size_t first, n_views = spin_overlay_row(views, rows[r], &first);

        for (size_t v = first; v < first + n_views && n < views->n; v++) {
            struct spin_camera_overlay_share share;

            spin_overlay_measure(&views->view[v].camera, s, POINTS, &share);
            look[n++] = (struct look){v, {share.in_front, share.inside}};
        }
    }
    return n;
}

spin_status spin_camera_shares(const struct spin_views *views, const int *rows, int n_rows,
                               const struct spin_splats *s, struct spin_camera_shares *out)
{
    double *values = NULL, limit[2];
    struct look *look = NULL;
    size_t n;
    spin_status status;

    *out = (struct spin_camera_shares){0};
    SPIN_TRY_OUT(spin_alloc(views->n, sizeof *look, (void **)&look));
    SPIN_TRY_OUT(spin_alloc(views->n, sizeof *values, (void **)&values));
    SPIN_TRY_OUT(spin_alloc(views->n, sizeof *out->camera, (void **)&out->camera));
    n = look_at(views, rows, n_rows, s, look);
    if (n == 0)
        goto out;
    judge(look, n, 0, values, &out->in_front, &limit[0]);
    judge(look, n, 1, values, &out->inside, &limit[1]);
    for (size_t i = 0; i < n; i++) {
        const double *share = look[i].share;
        bool apart = n >= LEAST_VIEWS && (share[0] < limit[0] || share[1] < limit[1]);

        put(views, &(struct spin_camera_share){look[i].view, share[0], share[1], apart}, out);
    }
out:
    free(look);
    free(values);
    return status;
}
