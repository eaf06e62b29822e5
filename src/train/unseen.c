/* Finds the splats that are not visible to any training camera, by projecting every splat into the
 * training cameras of its frame. */
#include "train/unseen.h"

#include "base/base.h"

static const float unseen_logit = 1.5f; /* opacity 0.8, for splats of a source of points */

/* Sets out [n_train] to the training cameras of a frame, and returns their number. */
static size_t cameras_of(const struct spin_plan *plan, int f, const struct spin_camera **out)
{
    size_t n = 0;

    for (size_t i = 0; i < plan->n_train; i++)
        if (plan->train[i].frame == f)
            out[n++] = &plan->clip.views.view[plan->train[i].view].camera;
    return n;
}

/* True if the point `place` is visible to at least one of the n cameras. */
static bool is_seen(const struct spin_camera *const *camera, size_t n, const float place[3])
{
    double p[3];

    for (size_t i = 0; i < n; i++)
        if (spin_camera_project_visible(camera[i], place, p))
            return true;
    return false;
}

spin_status spin_show_unseen(const struct spin_plan *plan, const struct spin_splats *s, int f,
                             struct spin_refine_cloud *cloud)
{
    SPIN_LEAVES(spin_refine_cloud_free) struct spin_refine_cloud source = {0};
    SPIN_FREED const struct spin_camera **camera = NULL;
    size_t n;

    SPIN_TRY(spin_alloc(plan->n_train + 1, sizeof *camera, (void **)&camera));
    n = cameras_of(plan, f, camera);
    if (s->logit_opacities)
        SPIN_TRY(spin_refine_init_from_splats(s, &source));
    for (size_t i = 0; i < cloud->n; i++)
        if (is_seen(camera, n, s->means + 3 * i))
            cloud->point[i].seen = 1;
        else if (source.n > 0)
            cloud->point[i].p = source.point[i].p;
        else
            cloud->point[i].p.logit_opacity = unseen_logit;
    return SPIN_OK;
}
