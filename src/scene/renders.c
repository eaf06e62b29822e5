#include "scene/renders.h"

#include "base/base.h"
#include "geometry/camera_rig.h"
#include "geometry/viewpoints.h"
#include "io/image.h"
#include "scene/bundle.h"

enum {
    /* Number of camera parameters in the path of an image: intrinsics, near plane, pose [3][4]. */
    NUMBERS = 17,
    LEAST_SOURCE_CAMERAS = 8 /* cameras are placed if the bundle keeps fewer than this */
};

bool spin_renders_reads(const char *path, const char *from)
{
    return from ? strcmp(from, spin_renders.name) == 0 : spin_bundle_detect(path);
}

/* ---- Paths of images ------------------------------------------------------------------------- */

static spin_status format_path(const char *bundle, int frame, const struct spin_camera *c,
                               char **out)
{
    size_t n = strlen(bundle) + 64 + NUMBERS * 26, used;
    double number[NUMBERS] = {c->fx, c->fy, c->cx, c->cy, c->z_near};

    memcpy(number + 5, c->w2c, sizeof c->w2c);
    SPIN_TRY(spin_alloc(n, 1, (void **)out));
    used = (size_t)snprintf(*out, n, "%s" SPIN_DRAWN_MARK "%d,%d,%d", bundle, frame, c->width,
                            c->height);
    for (int i = 0; i < NUMBERS; i++)
        used += (size_t)snprintf(*out + used, n - used, ",%.17g", number[i]);
    return SPIN_OK;
}

spin_status spin_renders_parse(const char *path, char **bundle, int *frame, struct spin_camera *c)
{
    const char *mark = strstr(path, SPIN_DRAWN_MARK), *at;
    double number[NUMBERS];
    int n = 0, used = 0;

    *bundle = NULL;
    memset(c, 0, sizeof *c);
    if (!mark || sscanf(mark + strlen(SPIN_DRAWN_MARK), "%d,%d,%d%n", frame, &c->width, &c->height,
                        &used) != 3)
        return spin_malformed("'%s' is not the path of a drawn image", path);
    for (at = mark + strlen(SPIN_DRAWN_MARK) + used; n < NUMBERS && *at == ','; n++)
        number[n] = strtod(at + 1, (char **)(uintptr_t)&at);
    if (n < NUMBERS || *at || c->width < 1 || c->height < 1)
        return spin_malformed("'%s' is not the path of a drawn image", path);
    c->fx = number[0];
    c->fy = number[1];
    c->cx = number[2];
    c->cy = number[3];
    c->z_near = number[4];
    memcpy(c->w2c, number + 5, sizeof c->w2c);
    SPIN_TRY(spin_strdup(path, bundle));
    (*bundle)[mark - path] = '\0';
    return SPIN_OK;
}

/* ---- Options --------------------------------------------------------------------------------- */

static const struct spin_plugin_option options[] = {
    {"cameras", "N", "number of training cameras", "24"},
    {"test", "N", "number of held-out cameras", "8"},
    {"size", "WxH", "size of the images in pixels", "320x180"},
    {"fov", "DEGREES", "vertical field of view", "50"},
    {"up", "AXIS", "axis that points up: x, -x, y, -y, z or -z", "-y"},
    {"seed", "N", "seed of the choice of cameras", "0"},
    {0},
};

static spin_status parse_size(const char *text, struct spin_viewpoints_options *o)
{
    int end = 0;

    if (sscanf(text, "%5dx%5d%n", &o->width, &o->height, &end) != 2 || text[end] || o->width < 16 ||
        o->height < 16 || o->width > 8192 || o->height > 8192)
        return spin_misuse("renders:size=%s: expected WxH in pixels, both from 16 to 8192", text);
    return SPIN_OK;
}

