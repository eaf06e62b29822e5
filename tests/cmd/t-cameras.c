/* The commands on a rig that moves and rolls, with half turns, lenses with fx different from fy
 * and a principal point off the centre, and other lenses for test views: images are compared
 * with a small rasteriser in double precision, figures with values derived from them.
 * K: eval images html report cameras views */
#include "io/image.h"
#include "scene/bundle.h"
#include "tests/cmd/command.h"
#include "tests/rig.h"

enum { FRAMES = 3, FIRST = 3, TRAIN = 3, CAMERAS = 5, SPLATS = 6, MOST = 80 * 60 };
static const int id[CAMERAS] = {4, 7, 9, 2, 11}; /* the last two are test views */
static const struct spin_camera lens[CAMERAS] = {{64, 48, 90, 45, 20, 33, {0}, 0},
                                                 {64, 48, 80, 50, 44, 20, {0}, 0},
                                                 {64, 48, 60, 85, 30, 12, {0}, 0},
                                                 {80, 36, 60, 100, 47, 11, {0}, 0},
                                                 {80, 36, 110, 70, 21, 25, {0}, 0}};
static struct pose pose[FRAMES][CAMERAS];
static struct spin_camera camera[FRAMES][CAMERAS];

/* A Gaussian: its colour, and how the colour changes with x, y and z of the viewing direction. */
struct gaussian {
    double place[3], scale[3], q[4], opacity, colour[3], change[3];
};
static struct gaussian scene[FRAMES][SPLATS];

static void make_scene(void)
{
    static const struct gaussian first[SPLATS] = {{{-0.9, -0.4, 0.2},
                                                   {0.5, 0.15, 0.2},
                                                   {0.9, 0.1, -0.3, 0.2},
                                                   0.9,
                                                   {0.7, 0.2, 0.1},
                                                   {0.1, 0, 0}},
                                                  {{0.8, 0.3, -0.4},
                                                   {0.2, 0.45, 0.1},
                                                   {0.3, -0.5, 0.7, 0.1},
                                                   0.8,
                                                   {0.1, 0.6, 0.2},
                                                   {0, 0.1, 0}},
                                                  {{0.1, 0.9, 0.6},
                                                   {0.3, 0.1, 0.4},
                                                   {0.5, 0.5, 0.1, -0.6},
                                                   0.7,
                                                   {0.2, 0.3, 0.7},
                                                   {0, 0, 0.1}},
                                                  {{0.3, -0.8, 0.9},
                                                   {0.04, 0.05, 0.03},
                                                   {1, 0, 0, 0},
                                                   0.95,
                                                   {0.8, 0.7, 0.1},
                                                   {0.05, 0.05, 0}},
                                                  {{-0.5, 0.6, -0.7},
                                                   {0.25, 0.3, 0.2},
                                                   {-0.2, 0.6, 0.3, 0.7},
                                                   0.6,
                                                   {0.5, 0.1, 0.6},
                                                   {0, 0.1, 0.1}},
                                                  /* far above: beyond where the Jacobian follows,
                                                     but still in the image of the first camera */
                                                  {{-0.3, -6.4, 0.1},
                                                   {1.2, 1.0, 0.9},
                                                   {0.7, 0.2, -0.1, 0.3},
                                                   0.9,
                                                   {0.3, 0.6, 0.6},
                                                   {0.1, 0, 0.1}}};
    static const double eye[CAMERAS][3] = {
        {0, 0.2, -6}, {-4, 0.5, -4}, {0.5, 0.3, 6.5}, {4.5, -0.5, -3}, {1, -6, 0.5}};
    static const double roll[CAMERAS] = {0.1, 3.14159265358979, 0.3, 1.5, -0.7};
    static const double middle[3] = {0, 0.1, 0.1}, up[2][3] = {{0, -1, 0.01}, {0.1, 0, 1}};

    for (int f = 0; f < FRAMES; f++) {
        for (int i = 0; i < SPLATS; i++) {
            scene[f][i] = first[i];
            for (int c = 0; c < 3 && i < 5; c++)
                scene[f][i].place[c] += 0.3 * f * sin(3 * i + 2 * c);
        }
        for (int k = 0; k < CAMERAS; k++) {
            double at[3] = {eye[k][0] + 0.4 * f, eye[k][1] - 0.2 * f, eye[k][2] + 0.1 * f * k};

            pose[f][k] = pose_towards(at, middle, up[k == 4], roll[k] + 0.15 * f);
            camera[f][k] = camera_of(lens[k], &pose[f][k]);
        }
    }
}

