/* Writes an evaluation as a JSON document, and as an HTML page. The page is made from the template
 * page.html, the JSON document, curves, crops of fast motion, the views with the lowest PSNR, and
 * the options of the training. Pages of equal runs differ only in the measured speed. */
#include "eval/report/report.h"

#include "base/base.h"
#include "eval/report/svg_chart.h"
#include "io/image.h"
#include "io/template.h"
#include "scene/bundle_meta.h"

enum {
    CROPS = 6,
    WORST = 4,
    LOSS_POINTS = 300,
    PICTURES = 4,
    GAIN = 4 /* factor on the differences in difference images */
};

/* "background_shows" is true if psnr and psnr_opposite differ by at least this, in dB. */
static const double BACKGROUND_SHOWS = 0.3;

extern const char spin_report_page[]; /* page.html */

/* ---- The document ---------------------------------------------------------------------------- */

static spin_json *quality_json(const struct spin_eval_report *r, const struct spin_quality *q)
{
    static const char *const lpips[] = {"lpips_vgg", "lpips_alex"};
    spin_json *j = spin_json_object();

    spin_json_set_number(j, "psnr", q->valid ? q->psnr : NAN);
    spin_json_set_number(j, "ssim", q->valid ? q->ssim : NAN);
    spin_json_set_number(j, "psnr_channel_mean", q->valid ? q->psnr_channel_mean : NAN);
    spin_json_set_number(j, "psnr_colour_fitted", q->valid ? q->psnr_colour_fitted : NAN);
    if (r->dynamic != SPIN_DYNAMIC_OFF) {
        spin_json_set_number(j, "psnr_dynamic", q->psnr_dynamic);
        spin_json_set_number(j, "psnr_static", q->psnr_static);
        spin_json_set_number(j, "dynamic", q->dynamic);
    }
    if (!isnan(r->mean.psnr_opposite))
        spin_json_set_number(j, "psnr_opposite", q->psnr_opposite);
    for (int i = 0; i < SPIN_N_LPIPS; i++)
        if (!isnan(r->mean.lpips[i]))
            spin_json_set_number(j, lpips[i], q->lpips[i]);
    return j;
}

/* Adds the mean flicker of n cameras to a JSON object, or nothing if n is 0, that is, if flicker
 * was not measured. */
static void add_flicker(const struct spin_flicker_sums *sums, size_t n, spin_json *j)
{
    struct spin_flicker mean = spin_flicker_mean(sums, n);

    if (n == 0)
        return;
    spin_json_set_number(j, "flicker", mean.render);
    spin_json_set_number(j, "flicker_images", mean.images);
    spin_json_set_number(j, "flicker_dynamic", mean.dynamic_error);
}

/* Adds the flicker of a camera to a JSON object, if the camera is static and flicker was measured.
 */
static void add_camera_flicker(const struct spin_eval_report *r, int camera, spin_json *j)
{
    for (size_t i = 0; i < r->n_flicker; i++)
        if (r->flicker[i].camera == camera)
            add_flicker(&r->flicker[i], 1, j);
}

static spin_json *bytes_json(const struct spin_eval_report *r, const struct spin_bundle_bytes *s)
{
    spin_json *j = spin_bundle_bytes_json(s);
    /* Total size of those parts of the bundle that contain the measured attributes. */
    uint64_t measured = r->trained   ? s->positions + s->tracks + s->table + s->heads
                        : r->refined ? s->refined
                                     : s->source;

    spin_json_set_integer(j, "measured", (int64_t)measured);
    spin_json_set_number(j, "measured_per_frame", (double)measured / r->n_bundle_frames);
    return j;
}

