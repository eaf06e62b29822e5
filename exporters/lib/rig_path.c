#include "exporters/lib/rig_path.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "exporters/lib/initial_view.h"

static double apart(const struct spin_rig_stop *a, const struct spin_rig_stop *b)
{
    return sqrt(pow(a->eye[0] - b->eye[0], 2) + pow(a->eye[1] - b->eye[1], 2) +
                pow(a->eye[2] - b->eye[2], 2));
}

/* The largest of w, x, y and z first: no root of a difference that cancels. */
static void quat_of(const double m[12], double q[4])
{
    double square[4] = {m[0] + m[5] + m[10], m[0] - m[5] - m[10], m[5] - m[0] - m[10],
                        m[10] - m[0] - m[5]};
    const double sum[3] = {m[4] + m[1], m[9] + m[6], m[8] + m[2]}; /* xy, yz, xz */
    const double off[3] = {m[9] - m[6], m[2] - m[8], m[4] - m[1]}; /* wx, wy, wz */
    int k = 0;
    double root;

    for (int i = 1; i < 4; i++)
        k = square[i] > square[k] ? i : k;
    root = 2 * sqrt(1 + square[k]);
    q[0] = k ? off[k - 1] : root * root / 4;
    q[1] = k == 0 ? off[0] : k == 1 ? root * root / 4 : k == 2 ? sum[0] : sum[2];
    q[2] = k == 0 ? off[1] : k == 1 ? sum[0] : k == 2 ? root * root / 4 : sum[1];
    q[3] = k == 0 ? off[2] : k == 1 ? sum[2] : k == 2 ? sum[1] : root * root / 4;
    for (int i = 0; i < 4; i++)
        q[i] /= root;
}

static void swap(struct spin_rig_stop *a, struct spin_rig_stop *b)
{
    struct spin_rig_stop kept = *a;

    *a = *b;
    *b = kept;
}

/* Always the nearest of those left. */
static void chain(struct spin_rig_path *path)
{
    struct spin_rig_stop *s = path->stop;

    for (int i = 1; i < path->n; i++) {
        int next = i;

        for (int k = i + 1; k < path->n; k++)
            next = apart(&s[i - 1], &s[k]) < apart(&s[i - 1], &s[next]) ? k : next;
        swap(&s[i], &s[next]);
    }
}

/* Turn pieces of the way round as long as that makes it shorter; the first stays. */
static void uncross(struct spin_rig_path *path)
{
    struct spin_rig_stop *s = path->stop;

    for (int turned = 1, rounds = 0; turned && rounds < 100; rounds++) {
        turned = 0;
        for (int i = 1; i < path->n; i++)
            for (int k = i + 1; k < path->n; k++) {
                bool last = k + 1 == path->n;
                double now = apart(&s[i - 1], &s[i]) + (last ? 0 : apart(&s[k], &s[k + 1]));
                double then = apart(&s[i - 1], &s[k]) + (last ? 0 : apart(&s[i], &s[k + 1]));

                if (!(then < now * (1 - 1e-9)))
                    continue;
                turned = 1;
                for (int a = i, b = k; a < b; a++, b--)
                    swap(&s[a], &s[b]);
            }
    }
}

/* How far it is to each, and quaternions that do not change sides. */
static void measure(struct spin_rig_path *path)
{
    for (int i = 1; i < path->n; i++) {
        struct spin_rig_stop *was = &path->stop[i - 1], *s = &path->stop[i];
        double dot = 0;

        s->at = was->at + apart(was, s);
        for (int c = 0; c < 4; c++)
            dot += was->turn[c] * s->turn[c];
        for (int c = 0; c < 4 && dot < 0; c++)
            s->turn[c] = -s->turn[c];
    }
}

static bool is_new(const struct spin_rig_path *path, const struct spin_rig_stop *stop)
{
    for (int i = 0; i < path->n; i++)
        if (apart(&path->stop[i], stop) < 1e-9)
            return false;
    return true;
}

spin_status spin_rig_path_open(const struct spin_views *views, int row, struct spin_rig_path *path)
{
    void *stops = NULL;

    *path = (struct spin_rig_path){0};
    SPIN_TRY(spin_alloc(views->n + 1, sizeof *path->stop, &stops));
    path->stop = stops;
    for (size_t i = 0; i < views->n; i++) {
        struct spin_rig_stop *s = &path->stop[path->n];

        if (views->view[i].dataset_frame != row || views->view[i].test)
            continue;
        spin_initial_view_eye(&views->view[i].camera, s->eye);
        quat_of(views->view[i].camera.w2c, s->turn);
        path->n += is_new(path, s);
    }
    if (path->n < 2) {
        int n = path->n;

        spin_rig_path_free(path);
        return spin_fail(SPIN_E_NOT_FOUND,
                         "--path train: %d training camera%s in the first frame, expected two or "
                         "more",
                         n, n == 1 ? "" : "s");
    }
    chain(path);
    uncross(path);
    measure(path);
    return SPIN_OK;
}

void spin_rig_path_free(struct spin_rig_path *path)
{
    free(path->stop);
    *path = (struct spin_rig_path){0};
}

/* A value of stop i, for the curve: its place, then its rotation. */
static double value_of(const struct spin_rig_path *path, int i, int c)
{
    return c < 3 ? path->stop[i].eye[c] : path->stop[i].turn[c - 3];
}

/* How fast a value changes at stop i: by the stops around it. */
static double slope(const struct spin_rig_path *path, int i, int c)
{
    int a = i > 0 ? i - 1 : 0, b = i + 1 < path->n ? i + 1 : i;

    return (value_of(path, b, c) - value_of(path, a, c)) / (path->stop[b].at - path->stop[a].at);
}

void spin_rig_path_camera(const struct spin_rig_path *path, double share, double w2c[12])
{
    double at = share * path->stop[path->n - 1].at, v[7], length = 0, u, step;
    int i = 0;

    while (i + 2 < path->n && path->stop[i + 1].at < at)
        i++;
    step = path->stop[i + 1].at - path->stop[i].at;
    u = (at - path->stop[i].at) / step;
    for (int c = 0; c < 7; c++) /* cubic, with these values and slopes at its ends */
        v[c] = value_of(path, i, c) * (1 + 2 * u) * (1 - u) * (1 - u) +
               value_of(path, i + 1, c) * u * u * (3 - 2 * u) +
               step * u * (1 - u) *
                   (slope(path, i, c) * (1 - u) - slope(path, i + 1, c) * u);
    for (int c = 3; c < 7; c++)
        length += v[c] * v[c];
    for (int c = 3; c < 7; c++)
        v[c] /= sqrt(length);
    for (int r = 0; r < 3; r++) {
        double w = v[3], axis[3] = {v[4], v[5], v[6]};
        int s = (r + 1) % 3, t = (r + 2) % 3;

        w2c[4 * r + r] = 1 - 2 * (axis[s] * axis[s] + axis[t] * axis[t]);
        w2c[4 * r + s] = 2 * (axis[r] * axis[s] - w * axis[t]);
        w2c[4 * r + t] = 2 * (axis[r] * axis[t] + w * axis[s]);
        w2c[4 * r + 3] = 0;
        for (int c = 0; c < 3; c++)
            w2c[4 * r + 3] -= w2c[4 * r + c] * v[c];
    }
}