/* ---- Expected images */

static void matrix_of(const double q[4], double m[3][3])
{
    double square = dot(q, q) + q[3] * q[3], u[3] = {q[1], q[2], q[3]};

    for (int c = 0; c < 3;
         c++) { /* the images of the unit vectors: v + 2 w (u x v) + 2 u x (u x v) */
        double e[3] = {c == 0, c == 1, c == 2}, a[3], b[3];

        across(u, e, a);
        across(u, a, b);
        for (int r = 0; r < 3; r++)
            m[r][c] = e[r] + 2 * (q[0] * a[r] + b[r]) / square;
    }
}

/* A Gaussian in an image: its centre in pixels from the corner, the inverse of its covariance,
 * its colour. */
struct blob {
    double z, u, v, conic[3], opacity, rgb[3];
};

static double clamped(double v, double limit)
{
    return v > limit ? limit : v < -limit ? -limit : v;
}

static struct blob project(const struct gaussian *g, const struct spin_camera *c,
                           const struct pose *p)
{
    const double *axis[3] = {p->right, p->down, p->ahead};
    double rot[3][3], at[3], away[3], j[2][3], cov[3] = {0.3, 0, 0.3}, det;
    struct blob b = {.opacity = g->opacity};

    matrix_of(g->q, rot);
    for (int k = 0; k < 3; k++)
        away[k] = g->place[k] - p->eye[k];
    for (int k = 0; k < 3; k++)
        at[k] = dot(axis[k], away);
    make_long(away, 1);
    b.z = at[2];
    b.u = c->cx + c->fx * at[0] / at[2];
    b.v = c->cy + c->fy * at[1] / at[2];
    for (int k = 0; k < 3; k++) { /* the derivatives of u and v by x, y and z of the world */
        double x = clamped(at[0] / at[2], 1.3 * c->width / 2 / c->fx),
               y = clamped(at[1] / at[2], 1.3 * c->height / 2 / c->fy);

        j[0][k] = c->fx / at[2] * (axis[0][k] - x * axis[2][k]);
        j[1][k] = c->fy / at[2] * (axis[1][k] - y * axis[2][k]);
    }
    for (int k = 0; k < 3; k++) { /* and by the scale along each axis of the Gaussian */
        double along[3] = {rot[0][k] * g->scale[k], rot[1][k] * g->scale[k],
                           rot[2][k] * g->scale[k]};
        double du = dot(j[0], along), dv = dot(j[1], along);

        cov[0] += du * du;
        cov[1] += du * dv;
        cov[2] += dv * dv;
    }
    det = cov[0] * cov[2] - cov[1] * cov[1];
    b.conic[0] = cov[2] / det;
    b.conic[1] = -cov[1] / det;
    b.conic[2] = cov[0] / det;
    for (int k = 0; k < 3; k++)
        b.rgb[k] = fmax(0, g->colour[k] + dot(g->change, away));
    return b;
}

static int by_depth(const void *a, const void *b)
{
    double x = ((const struct blob *)a)->z, y = ((const struct blob *)b)->z;

    return (x > y) - (x < y);
}