spin_json *spin_eval_json(const struct spin_eval_report *r, enum spin_split split)
{
    static const char *const splits[] = {"test", "train", "all", "outer"};
    static const char *const dynamic[] = {"auto", "masks", "images", "off"};
    spin_json *j = quality_json(r, &r->mean), *one;
    spin_json *frames = spin_json_array(), *cameras = spin_json_array(), *views = spin_json_array();

    for (size_t i = 0; i < r->n_views; i++) {
        const struct spin_eval_view *v = &r->view[i];
        struct spin_quality mean;
        size_t k = 0;

        while (r->view[k].camera != v->camera)
            k++;
        if (k == i) { /* this is the first view of the camera */
            mean = spin_eval_mean(r, NULL, &v->camera);
            spin_json_push(cameras, one = quality_json(r, &mean));
            spin_json_set_integer(one, "id", v->camera);
            add_camera_flicker(r, v->camera, one);
        }
        if (i == 0 || r->view[i - 1].frame != v->frame) { /* the views of a frame are consecutive */
            mean = spin_eval_mean(r, &v->frame, NULL);
            spin_json_push(frames, one = quality_json(r, &mean));
            spin_json_set_integer(one, "frame", v->frame);
        }
        spin_json_push(views, one = quality_json(r, &v->q));
        spin_json_set_integer(one, "frame", v->frame);
        spin_json_set_integer(one, "camera", v->camera);
    }
    add_flicker(r->flicker, r->n_flicker, j);
    spin_json_set_bool(j, "background_shows",
                       fabs(r->mean.psnr - r->mean.psnr_opposite) >= BACKGROUND_SHOWS);
    spin_json_set_bool(j, "alpha_known", r->alpha_known);
    spin_json_set_string(j, "attributes",
                         r->trained   ? "retrained"
                         : r->refined ? "frames"
                                      : "source");
    spin_json_set_string(j, "split", splits[split]);
    spin_json_set_string(j, "dynamic_from", dynamic[r->dynamic]);
    spin_json_set_string(j, "mask", r->subject);
    spin_json_set_number(j, "fps", 1 / (r->seconds_decode + r->seconds_draw));
    spin_json_set_number(j, "fps_draw", 1 / r->seconds_draw);
    spin_json_set_number(j, "seconds_decode", r->seconds_decode);
    spin_json_set_number(j, "seconds_draw", r->seconds_draw);
    spin_json_set_integer(j, "left_out", (int64_t)r->left_out);
    if (r->n_bundle_frames > 0) { /* 0 in the report of the source, which has no storage */
        spin_json_set(j, "storage", bytes_json(r, &r->storage));
        spin_json_set(j, "storage_unpacked", bytes_json(r, &r->unpacked));
    }
    spin_json_set(j, "frames", frames);
    spin_json_set(j, "cameras", cameras);
    spin_json_set(j, "views", views);
    return j;
}

/* ---- Curves ---------------------------------------------------------------------------------- */

/* Reads the member `key` of all objects in an array; NaN if it is missing or not a number. */
static void read_numbers(const spin_json *array, const char *key, double *out)
{
    for (size_t i = 0; i < spin_json_length(array); i++) {
        out[i] = NAN;
        spin_json_number(spin_json_get(spin_json_at(array, i), key), &out[i]);
    }
}

/* Draws a chart of the PSNR over the frames: solid lines for whole images, dashed lines for dynamic
 * regions. */
static spin_status draw_frames(const spin_json *const report[2], FILE *to)
{
    static const char *const names[2][2] = {{"after", "after, dynamic"},
                                            {"before", "before, dynamic"}};
    static const char *const keys[] = {"psnr", "psnr_dynamic"};
    struct spin_svg_chart_line line[4];
    struct spin_svg_chart chart = {.title = "PSNR over the frames",
                                   .x_name = "frame",
                                   .y_name = "PSNR, dB",
                                   .line = line,
                                   .whole = true};
    size_t n = spin_json_length(spin_json_get(report[0], "frames"));
    double *y;
    SPIN_FREED double *x = NULL;

    SPIN_TRY(spin_alloc(n, 5 * sizeof(double), (void **)&x));
    y = x + n;
    read_numbers(spin_json_get(report[0], "frames"), "frame", x);
    for (int k = 0; k < 2; k++)
        for (int part = 0; part < 2; part++) {
            const spin_json *frames = spin_json_get(report[k], "frames");

            if (!spin_json_get(report[k], keys[part]))
                continue;
            read_numbers(frames, keys[part], y);
            line[chart.n_lines++] = (struct spin_svg_chart_line){names[k][part], x, y, n, k, part};
            y += n;
        }
    spin_svg_chart_write(to, &chart);
    return SPIN_OK;
}

