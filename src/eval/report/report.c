/* The page: what was measured, curves over frames and over training, a table of the cameras, crops of
 * fast motion, the worst views, the options of the run. Equal runs give equal pages, but for speed. */
#include "eval/report/report.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "spin_run.h"
#include "base/err.h"
#include "base/mem.h"
#include "base/text.h"
#include "eval/report/svg_chart.h"
#include "eval/report/motion_crops.h"
#include "eval/report/train_log.h"
#include "io/file.h"
#include "io/image.h"

enum { CROPS = 6, WORST = 4, LOSS_POINTS = 300, PICTURES = 4, GAIN = 4 /* of the difference */ };

/* One page in the making. */
struct page {
    const struct spin_report *r;
    FILE *to;
    float *picture[PICTURES]; /* truth, before, after, difference, [3][h][w] each */
    uint8_t *rgb;
    struct spin_train_log history; /* of --log, or empty */
};

/* ---- Text ---------------------------------------------------------------------------------------- */

/* A number in a cell; nothing where it was not measured. */
static void put_cell(FILE *to, const char *tag, double value, int digits)
{
    if (isnan(value))
        fprintf(to, "<%s></%s>", tag, tag);
    else
        fprintf(to, "<%s>%.*f</%s>", tag, digits, value, tag);
}

static const char style[] =
    "<style>\n"
    ":root{color-scheme:light dark;--back:#fff;--ink:#1c2430;--soft:#5c6675;--rule:#d8dde4;"
    "--l0:#1764c0;--l1:#8a94a3;--l2:#b4480f}\n"
    "@media (prefers-color-scheme:dark){:root{--back:#14181e;--ink:#e4e8ee;--soft:#9aa5b4;"
    "--rule:#313945;--l0:#6aaeff;--l1:#8d98a8;--l2:#f0935a}}\n"
    "body{margin:2rem auto;max-width:62rem;padding:0 1rem;background:var(--back);color:var(--ink);"
    "font:15px/1.45 system-ui,sans-serif}\n"
    "h1{font-size:1.5rem;margin:0}h2{font-size:1.1rem;margin:2.2rem 0 .6rem}\n"
    "p{color:var(--soft);margin:.3rem 0}\n"
    ".tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(9.5rem,1fr));gap:.6rem;"
    "margin:1.2rem 0}\n"
    ".tiles div{border:1px solid var(--rule);border-radius:6px;padding:.5rem .8rem}\n"
    ".tiles b{display:block;font-size:1.3rem;font-weight:600}.tiles span{color:var(--soft);"
    "font-size:.85rem}\n"
    "table{border-collapse:collapse;font-variant-numeric:tabular-nums}\n"
    "th,td{padding:.2rem .8rem;text-align:right;border-bottom:1px solid var(--rule)}\n"
    "th{font-weight:600}th[colspan]{text-align:center}\n"
    "figure{margin:1rem 0}figcaption{font-weight:600}\n"
    ".legend{margin:.1rem 0}.legend span{margin-right:1rem;white-space:nowrap}\n"
    ".chart{width:100%;height:auto}.chart text{font-size:11px;fill:var(--soft)}\n"
    ".grid{stroke:var(--rule)}.tick{stroke:var(--soft)}\n"
    ".line{fill:none;stroke-width:2;stroke-linejoin:round}.dashed{stroke-dasharray:5 4}\n"
    ".line-0{stroke:var(--l0)}.line-1{stroke:var(--l1)}.line-2{stroke:var(--l2)}\n"
    ".dot{stroke:none}.dot.line-0{fill:var(--l0)}.dot.line-1{fill:var(--l1)}"
    ".dot.line-2{fill:var(--l2)}\n"
    ".row{display:grid;gap:4px;margin:0 0 .2rem}.row img{width:100%;height:auto;display:block;"
    "image-rendering:pixelated}\n"
    ".row.names{color:var(--soft);font-size:.85rem}\n"
    "pre{border:1px solid var(--rule);border-radius:6px;padding:.8rem;overflow:auto;"
    "font-size:.85rem}\n"
    ".wide{overflow-x:auto}\n"
    "@media (max-width:480px){body{margin:1rem auto}.chart text{font-size:19px}"
    ".chart .upright{display:none}table{font-size:.8rem}th,td{padding:.2rem .25rem}"
    ".row{grid-template-columns:1fr 1fr!important}"
    "}\n"
    "</style>\n";