static spin_status parse_up(const char *text, double up[3])
{
    const char *axis = text + (*text == '-');

    if (strlen(axis) != 1 || *axis < 'x' || *axis > 'z')
        return spin_misuse("renders:up=%s: expected x, -x, y, -y, z or -z", text);
    up[*axis - 'x'] = *text == '-' ? -1 : 1;
    return SPIN_OK;
}

static spin_status parse_options(const struct spin_plugin_values *v,
                                 struct spin_viewpoints_options *o)
{
    int seed = 0;

    *o = (struct spin_viewpoints_options){.n_cameras = 24, .n_test = 8, .fovy_deg = 50};
    SPIN_TRY(spin_option_count(v, "cameras", 1, 1000, &o->n_cameras));
    SPIN_TRY(spin_option_count(v, "test", 0, 1000, &o->n_test));
    SPIN_TRY(spin_option_number(v, "fov", 5, 150, &o->fovy_deg));
    SPIN_TRY(spin_option_count(v, "seed", 0, 1000000000, &seed));
    o->seed = (uint64_t)seed;
    SPIN_TRY(parse_size(spin_plugin_value(v, "size", "320x180"), o));
    return parse_up(spin_plugin_value(v, "up", "-y"), o->up);
}

/* ---- Cameras --------------------------------------------------------------------------------- */

struct reading {
    struct spin_bundle bundle;
    struct spin_splats splats;
};

static spin_status read_frame(void *context, int frame, const struct spin_splats **out)
{
    struct reading *r = context;

    *out = &r->splats;
    return spin_bundle_frame(&r->bundle, frame, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, &r->splats);
}

/* Returns whether to use the cameras that the bundle keeps. An option that only placed cameras have
 * asks for placed cameras. */
static bool uses_source_cameras(const struct spin_bundle *bundle,
                                const struct spin_plugin_values *v)
{
    return bundle->meta.cameras.n >= LEAST_SOURCE_CAMERAS && !spin_plugin_value(v, "fov", NULL) &&
           !spin_plugin_value(v, "up", NULL) && !spin_plugin_value(v, "seed", NULL);
}

/* Chooses the size of the images: that of the option or, by default, as many pixels as that of the
 * placed cameras, in the aspect ratio of the first camera. */
static void choose_size(const struct spin_camera *first, const struct spin_plugin_values *v,
                        struct spin_viewpoints_options *o)
{
    double factor = sqrt((double)o->width * o->height / first->width / first->height);

    if (spin_plugin_value(v, "size", NULL))
        return;
    o->width = (int)lrint(fmax(16, factor * first->width));
    o->height = (int)lrint(fmax(16, factor * first->height));
}

/* Resizes a camera to the size of the images. If the aspect ratios differ, the image shows less
 * than that of the source, never more. */
static struct spin_camera resize_camera(struct spin_camera c, int width, int height)
{
    double factor = fmax((double)width / c.width, (double)height / c.height);

    c.cx = 0.5 * width + factor * (c.cx - 0.5 * c.width);
    c.cy = 0.5 * height + factor * (c.cy - 0.5 * c.height);
    c.fx *= factor;
    c.fy *= factor;
    c.width = width;
    c.height = height;
    return c;
}

/* Takes at most n_cameras + n_test of the cameras that the bundle keeps, in steps through the list,
 * and holds out the share n_test / (n_cameras + n_test) of them. */
static spin_status take_source_cameras(const struct spin_views *kept,
                                       const struct spin_viewpoints_options *o,
                                       struct spin_viewpoints *out)
{
    int asked = o->n_cameras + o->n_test, have = (int)kept->n;
    int n = asked < have ? asked : have, n_test = (n * o->n_test + asked / 2) / asked, test = 0;

    n_test = n_test < n ? n_test : n - 1;
    SPIN_TRY(spin_alloc((size_t)n, sizeof *out->camera, (void **)&out->camera));
    out->n = n;
    for (int i = 0; i < n; i++) {
        bool held_out = (i + 1) * n_test / n > test;
        int at = held_out ? n - n_test + test : i - test;

        out->camera[at] = (struct spin_viewpoint){
            .camera = resize_camera(kept->view[(size_t)i * kept->n / (size_t)n].camera, o->width,
                                    o->height),
            .test = held_out};
        test += held_out;
    }
    return SPIN_OK;
}