static void draw_history(const struct spin_train_log *h, FILE *to)
{
    struct spin_svg_chart_line line = {"test PSNR", h->test, h->psnr, h->n_tests, 0, false};
    struct spin_svg_chart chart = {.title = "Test PSNR over the iterations",
                                   .x_name = "iteration",
                                   .y_name = "PSNR, dB",
                                   .line = &line,
                                   .n_lines = 1,
                                   .whole = true};

    spin_svg_chart_write(to, &chart);
    for (size_t i = 0; i < h->n_tests; i++)
        h->seconds[i] /= 60;
    line.x = h->seconds;
    chart.title = "Test PSNR over time";
    chart.x_name = "minutes of training";
    chart.whole = false;
    spin_svg_chart_write(to, &chart);
    line = (struct spin_svg_chart_line){"loss", h->step, h->loss, h->n_steps, 2, false};
    chart.title = "Training loss, averaged over intervals";
    chart.x_name = "iteration";
    chart.y_name = "loss";
    chart.whole = true;
    spin_svg_chart_write(to, &chart);
}

static void warn_other_run(const struct spin_report *r, const struct spin_train_log *h)
{
    double last = h->n_tests > 0 ? h->psnr[h->n_tests - 1] : (double)NAN;

    if (fabs(last - r->trained_psnr) > 1e-4)
        spin_warn(
            "the log '%s' seems to belong to another run: its last test PSNR is %.3f dB, that of "
            "'%s' is %.3f dB",
            r->log, last, r->input, r->trained_psnr);
}

static spin_status add_curves(const struct spin_report *r, spin_json *page,
                              const spin_json *const report[2])
{
    SPIN_LEAVES(spin_train_log_free) struct spin_train_log history = {0};
    SPIN_FREED char *frames = NULL, *training = NULL;
    size_t n;
    FILE *over_frames = spin_text_open(&frames, &n), *over_training = spin_text_open(&training, &n);
    bool failed;
    spin_status status =
        over_frames && over_training
            ? SPIN_OK
            : spin_fail(SPIN_E_MEMORY, "out of memory for the curves of the report");

    if (status == SPIN_OK && r->log)
        status = spin_train_log_read(r->log, LOSS_POINTS, &history);
    if (status == SPIN_OK && r->log)
        warn_other_run(r, &history);
    if (status == SPIN_OK)
        status = draw_frames(report, over_frames);
    if (status == SPIN_OK && (history.n_tests > 1 || history.n_steps > 1))
        draw_history(&history, over_training);
    failed = over_frames && fclose(over_frames) != 0;
    failed |= over_training && fclose(over_training) != 0;
    if (failed)
        status = spin_fail(SPIN_E_MEMORY, "out of memory for the curves of the report");
    spin_json_set_string(page, "over_frames", frames);
    spin_json_set_string(page, "over_training", training);
    if (history.total_seconds > 0)
        spin_json_set_number(page, "minutes", history.total_seconds / 60);
    return status;
}

/* ---- Images ---------------------------------------------------------------------------------- */

struct pictures {
    const struct spin_report *r;
    /* [3][h][w] each: ground truth, source, measured splats, difference. */
    float *picture[PICTURES];
    uint8_t *rgb;
};

/* Appends a crop of an image to the JSON array `to`, as a PNG in base64. */
static spin_status put_picture(struct pictures *p, const struct spin_camera *c, const float *image,
                               const struct spin_crop *crop, spin_json *to)
{
    size_t plane = (size_t)c->width * (size_t)c->height, n = 0, k = 0;
    unsigned char *bytes = NULL;
    SPIN_FREED char *text = NULL;
    FILE *out;

    for (int v = crop->y; v < crop->y + crop->side_y; v++)
        for (int u = crop->x; u < crop->x + crop->side_x; u++)
            for (size_t channel = 0; channel < 3; channel++) {
                float value = image[channel * plane + (size_t)v * (size_t)c->width + (size_t)u];

                p->rgb[k++] = (uint8_t)lrintf(255 * fminf(fmaxf(value, 0), 1));
            }
    SPIN_TRY(spin_image_encode(crop->side_x, crop->side_y, p->rgb, &bytes, &n));
    out = spin_text_open(&text, &k);
    if (out)
        spin_text_base64(out, bytes, n);
    free(bytes);
    if (!out || fclose(out) != 0)
        return spin_fail(SPIN_E_MEMORY, "out of memory for an image of the report");
    spin_json_push_string(to, text);
    return SPIN_OK;
}

/* Loads the ground truth of pair i, renders the pair from the source (if there is one) and from the
 * measured splats, and computes the difference image. */