static const char *name_of(const struct page *p)
{
    const struct spin_eval_report *r = p->r->after;

    return r->trained ? "retrained" : r->refined ? "frames" : "source";
}

/* ---- At the top ---------------------------------------------------------------------------------- */

static void put_tile(FILE *to, const char *name, double after, double before, int digits,
                     const char *unit)
{
    if (isnan(after))
        return;
    fprintf(to, "<div><b>%.*f%s</b>%s", digits, after, unit, name);
    if (!isnan(before))
        fprintf(to, "<br><span>before %.*f</span>", digits, before);
    fprintf(to, "</div>\n");
}

static void put_tiles(struct page *p)
{
    const struct spin_eval_report *a = p->r->after;
    const struct spin_quality none = {
        .psnr = NAN, .ssim = NAN, .psnr_dynamic = NAN, .psnr_static = NAN, .lpips = {NAN, NAN}};
    const struct spin_quality *after = &a->mean;
    const struct spin_quality *before = p->r->before ? &p->r->before->mean : &none;
    const struct spin_bundle_bytes *s = &a->storage;
    uint64_t bytes = a->trained   ? s->positions + s->tracks + s->table + s->heads
                     : a->refined ? s->refined
                                  : s->source;
    char each[32];

    fprintf(p->to, "<div class=\"tiles\">\n");
    put_tile(p->to, "PSNR", after->psnr, before->psnr, 2, " dB");
    put_tile(p->to, "SSIM", after->ssim, before->ssim, 4, "");
    put_tile(p->to, "PSNR, dynamic regions", after->psnr_dynamic, before->psnr_dynamic, 2, " dB");
    put_tile(p->to, "PSNR, elsewhere", after->psnr_static, before->psnr_static, 2, " dB");
    put_tile(p->to, "LPIPS (VGG)", after->lpips[0], before->lpips[0], 4, "");
    put_tile(p->to, "LPIPS (Alex)", after->lpips[1], before->lpips[1], 4, "");
    put_tile(p->to, "frames per second", 1 / (a->seconds_decode + a->seconds_draw), NAN, 2, "");
    fprintf(p->to, "<div><b>%s</b>storage per frame</div>\n</div>\n",
            spin_text_bytes(bytes / (uint64_t)a->n_bundle_frames, each));
}

/* How it was trained, in a line; all options are at the end. */
static void put_training(struct page *p)
{
    const spin_json *trained = spin_json_get(p->r->clip->bundle.json, "trained");
    const spin_json *options = spin_json_get(trained, "options");
    const char *method = spin_json_string(spin_json_get(options, "method"));
    const char *device = spin_json_string(spin_json_get(trained, "device"));
    double iterations;

    if (!p->r->after->trained ||
        !spin_json_number(spin_json_get(options, "iterations"), &iterations))
        return;
    fprintf(p->to, "<p>Trained by spin-retrain --iterations %.0f", iterations);
    if (method) {
        fprintf(p->to, " --method ");
        spin_text_html(p->to, method);
    }
    if (device) {
        fprintf(p->to, " on ");
        spin_text_html(p->to, device);
    }
    if (p->history.total_seconds > 0)
        fprintf(p->to, " in %.1f minutes", p->history.total_seconds / 60);
    fprintf(p->to, "; all options are at the end.</p>\n");
}

