#include "run/explain_data.h"

#include "base/base.h"
#include "io/file.h"
#include "scene/data_points.h"
#include "scene/dataset.h"
#include "scene/probe.h"

/* Sets *n to the number of cameras of these views. */
static spin_status count_cameras(const struct spin_views *views, int *n)
{
    SPIN_FREED int *camera = NULL;

    SPIN_TRY(spin_alloc(views->n, sizeof *camera, (void **)&camera));
    for (size_t i = 0; i < views->n; i++)
        camera[i] = views->view[i].camera_id;
    qsort(camera, views->n, sizeof *camera, spin_by_int);
    *n = 0;
    for (size_t i = 0; i < views->n; i++)
        *n += i == 0 || camera[i] != camera[i - 1];
    return SPIN_OK;
}

/* Describes the views of a data set. If each image has its own camera and its own frame, the data
 * set does not show whether it is a static scene or the video of one moving camera. */
static spin_status describe_views(const struct spin_views *views, char out[120])
{
    char frames[48], cameras[48];
    int n;

    SPIN_TRY(count_cameras(views, &n));
    if (n > 1 && (size_t)n == views->n && views->n_dataset_frames == n)
        snprintf(out, 120, "%d images, a static scene or the video of one camera", n);
    else
        snprintf(out, 120, "%s and %s", spin_text_count(n, "camera", cameras),
                 spin_text_count(views->n_dataset_frames, "frame", frames));
    return SPIN_OK;
}

/* Quotes a path for the shell if it contains special characters: out has QUOTED(length) bytes. */
#define QUOTED(length) (4 * (length) + 3)
static const char *quote(const char *path, char *out)
{
    bool plain = strpbrk(path, " \t'\"$`\\&;()<>|*?[]!#~") == NULL;
    char *to = out;

    for (*to++ = '\''; *path; path++)
        to += *path == '\'' ? sprintf(to, "'\\''") : sprintf(to, "%c", *path);
    strcpy(to, plain ? "" : "'");
    return plain ? out + 1 : out;
}

/* Returns whether to suggest a still of the first frame, made from the points of the data set. If
 * each frame has only one training image, as from one moving camera, a clip is suggested
 * instead. */
static bool makes_still(const struct spin_views *views)
{
    size_t n = 0;
    int cameras = 0;

    if (count_cameras(views, &cameras) == SPIN_OK && (size_t)cameras == views->n)
        return true;
    for (size_t i = 0; i < views->n; i++)
        n += views->view[i].dataset_frame == 0 && !views->view[i].test;
    return n > 1;
}

/* Writes to out [n] a suggestion to import the points of the data set, with the command for this;
 * "" if the data set has no points. */
static spin_status offer_points(const char *path, const struct spin_views *views, char *out,
                                size_t n)
{
    SPIN_FREED char *points = NULL, *absolute = NULL;
    enum { LONGEST = 300 };
    char input[QUOTED(LONGEST)], data[QUOTED(LONGEST)], name[200], quoted[QUOTED(200)];
    bool per_frame, still;

    *out = '\0';
    SPIN_TRY(spin_data_points(path, &points, &per_frame));
    SPIN_TRY(spin_path_absolute(path, &absolute));
    if (!points || strlen(points) > LONGEST || strlen(path) > LONGEST)
        return SPIN_OK;
    snprintf(name, sizeof name, "%.180s.html", spin_path_name(absolute));
    still = !per_frame && makes_still(views);
    snprintf(out, n, "; or start from %s: spin4d %s%s --data %s%s -o %s",
             per_frame ? "the points of its frames"
             : still   ? "its points, for a still of its first frame"
                       : "its points",
             quote(points, input), spin_text_ends_any_case(points, ".ply") ? " --from points" : "",
             quote(path, data), still ? " --frames 1" : "", quote(name, quoted));
    return SPIN_OK;
}

spin_status spin_explain_data_set(const char *path, spin_status status)
{
    const struct spin_importer *importer;
    SPIN_LEAVES(spin_views_free) struct spin_views views = {0};
    SPIN_FREED char *error = NULL;
    char content[120], offer[3 * QUOTED(300) + 200];

    SPIN_TRY(spin_strdup(spin_last_error(), &error));
    if (spin_importer_guess(path, true))
        SPIN_TRY(spin_views_open(path, NULL, &views, NULL, 0));
    if (spin_importer_find(path, NULL, true, &importer) != SPIN_OK ||
        (views.n == 0 && spin_views_open(path, NULL, &views, NULL, 0) != SPIN_OK))
        return spin_fail(status, "%s", error);
    SPIN_TRY(describe_views(&views, content));
    SPIN_TRY(offer_points(path, &views, offer, sizeof offer));
    return spin_fail(SPIN_E_NOT_RECOGNISED,
                     "'%s' is a data set (%s) of %s, not a run: give the folder that a method "
                     "wrote, or one PLY file of points per frame, and name this data set with "
                     "--data, see docs/how-to/from-videos.md%s",
                     path, importer->name, content, offer);
}

bool spin_run_is_points(const char *path, const char *run)
{
    return spin_holds_only_points(run) && spin_importer_guess(path, true) != NULL;
}