/* Renders a frame over black, [h][w][3]. */
static void see(int f, const struct spin_camera *c, const struct pose *p, double *image)
{
    struct blob b[SPLATS];
    int n = 0;

    for (int i = 0; i < SPLATS; i++) {
        b[n] = project(&scene[f][i], c, p);
        n += b[n].z > 0.2;
    }
    qsort(b, (size_t)n, sizeof *b, by_depth);
    for (int y = 0; y < c->height; y++)
        for (int x = 0; x < c->width; x++) {
            double *rgb = image + 3 * (y * c->width + x), left = 1;

            rgb[0] = rgb[1] = rgb[2] = 0;
            for (int i = 0; i < n; i++) {
                double dx = x + 0.5 - b[i].u, dy = y + 0.5 - b[i].v;
                double power =
                    b[i].conic[0] * dx * dx + 2 * b[i].conic[1] * dx * dy + b[i].conic[2] * dy * dy;
                double alpha = fmin(0.99, b[i].opacity * exp(-power / 2));

                if (alpha < 1 / 255.0)
                    continue;
                for (int k = 0; k < 3; k++)
                    rgb[k] += left * alpha * b[i].rgb[k];
                left *= 1 - alpha;
            }
        }
}

/* ---- Files -------------------------------------------------------------------------------------
 */

/* The left fifth of the image, which the mask declares dynamic; the mask has half of the image's
 * size. */
static bool moves(const struct spin_camera *c, int x) { return x / 2 < c->width / 2 / 5; }

/* Input images: renders, brightened by a factor of each view, and by another factor in the
 * dynamic region. */
static void write_photo(int f, int k)
{
    static double image[3 * MOST];
    static uint8_t rgb[3 * MOST], mask[3 * MOST];
    const struct spin_camera *c = &camera[f][k];
    int brighter = 4 + 2 * k + f;
    char path[700];

    see(f, c, &pose[f][k], image);
    for (int i = 0; i < 3 * c->width * c->height; i++)
        rgb[i] = (uint8_t)lrint(255 * image[i] +
                                (moves(c, i / 3 % c->width) ? brighter + 10 : brighter));
    for (int i = 0; i < c->width * c->height / 4; i++)
        memset(mask + 3 * i, moves(c, 2 * (i % (c->width / 2))) ? 255 : 0, 3);
    for (int m = 0; m < 2; m++) {
        snprintf(path, sizeof path, "%s/rig/%s/%d/%06d.png", folder, m ? "seg" : "ims", id[k],
                 FIRST + f);
        if (spin_image_write(path, c->width >> m, c->height >> m, m ? mask : rgb, false) !=
            SPIN_OK) {
            printf("#   %s\n", spin_last_error());
            exit(1);
        }
    }
}

static void write_meta(const char *name, int first, int end)
{
    static const char *const list[] = {"k", "w2c", "fn", "cam_id"};
    char path[700];
    FILE *to;

    snprintf(path, sizeof path, "%s/rig/%s", folder, name);
    to = fopen(path, "w");
    if (!to)
        exit(1);
    fprintf(to, "{\"w\": %d, \"h\": %d", lens[first].width, lens[first].height);
    for (int l = 0; l < 4; l++) {
        fprintf(to, ", \"%s\": [", list[l]);
        for (int f = 0; f < FRAMES; f++) {
            fprintf(to, "%s[", f ? ", " : "");
            for (int k = first; k < end; k++) {
                const struct spin_camera *c = &camera[f][k];
                const double *m = c->w2c;

                fprintf(to, "%s", k > first ? ", " : "");
                if (l == 0)
                    fprintf(to, "[[%.17g, 0, %.17g], [0, %.17g, %.17g], [0, 0, 1]]", c->fx, c->cx,
                            c->fy, c->cy);
                else if (l == 1)
                    fprintf(to,
                            "[[%.17g, %.17g, %.17g, %.17g], [%.17g, %.17g, %.17g, %.17g], "
                            "[%.17g, %.17g, %.17g, %.17g], [0, 0, 0, 1]]",
                            m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9], m[10],
                            m[11]);
                else if (l == 2)
                    fprintf(to, "\"%d/%06d.png\"", id[k], FIRST + f);
                else
                    fprintf(to, "%d", id[k]);
            }
            fprintf(to, "]");
        }
        fprintf(to, "]");
    }
    fprintf(to, "}\n");
    fclose(to);
}