static void put_head(struct page *p)
{
    const struct spin_eval_report *a = p->r->after;
    static const char *const split[] = {"test", "training", ""};

    fprintf(p->to, "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n<meta "
                   "name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n<title>");
    spin_text_html(p->to, spin_path_name(p->r->options->input));
    fprintf(p->to, " - spin4d</title>\n%s</head><body>\n<h1>", style);
    spin_text_html(p->to, spin_path_name(p->r->options->input));
    fprintf(p->to, "</h1>\n<p>%s attributes, %zu %s views of %d frames. From ", name_of(p),
            a->n_views, split[p->r->options->split], a->n_frames);
    spin_text_html(p->to, p->r->clip->bundle.meta.variant);
    fprintf(p->to, ".%s</p>\n",
            a->dynamic == SPIN_DYNAMIC_MASKS    ? " Dynamic regions: the data set's masks."
            : a->dynamic == SPIN_DYNAMIC_IMAGES ? " Dynamic regions: pixels that differ from their "
                                                  "camera's median over time."
                                                : "");
    put_training(p);
    put_tiles(p);
}

/* ---- Curves -------------------------------------------------------------------------------------- */

static size_t list_frames(const struct spin_eval_report *r, int *frame)
{
    size_t n = 0;

    for (size_t i = 0; i < r->n_views; i++)
        if (n == 0 || frame[n - 1] != r->view[i].frame)
            frame[n++] = r->view[i].frame;
    return n;
}

/* PSNR over the frames: all of the picture solid, dynamic regions dashed. */
static spin_status put_frames(struct page *p)
{
    const struct spin_eval_report *report[2] = {p->r->after, p->r->before};
    struct spin_svg_chart_line line[4];
    struct spin_svg_chart chart = {.title = "PSNR over the frames",
                                   .x_name = "frame",
                                   .y_name = "PSNR, dB",
                                   .line = line,
                                   .whole = true};
    static const char *const names[2][2] = {{"after", "after, dynamic"},
                                            {"before", "before, dynamic"}};
    size_t most = p->r->after->n_views, n;
    void *block = NULL;
    double *x, *y;
    int *frame;

    SPIN_TRY(spin_alloc(most, 5 * sizeof(double) + sizeof(int), &block));
    x = block;
    y = x + most;
    frame = (int *)(x + 5 * most);
    n = list_frames(p->r->after, frame);
    for (size_t i = 0; i < n; i++)
        x[i] = frame[i];
    for (int k = 0; k < 2 && report[k]; k++) {
        double *all = y + 2 * (size_t)k * most, *dynamic = all + most;

        for (size_t i = 0; i < n; i++) {
            struct spin_quality q = spin_eval_mean(report[k], &frame[i], NULL);

            all[i] = q.psnr;
            dynamic[i] = q.psnr_dynamic;
        }
        line[chart.n_lines++] = (struct spin_svg_chart_line){names[k][0], x, all, n, k, false};
        if (report[k]->dynamic != SPIN_DYNAMIC_OFF)
            line[chart.n_lines++] =
                (struct spin_svg_chart_line){names[k][1], x, dynamic, n, k, true};
    }
    if (n > 1)
        fprintf(p->to, "<h2>Over the frames</h2>\n");
    spin_svg_chart_write(p->to, &chart);
    free(block);
    return SPIN_OK;
}

static void put_history(struct page *p)
{
    const struct spin_train_log *h = &p->history;
    struct spin_svg_chart_line line = {.name = "test PSNR"};
    struct spin_svg_chart chart = {
        .line = &line, .n_lines = 1, .y_name = "PSNR, dB", .whole = true};

    if (h->n_tests < 2 && h->n_steps < 2)
        return;
    fprintf(p->to, "<h2>Over the training</h2>\n");
    line.x = h->test;
    line.y = h->psnr;
    line.n = h->n_tests;
    chart.title = "Test PSNR over the iterations";
    chart.x_name = "iteration";
    spin_svg_chart_write(p->to, &chart);
    for (size_t i = 0; i < h->n_tests; i++)
        h->seconds[i] /= 60;
    line.x = h->seconds;
    chart.title = "Test PSNR over time";
    chart.x_name = "minutes of training";
    chart.whole = false;
    spin_svg_chart_write(p->to, &chart);
    chart.whole = true;
    line = (struct spin_svg_chart_line){"loss", h->step, h->loss, h->n_steps, 2, false};
    chart.title = "Training loss, means over stretches";
    chart.x_name = "iteration";
    chart.y_name = "loss";
    spin_svg_chart_write(p->to, &chart);
}