static spin_status draw_pair(struct pictures *p, size_t i)
{
    const struct spin_pair *pair = &p->r->pairs[i];
    const struct spin_camera *c = &p->r->clip->views.view[pair->view].camera;
    struct spin_player *player[2] = {p->r->source, p->r->player};

    SPIN_TRY(spin_image_cache_get(p->r->pixels, pair->view, p->picture[0]));
    for (int k = 0; k < 2; k++) {
        if (!player[k])
            continue;
        SPIN_TRY(spin_player_show(player[k], p->r->clip->frame[pair->frame]));
        SPIN_TRY(spin_player_draw(player[k], c, p->r->background, p->picture[k + 1]));
    }
    for (size_t k = 0; k < 3 * (size_t)c->width * (size_t)c->height; k++)
        p->picture[3][k] = GAIN * fabsf(fminf(fmaxf(p->picture[2][k], 0), 1) - p->picture[0][k]);
    return SPIN_OK;
}

static spin_status add_row(struct pictures *p, const struct spin_crop *crop, const char *title,
                           spin_json *rows)
{
    const struct spin_eval_view *after = &p->r->after->view[crop->pair];
    const struct spin_camera *c = &p->r->clip->views.view[p->r->pairs[crop->pair].view].camera;
    spin_json *row = spin_json_object(), *pictures = spin_json_array();

    spin_json_push(rows, row);
    spin_json_set_string(row, "title", title);
    spin_json_set_integer(row, "frame", after->frame);
    spin_json_set_integer(row, "camera", after->camera);
    spin_json_set_number(row, "psnr", after->q.psnr);
    if (p->r->before)
        spin_json_set_number(row, "psnr_before", p->r->before->view[crop->pair].q.psnr);
    spin_json_set_integer(row, "side_x", crop->side_x);
    spin_json_set_integer(row, "side_y", crop->side_y);
    spin_json_set(row, "images", pictures);
    SPIN_TRY(draw_pair(p, crop->pair));
    for (int k = 0; k < PICTURES; k++)
        if (k != 1 || p->r->source)
            SPIN_TRY(put_picture(p, c, p->picture[k], crop, pictures));
    return SPIN_OK;
}

/* Adds the flicker strips of the images and of the renders. */
static spin_status add_strip(struct pictures *p, spin_json *page)
{
    const struct spin_flicker_strip *s = p->r->strip;
    struct spin_camera size = {.width = s->width, .height = s->n_frames};
    struct spin_crop whole = {.side_x = s->width, .side_y = s->n_frames};
    spin_json *strip = spin_json_object(), *images = spin_json_array();

    spin_json_set(page, "strip", strip);
    spin_json_set(strip, "images", images);
    spin_json_set_integer(strip, "camera", s->camera);
    spin_json_set_integer(strip, "row", s->row);
    spin_json_set_integer(strip, "frames", s->n_frames);
    SPIN_TRY(put_picture(p, &size, s->images, &whole, images));
    return put_picture(p, &size, s->render, &whole, images);
}

static spin_status add_pictures(const struct spin_report *r, spin_json *page)
{
    struct pictures p = {.r = r};
    size_t plane = spin_views_pixels(&r->clip->views), worst[WORST], n = 0;
    size_t strip = (size_t)r->strip->width * (size_t)r->strip->n_frames;
    spin_json *rows = spin_json_array();
    struct spin_crop crop[CROPS];
    spin_status status;

    spin_json_set(page, "rows", rows);
    spin_json_set_integer(page, "gain", GAIN);
    for (int k = 0; k < PICTURES; k++)
        SPIN_TRY_OUT(spin_alloc(plane, 3 * sizeof(float), (void **)&p.picture[k]));
    SPIN_TRY_OUT(spin_alloc(plane > strip ? plane : strip, 3, (void **)&p.rgb));
    if (strip > 0)
        SPIN_TRY_OUT(add_strip(&p, page));
    SPIN_TRY_OUT(
        spin_motion_crops_fast(r->clip, r->pixels, r->pairs, r->after->n_views, CROPS, crop, &n));
    for (size_t i = 0; i < n; i++)
        SPIN_TRY_OUT(add_row(&p, &crop[i], i ? NULL : "Fastest motion", rows));
    n = spin_motion_crops_worst(r->after->view, r->after->n_views, WORST, worst);
    for (size_t i = 0; i < n; i++) {
        const struct spin_camera *c = &r->clip->views.view[r->pairs[worst[i]].view].camera;
        struct spin_crop whole = {.pair = worst[i], .side_x = c->width, .side_y = c->height};

        SPIN_TRY_OUT(add_row(&p, &whole, i ? NULL : "Worst views", rows));
    }
out:
    for (int k = 0; k < PICTURES; k++)
        free(p.picture[k]);
    free(p.rgb);
    return status;
}

