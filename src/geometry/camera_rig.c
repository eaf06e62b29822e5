#include "geometry/camera_rig.h"

#include "base/base.h"

/* spin_camera_pivot() fails if the mean of I - d d^T over all camera axes d has a determinant
 * below this. Parallel axes have a determinant of 0; axes that spread by about 3 degrees reach this
 * value. */
#define LEAST_SPREAD 2e-3

void spin_camera_centre(const struct spin_camera *camera, double out[3])
{
    const double *m = camera->w2c;

    for (int c = 0; c < 3; c++)
        out[c] = -(m[c] * m[3] + m[4 + c] * m[7] + m[8 + c] * m[11]);
}

static double det3(const double a[3], const double b[3], const double c[3])
{
    return a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) +
           a[2] * (b[0] * c[1] - b[1] * c[0]);
}

/* Sums I - d d^T into the columns a, and (I - d d^T) e into b, over all cameras with axis d and
 * centre e: the normal equations of the point nearest to all axes. Returns the number of cameras.
 */
static int sum_axes(const struct spin_views *views, int row, double a[3][3], double b[3])
{
    int n = 0;

    for (size_t i = 0; i < views->n; i++) {
        const double *axis = views->view[i].camera.w2c + 8;
        double eye[3];

        if (row >= 0 && views->view[i].dataset_frame != row)
            continue;
        spin_camera_centre(&views->view[i].camera, eye);
        n++;
        for (int r = 0; r < 3; r++)
            for (int c = 0; c < 3; c++) {
                double part = (r == c) - axis[r] * axis[c];

                a[c][r] += part;
                b[r] += part * eye[c];
            }
    }
    return n;
}

bool spin_camera_pivot(const struct spin_views *views, int row, double pivot[3], double *median)
{
    double a[3][3] = {{0}}, b[3] = {0}, det, at[3];
    SPIN_FREED double *away = NULL;
    int n = views ? sum_axes(views, row, a, b) : 0, n_away = 0, n_behind = 0;

    det = det3(a[0], a[1], a[2]);
    if (n < 2 || !(det > LEAST_SPREAD * n * n * n) ||
        spin_alloc((size_t)n, sizeof *away, (void **)&away) != SPIN_OK)
        return false;
    at[0] = det3(b, a[1], a[2]) / det;
    at[1] = det3(a[0], b, a[2]) / det;
    at[2] = det3(a[0], a[1], b) / det;
    for (size_t i = 0; i < views->n; i++) {
        const double *axis = views->view[i].camera.w2c + 8;
        double eye[3], along = 0, square = 0;

        if (row >= 0 && views->view[i].dataset_frame != row)
            continue;
        spin_camera_centre(&views->view[i].camera, eye);
        for (int c = 0; c < 3; c++) {
            along += (at[c] - eye[c]) * axis[c];
            square += (at[c] - eye[c]) * (at[c] - eye[c]);
        }
        n_behind += along <= 0;
        away[n_away++] = sqrt(square);
    }
    qsort(away, (size_t)n, sizeof *away, spin_by_double);
    if (2 * n_behind < n) {
        memcpy(pivot, at, sizeof at);
        *median = away[n / 2];
    }
    return 2 * n_behind < n;
}