/* ---- The cameras --------------------------------------------------------------------------------- */

static void put_camera_row(struct page *p, const int *camera)
{
    const struct spin_eval_report *r[2] = {p->r->before, p->r->after};
    struct spin_quality q[2];
    bool dynamic = p->r->after->dynamic != SPIN_DYNAMIC_OFF;

    for (int k = 0; k < 2; k++)
        if (r[k])
            q[k] = spin_eval_mean(r[k], NULL, camera);
    if (camera)
        fprintf(p->to, "<tr><th>%d</th>", *camera);
    else
        fprintf(p->to, "<tr><th>all</th>");
    for (int k = r[0] ? 0 : 1; k < 2; k++)
        put_cell(p->to, "td", q[k].psnr, 2);
    if (r[0])
        fprintf(p->to, "<td>%+.2f</td>", q[1].psnr - q[0].psnr);
    for (int k = r[0] ? 0 : 1; k < 2; k++)
        put_cell(p->to, "td", q[k].ssim, 4);
    for (int k = r[0] ? 0 : 1; k < 2 && dynamic; k++)
        put_cell(p->to, "td", q[k].psnr_dynamic, 2);
    for (int i = 0; i < SPIN_N_LPIPS; i++)
        for (int k = r[0] ? 0 : 1; k < 2; k++)
            if (!isnan(p->r->after->mean.lpips[i]))
                put_cell(p->to, "td", q[k].lpips[i], 4);
    fprintf(p->to, "</tr>\n");
}

static void put_camera_head(struct page *p)
{
    static const char *const lpips[] = {"LPIPS VGG", "LPIPS Alex"};
    int two = p->r->before ? 2 : 1;

    fprintf(p->to,
            "<h2>The cameras</h2>\n<div class=\"wide\"><table><tr><th>camera</th><th "
            "colspan=\"%d\">PSNR</th><th "
            "colspan=\"%d\">SSIM</th>",
            two == 2 ? 3 : 1, two);
    if (p->r->after->dynamic != SPIN_DYNAMIC_OFF)
        fprintf(p->to, "<th colspan=\"%d\">PSNR, dynamic</th>", two);
    for (int i = 0; i < SPIN_N_LPIPS; i++)
        if (!isnan(p->r->after->mean.lpips[i]))
            fprintf(p->to, "<th colspan=\"%d\">%s</th>", two, lpips[i]);
    fprintf(p->to, "</tr>\n");
    if (two == 1)
        return;
    fprintf(p->to, "<tr><th></th><th>before</th><th>after</th><th>gain</th>");
    for (int i = 0; i < 2 + SPIN_N_LPIPS; i++)
        if (i < 1 || (i == 1 && p->r->after->dynamic != SPIN_DYNAMIC_OFF) ||
            (i > 1 && !isnan(p->r->after->mean.lpips[i - 2])))
            fprintf(p->to, "<th>before</th><th>after</th>");
    fprintf(p->to, "</tr>\n");
}

static void put_cameras(struct page *p)
{
    const struct spin_eval_report *a = p->r->after;

    put_camera_head(p);
    for (size_t i = 0; i < a->n_views; i++) {
        size_t k = 0;

        while (a->view[k].camera != a->view[i].camera)
            k++;
        if (k == i) /* the first of its camera */
            put_camera_row(p, &a->view[i].camera);
    }
    put_camera_row(p, NULL);
    fprintf(p->to, "</table></div>\n");
}

/* ---- Pictures ------------------------------------------------------------------------------------ */

/* A part of a picture as a PNG inside the page. */
static spin_status put_picture(struct page *p, const struct spin_camera *c, const float *image,
                               int x, int y, int side_x, int side_y)
{
    size_t plane = (size_t)c->width * (size_t)c->height, n = 0, k = 0;
    unsigned char *bytes = NULL;

    for (int v = y; v < y + side_y; v++)
        for (int u = x; u < x + side_x; u++)
            for (size_t channel = 0; channel < 3; channel++) {
                float value = image[channel * plane + (size_t)v * (size_t)c->width + (size_t)u];

                p->rgb[k++] = (uint8_t)lrintf(255 * fminf(fmaxf(value, 0), 1));
            }
    SPIN_TRY(spin_image_encode(side_x, side_y, p->rgb, &bytes, &n));
    fprintf(p->to, "<img width=\"%d\" height=\"%d\" alt=\"\" src=\"data:image/png;base64,", side_x,
            side_y);
    spin_text_base64(p->to, bytes, n);
    fprintf(p->to, "\">\n");
    free(bytes);
    return SPIN_OK;
}