static void write_bundle(void)
{
    enum { SH = 12 };
    static const double c0 = 0.28209479177387814, c1 = 0.4886025119029199;
    struct spin_bundle_meta meta = {.columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
                                    .sh_degree = 1,
                                    .numbered = true,
                                    .n_source_frames = FRAMES};
    struct spin_bundle_writer w;
    struct spin_splats s = {0};
    char path[700];

    snprintf(path, sizeof path, "%s/rig.spin", folder);
    snprintf(meta.from, sizeof meta.from, "test");
    if (spin_bundle_meta_reserve(&meta, FRAMES) != SPIN_OK ||
        spin_bundle_writer_open(path, true, false, &w) != SPIN_OK ||
        spin_splats_reserve(&s, SPLATS, meta.columns, 1) != SPIN_OK)
        exit(1);
    for (int f = 0; f < FRAMES; f++) {
        for (int i = 0; i < SPLATS; i++) {
            const struct gaussian *g = &scene[f][i];

            s.logit_opacities[i] = (float)log(g->opacity / (1 - g->opacity));
            for (int c = 0; c < 4; c++)
                s.quats[4 * i + c] = (float)(g->q[c] / sqrt(dot(g->q, g->q) + g->q[3] * g->q[3]));
            for (int c = 0; c < 3; c++) {
                float *sh = s.sh + SH * i + c;

                s.means[3 * i + c] = (float)g->place[c];
                s.log_scales[3 * i + c] = (float)log(g->scale[c]);
                sh[0] = (float)((g->colour[c] - 0.5) / c0);
                sh[3] = (float)(-g->change[1] / c1); /* the basis is -y, z, -x */
                sh[6] = (float)(g->change[2] / c1);
                sh[9] = (float)(-g->change[0] / c1);
            }
        }
        meta.frame[f] = (struct spin_frame_info){.n = SPLATS, .number = FIRST + f, .time = f};
        meta.source_index[f] = f;
        if (spin_bundle_write_frame(&w, f, meta.columns, 0, &s) != SPIN_OK)
            exit(1);
    }
    ok(spin_bundle_writer_finish(&w, &meta, spin_json_object()) == SPIN_OK,
       "a clip of three frames: %s", spin_last_error());
    spin_bundle_meta_free(&meta);
    spin_splats_free(&s);
}

/* ---- Images of the commands */

/* Compares a part of an image, from column x on, with a frame seen by a camera. Differences
 * beyond the part of a Gaussian outside three standard deviations, which a rasteriser may omit,
 * are errors. */
static void check_picture(const uint8_t *rgb, int whole, int x, int f, const struct spin_camera *c,
                          const struct pose *p, const char *what)
{
    static double image[3 * MOST * 2];
    double sum = 0, most = 0;

    see(f, c, p, image);
    for (int i = 0; i < c->width * c->height; i++)
        for (int k = 0; k < 3; k++) {
            double d = fabs(rgb[3 * (i / c->width * whole + x + i % c->width) + k] -
                            255 * image[3 * i + k]);

            sum += d / (3 * c->width * c->height);
            most = larger(most, d);
        }
    ok(most < 2 && sum < 0.3, "%s: what is seen, within %.2f of 255, %.3f on average", what, most,
       sum);
}

static void check_file(const char *name, int panels, int panel, int gap, int f,
                       const struct spin_camera *c, const struct pose *p)
{
    char path[700];
    uint8_t *rgb = NULL;
    int w = 0, h = 0;

    snprintf(path, sizeof path, "%s/%s", folder, name);
    if (ok(spin_image_read(path, NULL, &w, &h, &rgb) == SPIN_OK &&
               w == panels * c->width + (panels - 1) * gap && h == c->height,
           "%s is of %d panels of %d x %d pixels", name, panels, c->width, c->height))
        check_picture(rgb, w, panel * (c->width + gap), f, c, p, name);
    free(rgb);
}

