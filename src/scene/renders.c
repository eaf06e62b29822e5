#include "scene/renders.h"

#include "base/base.h"
#include "geometry/viewpoints.h"
#include "io/drawn_image.h"
#include "scene/bundle.h"

/* Number of camera parameters in the path of an image: focal length, near plane, pose [3][4]. */
enum { NUMBERS = 14 };

bool spin_renders_reads(const char *path, const char *from)
{
    return from ? strcmp(from, spin_renders.name) == 0 : spin_bundle_detect(path);
}

/* ---- Paths of images ------------------------------------------------------------------------- */

static spin_status format_path(const char *bundle, int frame, const struct spin_camera *c,
                               char **out)
{
    size_t n = strlen(bundle) + 64 + NUMBERS * 26, used;
    double number[NUMBERS] = {c->fx, c->z_near};

    memcpy(number + 2, c->w2c, sizeof c->w2c);
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
    c->fx = c->fy = number[0];
    c->z_near = number[1];
    c->cx = 0.5 * c->width;
    c->cy = 0.5 * c->height;
    memcpy(c->w2c, number + 2, sizeof c->w2c);
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

/* ---- Views ----------------------------------------------------------------------------------- */

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

static void add_note(const struct spin_viewpoints *p, struct spin_views *out)
{
    snprintf(
        out->notes, sizeof out->notes,
        "the images are rendered from the clip itself, for %d cameras %s; %.1f %% of the dynamic "
        "splats are visible to fewer than three cameras\n",
        p->n, p->room ? "inside a room" : "around the subject", 100 * p->few_moving);
}

static spin_status read_views(const char *path, const struct spin_plugin_values *values,
                              struct spin_views *out)
{
    struct reading r = {0};
    struct spin_viewpoints_options o;
    struct spin_viewpoints points = {0};
    spin_status status;

    SPIN_TRY(parse_options(values, &o));
    SPIN_TRY(spin_bundle_open(path, &r.bundle));
    if (SPIN_COL_ATTRIBUTES & ~r.bundle.meta.columns)
        status =
            spin_unsupported("the clip contains points without opacities, which cannot be drawn");
    else
        status = spin_viewpoints_open(&o, r.bundle.meta.n_frames, read_frame, &r, &points);
    if (status == SPIN_OK)
        status = add_views(&r, &points, out);
    add_note(&points, out);
    spin_viewpoints_close(&points);
    spin_splats_free(&r.splats);
    spin_bundle_close(&r.bundle);
    return status;
}

const struct spin_importer spin_renders = {
    .abi = SPIN_PLUGIN_ABI, .name = "renders", .options = options, .views = read_views};