/* All pictures of a pair. */
static spin_status draw_pair(struct page *p, size_t i)
{
    const struct spin_pair *pair = &p->r->pairs[i];
    const struct spin_camera *c = &p->r->clip->views.view[pair->view].camera;
    struct spin_player *player[2] = {p->r->source, p->r->player};

    SPIN_TRY(spin_image_cache_get(p->r->pixels, pair->view, p->picture[0]));
    for (int k = 0; k < 2; k++) {
        if (!player[k])
            continue;
        SPIN_TRY(spin_player_show(player[k], p->r->clip->frame[pair->frame]));
        SPIN_TRY(spin_player_draw(player[k], c, p->r->options->background, p->picture[k + 1]));
    }
    for (size_t k = 0; k < 3 * (size_t)c->width * (size_t)c->height; k++)
        p->picture[3][k] = GAIN * fabsf(fminf(fmaxf(p->picture[2][k], 0), 1) - p->picture[0][k]);
    return SPIN_OK;
}

static void put_row_begin(struct page *p, const char *more)
{
    fprintf(p->to, "<div class=\"row%s\" style=\"grid-template-columns:repeat(%d,1fr)\">\n", more,
            p->r->source ? 4 : 3);
}

static spin_status put_row(struct page *p, const struct spin_crop *crop)
{
    const struct spin_eval_view *after = &p->r->after->view[crop->pair];
    const struct spin_camera *c = &p->r->clip->views.view[p->r->pairs[crop->pair].view].camera;

    SPIN_TRY(draw_pair(p, crop->pair));
    fprintf(p->to, "<p>Frame %d, camera %d: %.2f dB", after->frame, after->camera, after->q.psnr);
    if (p->r->before)
        fprintf(p->to, ", before %.2f", p->r->before->view[crop->pair].q.psnr);
    fprintf(p->to, "</p>\n");
    put_row_begin(p, "");
    for (int k = 0; k < PICTURES; k++)
        if (k != 1 || p->r->source)
            SPIN_TRY(
                put_picture(p, c, p->picture[k], crop->x, crop->y, crop->side_x, crop->side_y));
    fprintf(p->to, "</div>\n");
    return SPIN_OK;
}

static void put_names(struct page *p)
{
    put_row_begin(p, " names");
    fprintf(p->to, "<span>ground truth</span>%s<span>%s</span><span>difference, %d times</span>\n",
            p->r->source ? "<span>before</span>" : "", p->r->source ? "after" : name_of(p), GAIN);
    fprintf(p->to, "</div>\n");
}

static spin_status put_pictures(struct page *p)
{
    const struct spin_report *r = p->r;
    struct spin_crop crop[CROPS];
    size_t worst[WORST], n = 0;

    SPIN_TRY(
        spin_motion_crops_fast(r->clip, r->pixels, r->pairs, r->after->n_views, CROPS, crop, &n));
    if (n) {
        fprintf(p->to, "<h2>Fastest motion</h2>\n");
        put_names(p);
    }
    for (size_t i = 0; i < n; i++)
        SPIN_TRY(put_row(p, &crop[i]));
    n = spin_motion_crops_worst(r->after->view, r->after->n_views, WORST, worst);
    fprintf(p->to, "<h2>The worst views</h2>\n");
    put_names(p);
    for (size_t i = 0; i < n; i++) {
        const struct spin_camera *c = &r->clip->views.view[r->pairs[worst[i]].view].camera;
        struct spin_crop whole = {.pair = worst[i], .side_x = c->width, .side_y = c->height};

        SPIN_TRY(put_row(p, &whole));
    }
    return SPIN_OK;
}