static void test_images(void)
{
    char name[100];

    ok(shell("%s/spin-export %s/rig.spin --data %s/rig --to images --views all -o %s/all -q", bin,
             folder, folder, folder) == 0 &&
           shell("%s/spin-export %s/rig.spin --data %s/rig --to images --views all --size 70x60 -o "
                 "%s/sized -q "
                 "--range 4:6",
                 bin, folder, folder, folder) == 0,
       "exports pictures of all views: %s", said);
    for (int f = 0; f < FRAMES; f++)
        for (int k = 0; k < CAMERAS; k++) {
            double s = 60.0 / lens[k].height; /* the same vertical field of view, with the principal
                                                 point at the same distance from the centre */
            struct spin_camera c = {70,
                                    60,
                                    lens[k].fx * s,
                                    lens[k].fy * s,
                                    35 + (lens[k].cx - lens[k].width / 2.0) * s,
                                    lens[k].cy * s,
                                    {0},
                                    0};

            snprintf(name, sizeof name, "all/cam_%02d_frame_%05d.png", id[k], FIRST + f);
            check_file(name, 1, 0, 0, f, &camera[f][k], &pose[f][k]);
            snprintf(name, sizeof name, "sized/cam_%02d_frame_%05d.png", id[k], FIRST + f);
            if (f > 0)
                check_file(name, 1, 0, 0, f, &c, &pose[f][k]);
        }
    ok(shell("ls %s/all/*.png %s/sized/*.png | wc -l", folder, folder) == 0 &&
           atoi(said) == 15 + 10,
       "and no other");
}

/* A moving camera starts at the first training camera of the first exported frame, with its
 * lens. */
static void test_path(void)
{
    ok(shell("%s/spin-export %s/rig.spin --data %s/rig --to images --path train --repeat 2 --range "
             "4:6 --size 64x48 -o %s/train -q",
             bin, folder, folder, folder) == 0,
       "exports a path: %s", said);
    check_file("train/train_frame_00000.png", 1, 0, 0, 1, &camera[1][0], &pose[1][0]);
}

/* PSNR of a view's input image against the render, in dB; part 0: the dynamic region, 1: the
 * rest, 2: all. */
static double quality(int f, int k, int part)
{
    static double image[3 * MOST];
    const struct spin_camera *c = &camera[f][k];
    char path[700];
    uint8_t *rgb = NULL;
    int w, h, n = 0;
    double sum = 0;

    see(f, c, &pose[f][k], image);
    snprintf(path, sizeof path, "%s/rig/ims/%d/%06d.png", folder, id[k], FIRST + f);
    if (spin_image_read(path, NULL, &w, &h, &rgb) != SPIN_OK)
        return NAN;
    for (int i = 0; i < 3 * w * h; i++)
        if (part == 2 || moves(c, i / 3 % w) == (part == 0)) {
            double d = rgb[i] / 255.0 - image[i];

            sum += d * d;
            n++;
        }
    free(rgb);
    return 10 * log10(n / sum);
}

static void test_eval(void)
{
    static const char *const key[] = {"psnr_dynamic", "psnr_static", "psnr"};
    double off[3] = {0}, mean[3] = {0};
    const spin_json *views;
    spin_json *j = NULL;
    int found = 0;

    ok(shell("%s/spin-eval %s/rig.spin --data %s/rig --split all --json -q", bin, folder, folder) ==
               0 &&
           spin_json_parse("stdout", said, strlen(said), &j) == SPIN_OK,
       "measures all views");
    views = spin_json_get(j, "views");
    for (size_t i = 0; i < spin_json_length(views); i++) {
        const spin_json *view = spin_json_at(views, i);

        for (int f = 0; f < FRAMES; f++)
            for (int k = 0; k < CAMERAS; k++)
                for (int part = 0; part < 3 && number(view, "frame") == FIRST + f &&
                                   number(view, "camera") == id[k];
                     part++) {
                    double want = quality(f, k, part), error = fabs(number(view, key[part]) - want);

                    found += part == 2;
                    mean[part] += want / (FRAMES * CAMERAS);
                    off[part] = error <= off[part] ? off[part] : error;
                }
    }
    ok(found == FRAMES * CAMERAS && spin_json_length(views) == FRAMES * CAMERAS,
       "each view once: %d", found);
    for (int part = 0; part < 3; part++) {
        ok(off[part] < 0.1, "%s of every view: %g dB off", key[part], off[part]);
        near(number(j, key[part]), mean[part], 0.05, "its mean");
    }
    spin_json_free(j);
}