/* ---- The page -------------------------------------------------------------------------------- */

/* Adds a table row for each camera, and a row with the means over all cameras. */
static void add_cameras(spin_json *page, const spin_json *const report[2])
{
    static const char *const when[] = {"now", "then"};
    spin_json *rows = spin_json_array();
    size_t n = spin_json_length(spin_json_get(report[0], "cameras"));

    for (size_t i = 0; i <= n; i++) {
        spin_json *row = spin_json_object();

        for (int k = 0; k < 2 && report[k]; k++) {
            const spin_json *from =
                i < n ? spin_json_at(spin_json_get(report[k], "cameras"), i) : report[k];

            spin_json_set(row, when[k], json_copy((json_t *)(uintptr_t)from));
        }
        if (i == n)
            spin_json_set_string(spin_json_get(row, "now"), "id", "all");
        spin_json_push(rows, row);
    }
    spin_json_set(page, "cameras", rows);
    spin_json_set_integer(page, "columns", report[1] ? 2 : 1);
}

static void add_storage(spin_json *page, const spin_json *after)
{
    static const char *const parts[][2] = {
        {"source", "source"},  {"refined", "refined frames"}, {"positions", "per-frame values"},
        {"tracks", "tracks"},  {"table", "hash grid"},        {"heads", "heads"},
        {"file", "whole file"}};
    spin_json *rows = spin_json_array();

    for (size_t i = 0; i < sizeof parts / sizeof *parts; i++) {
        double packed = 0, unpacked = 0;
        spin_json *row = spin_json_object();

        spin_json_number(spin_json_get(spin_json_get(after, "storage"), parts[i][0]), &packed);
        spin_json_number(spin_json_get(spin_json_get(after, "storage_unpacked"), parts[i][0]),
                         &unpacked);
        spin_json_set_string(row, "name", parts[i][1]);
        spin_json_set_number(row, "packed", packed / 1e6);
        spin_json_set_number(row, "unpacked", unpacked / 1e6);
        if (unpacked > 0)
            spin_json_push(rows, row);
        else
            spin_json_free(row);
    }
    spin_json_set(page, "storage", rows);
}

static spin_status fill_page(const struct spin_report *r, spin_json *page)
{
    static const char *const split[] = {"test ", "training ", "", "outer test "};
    const spin_json *report[2] = {spin_eval_json(r->after, r->split),
                                  r->before ? spin_eval_json(r->before, r->split) : NULL};
    /* Trained 4D splats are stored as the source of their bundle. */
    bool source = !r->after->trained && !r->after->refined;
    spin_json *trained = spin_json_get(r->clip->bundle.json, source ? "trained_4d" : "trained");
    spin_json *options = spin_trained_options(trained);
    char *settings = options ? spin_json_text(options, true) : NULL;

    spin_json_set(page, "after", (spin_json *)(uintptr_t)report[0]);
    if (report[1])
        spin_json_set(page, "before", (spin_json *)(uintptr_t)report[1]);
    spin_json_set_string(page, "version", SPIN_VERSION);
    spin_json_set_string(page, "name", spin_path_name(r->input));
    spin_json_set_string(page, "variant", r->clip->bundle.meta.variant);
    spin_json_set_string(page, "split", split[r->split]);
    if (!r->after->refined && settings) {
        json_object_set(page, "trained", trained);
        spin_json_set_string(page, "settings", settings);
    }
    free(settings);
    spin_json_free(options);
    add_cameras(page, report);
    add_storage(page, report[0]);
    SPIN_TRY(add_curves(r, page, report));
    return add_pictures(r, page);
}

spin_status spin_report_write(const struct spin_report *report)
{
    spin_json *page = spin_json_object();
    struct spin_out out;
    spin_status status = fill_page(report, page);

    if (status == SPIN_OK)
        status = spin_out_open(report->path, report->force, &out);
    if (status == SPIN_OK) {
        spin_template_write(out.file, spin_report_page, page, true);
        status = spin_out_commit(&out);
    }
    spin_json_free(page);
    return spin_fail_context(status, "cannot write the report '%s'", report->path);
}