/* Sets the near plane of the cameras, which is part of the path of an image. */
static spin_status set_near(struct reading *r, struct spin_views *kept)
{
    const struct spin_bundle_meta *meta = &r->bundle.meta;
    const struct spin_splats *splats;
    int f = 0;

    while (f < meta->n_frames - 1 && meta->frame[f].n == 0)
        f++;
    SPIN_TRY(read_frame(r, f, &splats));
    SPIN_TRY(spin_views_set_near(kept, splats->means, splats->n, false));
    for (size_t i = 0; i < kept->n; i++)
        kept->view[i].camera.z_near = spin_camera_near(&kept->view[i].camera);
    return SPIN_OK;
}

/* Takes the cameras from the bundle if it keeps some, and places cameras if not. */
static spin_status find_cameras(struct reading *r, const struct spin_plugin_values *values,
                                struct spin_viewpoints *points, struct spin_views *out)
{
    struct spin_views *kept = &r->bundle.meta.cameras;
    struct spin_viewpoints_options o;

    SPIN_TRY(parse_options(values, &o));
    if (uses_source_cameras(&r->bundle, values)) {
        SPIN_TRY(set_near(r, kept));
        choose_size(&kept->view[0].camera, values, &o);
        SPIN_TRY(take_source_cameras(kept, &o, points));
        snprintf(out->notes, sizeof out->notes,
                 "the images are rendered from the clip itself, for %d of the %zu cameras that "
                 "the clip keeps",
                 points->n, kept->n);
        return SPIN_OK;
    }
    SPIN_TRY(spin_viewpoints_open(&o, r->bundle.meta.n_frames, read_frame, r, points));
    snprintf(
        out->notes, sizeof out->notes,
        "the images are rendered from the clip itself, for %d cameras %s; %.1f %% of the dynamic "
        "splats are visible to fewer than three cameras",
        points->n, points->room ? "inside a room" : "around the subject", 100 * points->few_moving);
    return SPIN_OK;
}

/* ---- Views ----------------------------------------------------------------------------------- */

static spin_status add_views(const struct reading *r, const struct spin_viewpoints *points,
                             struct spin_views *out)
{
    const struct spin_bundle_meta *meta = &r->bundle.meta;

    for (int f = 0; f < meta->n_frames; f++)
        for (int k = 0; k < points->n; k++) {
            struct spin_view view = {.camera = points->camera[k].camera,
                                     .dataset_frame = f,
                                     .number = meta->frame[f].number,
                                     .time = meta->frame[f].time,
                                     .camera_id = k,
                                     .test = points->camera[k].test};
            SPIN_FREED char *path = NULL;

            SPIN_TRY(format_path(r->bundle.path, f, &view.camera, &path));
            view.path = path;
            SPIN_TRY(spin_views_add(out, &view));
        }
    return SPIN_OK;
}

static spin_status read_views(const char *path, const struct spin_plugin_values *values,
                              struct spin_views *out)
{
    struct reading r = {0};
    struct spin_viewpoints points = {0};
    spin_status status;

    SPIN_TRY(spin_bundle_open(path, &r.bundle));
    if (SPIN_COL_ATTRIBUTES & ~r.bundle.meta.columns)
        status =
            spin_unsupported("the clip contains points without opacities, which cannot be drawn");
    else
        status = find_cameras(&r, values, &points, out);
    if (status == SPIN_OK)
        status = add_views(&r, &points, out);
    spin_viewpoints_close(&points);
    spin_splats_free(&r.splats);
    spin_bundle_close(&r.bundle);
    return status;
}

const struct spin_importer spin_renders = {
    .abi = SPIN_PLUGIN_ABI, .name = "renders", .options = options, .views = read_views};
