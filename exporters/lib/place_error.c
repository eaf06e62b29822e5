#include "exporters/lib/place_error.h"

#include <math.h>

#include "math/project.h"

void spin_place_error_begin(struct spin_place_error *e)
{
    *e = (struct spin_place_error){.pixels = -1};
}

void spin_place_error_frame(struct spin_place_error *e, const struct spin_export_job *job,
                            int frame)
{
    const struct spin_views *views = job->views;
    int row = job->dataset_frame_of ? job->dataset_frame_of[frame] : -1;

    e->view = NULL;
    e->n_views = 0;
    for (size_t i = 0; views && row >= 0 && i < views->n; i++)
        if (views->view[i].dataset_frame == row) { /* they stand side by side */
            e->view = e->view ? e->view : &views->view[i];
            e->n_views++;
        }
}

/* Pixels that a step of length `off` across the line of sight is at most; -1: the picture does not show the place. */
static double pixels_of(const struct spin_camera *c, const float mean[3], double off)
{
    double p[3], x, y;

    for (int k = 0; k < 3; k++)
        p[k] = c->w2c[4 * k] * (double)mean[0] + c->w2c[4 * k + 1] * (double)mean[1] +
               c->w2c[4 * k + 2] * (double)mean[2] + c->w2c[4 * k + 3];
    if (p[2] < (double)SPIN_PROJECT_NEAR)
        return -1;
    x = c->fx * p[0] / p[2] + c->cx;
    y = c->fy * p[1] / p[2] + c->cy;
    if (x < 0 || y < 0 || x > c->width || y > c->height)
        return -1;
    return fmax(c->fx, c->fy) * off / p[2];
}

void spin_place_error_add(struct spin_place_error *e, const float mean[3], const float log_scale[3],
                          double off)
{
    double largest = fmax(fmax((double)log_scale[0], (double)log_scale[1]), (double)log_scale[2]);

    e->sizes = fmax(e->sizes, off / exp(largest));
    for (size_t i = 0; i < e->n_views; i++)
        e->pixels = fmax(e->pixels, pixels_of(&e->view[i].camera, mean, off));
}

void spin_place_error_say(const struct spin_place_error *e, struct spin_export_check *out)
{
    out->place_sizes = e->sizes;
    out->place_pixels = e->pixels < 0 ? (double)NAN : e->pixels;
}