/* ---- Pages -------------------------------------------------------------------------------------
 */

static char *file_of(const char *name)
{
    char path[700], *text;
    struct spin_map map;

    snprintf(path, sizeof path, "%s/%s", folder, name);
    if (spin_map_open(path, &map) != SPIN_OK)
        exit(1);
    text = strndup((const char *)map.data, map.size);
    spin_map_close(&map);
    return text;
}

static int ascending(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

static void near3(const spin_json *clip_json, const char *key, const double want[3])
{
    double off = 0;

    for (size_t c = 0; c < 3; c++)
        off += fabs(number_at(clip_json, key, c) - want[c]);
    ok(off < 1e-5, "the page's %s: %g off", key, off);
}

/* The page starts at the training view of the first exported frame that shows the splats best. */
static void test_page(void)
{
    const struct pose *p = &pose[1][0];
    double middle[3], extent = 0, up[3] = {0}, target[3], along, depth, least = INFINITY, most = 0,
                      away[3];
    char *page, *text;
    spin_json *j = NULL;

    ok(shell("%s/spin-export %s/rig.spin --data %s/rig --to html --range 4:6 -o %s/rig.html -q",
             bin, folder, folder, folder) == 0,
       "exports a page: %s", said);
    page = file_of("rig.html");
    text = strstr(page, "id=\"clip\">");
    if (!ok(text && strstr(text, "</script>"), "it has a clip"))
        exit(tap_done());
    text += strlen("id=\"clip\">");
    *strstr(text, "</script>") = '\0';
    ok(spin_json_parse("clip", text, strlen(text), &j) == SPIN_OK, "in JSON");
    for (int c = 0; c < 3; c++) {
        double value[SPLATS];

        for (int i = 0; i < SPLATS; i++)
            value[i] = scene[1][i].place[c];
        qsort(value, SPLATS, sizeof *value, ascending);
        middle[c] = value[SPLATS / 2];
        extent = larger(extent, (value[SPLATS - 1] - value[0]) / 2);
        for (int k = 0; k < CAMERAS; k++)
            up[c] -= pose[1][k].down[c];
        away[c] = middle[c] - p->eye[c];
    }
    make_long(up, 1);
    /* The target is on the axis of the camera, about as deep as the middle of the splats. */
    depth = dot(p->ahead, away);
    for (size_t c = 0; c < 3; c++)
        away[c] = number_at(j, "target", c) - p->eye[c];
    along = dot(p->ahead, away);
    near(along, depth, 0.01, "the depth of the page's target");
    for (int c = 0; c < 3; c++)
        target[c] = p->eye[c] + along * p->ahead[c];
    for (int k = 0; k < CAMERAS; k++) {
        for (int c = 0; c < 3; c++)
            away[c] = pose[1][k].eye[c] - target[c];
        least = fmin(least, sqrt(dot(away, away)));
        most = larger(most, sqrt(dot(away, away)));
    }
    near3(j, "centre", middle);
    near(number(j, "size"), extent, 1e-5, "its size");
    near3(j, "eye", p->eye);
    near3(j, "target", target);
    near3(j, "up", up);
    near(number(j, "fovy"), 2 * atan(24 / 45.0) * 57.29577951308232, 1e-6, "as high a view");
    near(number(j, "aspect"), (32 / 90.0) / (24 / 45.0), 1e-6, "as wide");
    near(number(j, "near"), 0.2, 0, "what is nearer is not seen");
    near(number_at(j, "reach", 0), least / 3, 1e-5, "how near one may go");
    near(number_at(j, "reach", 1), 1.2 * most, 1e-5, "and how far");
    spin_json_free(j);
    free(page);
}

/* The image behind *at in a page, and advances *at; NULL if its size is not the expected one. */
static uint8_t *picture_of(const char **at, int width, int height)
{
    static const char digit[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const char *from = strstr(*at, "base64,");
    char path[700];
    unsigned held = 0;
    int w = 0, h = 0;
    uint8_t *rgb = NULL;
    FILE *to;

    snprintf(path, sizeof path, "%s/of-page.png", folder);
    to = from ? fopen(path, "wb") : NULL;
    if (!to)
        return NULL;
    for (from += 7, *at = from; *from && strchr(digit, *from); from++) {
        held = held << 6 | (unsigned)(strchr(digit, *from) - digit);
        if ((from - *at) % 4 > 0)
            putc((int)(held >> (6 - 2 * ((from - *at) % 4)) & 255), to);
    }
    *at = from;
    fclose(to);
    if (spin_image_read(path, NULL, &w, &h, &rgb) == SPIN_OK && w == width && h == height)
        return rgb;
    free(rgb);
    return NULL;
}

/* The worst views in the report of a bundle with imported frames beside a network: the second
 * image of a row is the import's. The same holds for --images. */
static void test_report(void)
{
    char *page, name[100];
    const char *at;
    int rows = 0;

    ok(shell("%s/spin-retrain %s/rig.spin --data %s/rig -o %s/net.spin --preset paper --device cpu "
             "--threads 1 "
             "--levels 2 --hash-log2 8 --finest-resolution 16 --hidden 16 --iterations 1 -q",
             bin, folder, folder, folder) == 0 &&
           shell("%s/spin-eval %s/net.spin --data %s/rig --split all --report %s/report.html "
                 "--images %s/eval -q",
                 bin, folder, folder, folder, folder) == 0,
       "a report with pictures: %s", said);
    page = file_of("report.html");
    at = strstr(page, "<h2>Worst views");
    while (at && (at = strstr(at, "<p>Frame "))) {
        int frame = -1, number = -1, f, k = 0;
        uint8_t *rgb;

        sscanf(at, "<p>Frame %d, camera %d:", &frame, &number);
        f = frame - FIRST;
        while (k < CAMERAS && id[k] != number)
            k++;
        if (!ok(f >= 0 && f < FRAMES && k < CAMERAS, "row of frame %d, camera %d", frame, number))
            break;
        for (int i = 0; i < 2; i++) {
            rgb = picture_of(&at, lens[k].width, lens[k].height);
            if (ok(rgb != NULL, "its picture %d", i) && i == 1)
                check_picture(rgb, lens[k].width, 0, f, &camera[f][k], &pose[f][k], "before");
            free(rgb);
        }
        rows++;
    }
    ok(rows > 2, "%d rows", rows);
    for (int f = 0; f < FRAMES; f++)
        for (int k = 0; k < CAMERAS; k++) {
            snprintf(name, sizeof name, "eval/cam_%02d_frame_%05d.png", id[k], FIRST + f);
            check_file(name, 3, 1, 4, f, &camera[f][k], &pose[f][k]);
        }
    free(page);
}

TAP_MAIN
{
    bin = getenv("SPIN_BIN") ? getenv("SPIN_BIN") : "build/release/bin";
    folder = check_folder();
    if (spin_image_start() != SPIN_OK) {
        skip("cameras", spin_last_error());
        return;
    }
    make_scene();
    write_bundle();
    for (int k = 0; k < CAMERAS; k++)
        shell("mkdir -p %s/rig/ims/%d %s/rig/seg/%d", folder, id[k], folder, id[k]);
    for (int f = 0; f < FRAMES; f++)
        for (int k = 0; k < CAMERAS; k++)
            write_photo(f, k);
    write_meta("train_meta.json", 0, TRAIN);
    write_meta("test_meta.json", TRAIN, CAMERAS);
    test_images();
    test_path();
    test_eval();
    test_page();
    test_report();
}
