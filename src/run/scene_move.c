#include "run/scene_move.h"

#include <float.h>

#include "base/base.h"

void spin_scene_move_open(struct spin_scene_move *m, const struct spin_export_options *o,
                          const double *shift)
{
    double *by = m->translate;

    m->scale = o->scale > 0 ? o->scale : 1;
    for (int c = 0; c < 3; c++)
        by[c] = m->scale * shift[c] + o->translate[c];
    m->moves = m->scale != 1 || by[0] != 0 || by[1] != 0 || by[2] != 0;
}

void spin_scene_move_close(struct spin_scene_move *m)
{
    spin_splats_free(&m->splats);
    spin_splats_4d_free(&m->splats_4d);
    if (m->moves)
        spin_views_free(&m->views);
}

static void move_places(const struct spin_scene_move *m, float *place, size_t n)
{
    for (size_t i = 0; i < 3 * n; i++)
        place[i] = (float)(m->scale * (double)place[i] + m->translate[i % 3]);
}

/* Warns if the rounding of translated positions to floats exceeds 1e-5 of the first frame's
 * extent. */
static void warn_coarse(struct spin_scene_move *m, const float *place, size_t n)
{
    double extent = 0, farthest = 0;

    for (size_t c = 0; c < 3; c++) {
        float low = INFINITY, high = -INFINITY;

        for (size_t i = 0; i < n; i++) {
            low = fminf(low, place[3 * i + c]);
            high = fmaxf(high, place[3 * i + c]);
        }
        extent = fmax(extent, m->scale * (double)(high - low));
        farthest = fmax(farthest, fabs(m->translate[c]));
    }
    if (n > 1 && !m->warned && FLT_EPSILON * farthest > 1e-5 * extent)
        spin_warn("positions are up to %g from 0, where floats have steps of %.2g: %s", farthest,
                  (double)(nextafterf((float)farthest, INFINITY) - (float)farthest),
                  "export closer to 0, with --relative or another --translate");
    m->warned = m->warned || n > 1;
}

static void move_scales(const struct spin_scene_move *m, float *log_scale, size_t n)
{
    float more = (float)log(m->scale);

    for (size_t i = 0; i < 3 * n; i++)
        log_scale[i] += more;
}

void spin_scene_move_rows(const struct spin_scene_move *m, struct spin_splats *splats)
{
    if (!m->moves)
        return;
    move_places(m, splats->means, splats->n);
    move_scales(m, splats->log_scales, splats->n);
}

static spin_status mark_all(size_t n, unsigned char **mark)
{
    SPIN_TRY(spin_alloc(n + 1, 1, (void **)mark));
    memset(*mark, 1, n);
    return SPIN_OK;
}

spin_status spin_scene_move_frame(struct spin_scene_move *m, const struct spin_splats **splats)
{
    SPIN_FREED unsigned char *mark = NULL;

    if (!m->moves)
        return SPIN_OK;
    SPIN_TRY(mark_all((*splats)->n, &mark));
    SPIN_TRY(spin_splats_select(*splats, mark, &m->splats));
    warn_coarse(m, m->splats.means, m->splats.n);
    spin_scene_move_rows(m, &m->splats);
    *splats = &m->splats;
    return SPIN_OK;
}

spin_status spin_scene_move_4d(struct spin_scene_move *m, const struct spin_splats_4d **splats_4d)
{
    struct spin_splats_4d *to = &m->splats_4d;
    SPIN_FREED unsigned char *mark = NULL;

    if (!m->moves)
        return SPIN_OK;
    spin_splats_4d_free(to);
    SPIN_TRY(mark_all((*splats_4d)->n, &mark));
    SPIN_TRY(spin_splats_4d_select(*splats_4d, mark, to));
    warn_coarse(m, to->centres, to->n);
    move_places(m, to->centres, to->n);
    move_scales(m, to->log_scales, to->n);
    for (size_t i = 0; i < 3 * to->n * (size_t)to->degree; i++)
        to->paths[i] = (float)(m->scale * (double)to->paths[i]);
    *splats_4d = to;
    return SPIN_OK;
}

spin_status spin_scene_move_views(struct spin_scene_move *m, const struct spin_clip *clip,
                                  const struct spin_views **out)
{
    const struct spin_views *from = &clip->views;

    *out = clip->has_views || clip->has_kept ? from : NULL;
    if (!*out || !m->moves)
        return SPIN_OK;
    spin_views_free(&m->views);
    for (size_t v = 0; v < from->n; v++) {
        struct spin_view view = from->view[v];
        double *w = view.camera.w2c;

        /* With w2c = (R, w), scale s and translation t, the new w' must satisfy R (s p + t) + w' =
         * s (R p + w) for all points p. */
        for (int r = 0; r < 3; r++)
            w[4 * r + 3] = m->scale * w[4 * r + 3] - w[4 * r] * m->translate[0] -
                           w[4 * r + 1] * m->translate[1] - w[4 * r + 2] * m->translate[2];
        view.camera.z_near = m->scale * spin_camera_near(&view.camera);
        SPIN_TRY(spin_views_add(&m->views, &view));
    }
    m->views.n_dataset_frames = from->n_dataset_frames;
    m->views.numbered = from->numbered;
    *out = &m->views;
    return SPIN_OK;
}