/* ---- The file ----------------------------------------------------------------------------------- */

static void put_part(struct page *p, const char *name, uint64_t packed, uint64_t unpacked)
{
    if (unpacked > 0)
        fprintf(p->to, "<tr><td>%s</td><td>%.2f</td><td>%.2f</td></tr>\n", name,
                (double)packed / 1e6, (double)unpacked / 1e6);
}

static void put_storage(struct page *p)
{
    const struct spin_bundle_bytes *a = &p->r->after->storage, *b = &p->r->after->unpacked;

    fprintf(p->to, "<h2>Storage</h2>\n<div class=\"wide\"><table><tr><th>part</th><th>in the file, "
                   "MB</th><th>unpacked, MB</th></tr>\n");
    put_part(p, "source", a->source, b->source);
    put_part(p, "refined frames", a->refined, b->refined);
    put_part(p, "values of frames", a->positions, b->positions);
    put_part(p, "tracks", a->tracks, b->tracks);
    put_part(p, "table", a->table, b->table);
    put_part(p, "heads", a->heads, b->heads);
    put_part(p, "the file", a->file, b->file);
    fprintf(p->to, "</table></div>\n");
}

/* ---- The run ------------------------------------------------------------------------------------- */

static void put_options(struct page *p)
{
    const spin_json *trained = spin_json_get(p->r->clip->bundle.json, "trained");
    const spin_json *options = spin_json_get(trained, "options");
    static const char *const plain[] = {"levels", "features", "hidden", NULL};
    const spin_json *field = spin_json_get(trained, "field");
    const char *device = spin_json_string(spin_json_get(trained, "device"));
    char *text = options ? spin_json_text(options, true) : NULL;
    double v;

    if (!p->r->after->trained || !text) {
        free(text);
        return;
    }
    fprintf(p->to, "<h2>Options of the run</h2>\n<p>");
    for (int i = 0; plain[i]; i++)
        if (spin_json_number(spin_json_get(field, plain[i]), &v))
            fprintf(p->to, "%s %.10g, ", plain[i], v);
    if (spin_json_number(spin_json_get(trained, "sh_degree"), &v))
        fprintf(p->to, "sh_degree %.10g", v);
    if (device) {
        fprintf(p->to, "; trained on ");
        spin_text_html(p->to, device);
    }
    fprintf(p->to, "</p>\n<pre>");
    spin_text_html(p->to, text);
    fprintf(p->to, "</pre>\n");
    free(text);
}

static spin_status reserve(struct page *p)
{
    size_t plane = spin_views_pixels(&p->r->clip->views);

    for (int k = 0; k < PICTURES; k++)
        SPIN_TRY(spin_alloc(plane, 3 * sizeof(float), (void **)&p->picture[k]));
    return spin_alloc(plane, 3, (void **)&p->rgb);
}

static spin_status write_page(struct page *p)
{
    SPIN_TRY(reserve(p));
    if (p->r->log)
        SPIN_TRY(spin_train_log_read(p->r->log, LOSS_POINTS, &p->history));
    put_head(p);
    SPIN_TRY(put_frames(p));
    put_history(p);
    put_cameras(p);
    SPIN_TRY(put_pictures(p));
    put_storage(p);
    put_options(p);
    fprintf(p->to, "<p>spin4d %s</p>\n</body></html>\n", SPIN_VERSION);
    return SPIN_OK;
}

spin_status spin_report_write(const struct spin_report *report)
{
    struct page p = {.r = report};
    struct spin_out out;
    spin_status status;

    SPIN_TRY(spin_out_open(report->path, report->force, &out));
    p.to = out.file;
    status = write_page(&p);
    if (status == SPIN_OK)
        status = spin_out_commit(&out);
    else
        spin_out_abandon(&out);
    for (int k = 0; k < PICTURES; k++)
        free(p.picture[k]);
    free(p.rgb);
    spin_train_log_free(&p.history);
    if (status != SPIN_OK && status != SPIN_E_CANCELLED)
        return spin_fail_context(status, "cannot write the report '%s'", report->path);
    return status;
}
