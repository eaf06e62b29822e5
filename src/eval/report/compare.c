/* Writes a comparison of several runs: curves, and for a few views the images of all runs, each
 * with an enlarged crop and the difference from the ground truth. */
#include "eval/report/compare.h"

#include "base/base.h"
#include "eval/report/svg_chart.h"
#include "io/image.h"
#include "io/output.h"
#include "io/template.h"

/* GAP: pixels between images. GAIN: factor on the differences in difference images. LABEL: height
 * of the names of the runs, in pixels. */
enum { GAP = 4, GAIN = 4, LABEL = 24 };

extern const char spin_compare_html[]; /* compare.html */

/* ---- Images ---------------------------------------------------------------------------------- */

/* Chooses the views and crops to show: crops with fast motion or, in a clip without fast motion,
 * the centres of the views with the lowest PSNR. */
static spin_status choose_rows(struct spin_compare *c, const struct spin_clip *clip,
                               struct spin_image_cache *pixels, const struct spin_pair *pairs,
                               const struct spin_eval_report *report)
{
    struct spin_crop crop[SPIN_COMPARE_ROWS];
    size_t worst[SPIN_COMPARE_ROWS];

    SPIN_TRY(spin_motion_crops_fast(clip, pixels, pairs, report->n_views, SPIN_COMPARE_ROWS, crop,
                                    &c->n_rows));
    if (c->n_rows == 0) {
        c->n_rows =
            spin_motion_crops_worst(report->view, report->n_views, SPIN_COMPARE_ROWS, worst);
        for (size_t i = 0; i < c->n_rows; i++) {
            const struct spin_camera *camera = &clip->views.view[pairs[worst[i]].view].camera;

            crop[i] = (struct spin_crop){.pair = worst[i],
                                         .x = camera->width / 3,
                                         .y = camera->height / 3,
                                         .side_x = (camera->width + 2) / 3,
                                         .side_y = (camera->height + 2) / 3};
        }
    }
    for (size_t i = 0; i < c->n_rows; i++) {
        const struct spin_camera *camera = &clip->views.view[pairs[crop[i].pair].view].camera;
        struct spin_compare_row *row = &c->row[i];

        row->crop = crop[i];
        row->width = camera->width;
        row->height = camera->height;
        row->frame = report->view[crop[i].pair].frame;
        row->camera = report->view[crop[i].pair].camera;
    }
    return SPIN_OK;
}

/* Allocates the next image of a row. */
static spin_status add_picture(struct spin_compare_row *row, uint8_t **out)
{
    void *grown = realloc(row->picture, ((size_t)row->n_pictures + 1) * sizeof *row->picture);

    if (!grown)
        return spin_fail(SPIN_E_MEMORY, "out of memory for the images of the comparison");
    row->picture = grown;
    SPIN_TRY(spin_alloc((size_t)row->width * (size_t)row->height, 3, (void **)out));
    row->picture[row->n_pictures++] = *out;
    return SPIN_OK;
}

static spin_status draw_row(struct spin_compare_row *row, const struct spin_clip *clip,
                            struct spin_image_cache *pixels, const struct spin_pair *pair,
                            struct spin_player *player, const float background[3])
{
    size_t plane = (size_t)row->width * (size_t)row->height;
    SPIN_FREED float *image = NULL;
    uint8_t *out = NULL;

    const struct spin_camera *camera = &clip->views.view[pair->view].camera;

    if (camera->width != row->width || camera->height != row->height)
        return spin_misuse("cannot compare the runs: their images of camera %d differ in size; "
                           "give runs of the same data set",
                           row->camera);
    if (row->n_pictures == 0) {
        SPIN_TRY(add_picture(row, &out));
        SPIN_TRY(spin_image_cache_get_rgb8(pixels, pair->view, out));
    }
    SPIN_TRY(add_picture(row, &out));
    SPIN_TRY(spin_alloc(plane, 3 * sizeof(float), (void **)&image));
    SPIN_TRY(spin_player_show(player, clip->frame[pair->frame]));
    SPIN_TRY(spin_player_draw(player, camera, background, image));
    for (size_t i = 0; i < plane; i++)
        for (size_t k = 0; k < 3; k++)
            out[3 * i + k] = (uint8_t)lrintf(255 * fminf(fmaxf(image[k * plane + i], 0), 1));
    return SPIN_OK;
}

spin_status spin_compare_draw(struct spin_compare *c, const struct spin_clip *clip,
                              struct spin_image_cache *pixels, const struct spin_pair *pairs,
                              const struct spin_eval_report *report, struct spin_player *player,
                              const float background[3])
{
    if (c->n == 0)
        SPIN_TRY(choose_rows(c, clip, pixels, pairs, report));
    for (size_t i = 0; i < c->n_rows; i++) {
        size_t at = c->row[i].crop.pair;

        if (at >= report->n_views || report->view[at].frame != c->row[i].frame ||
            report->view[at].camera != c->row[i].camera)
            return SPIN_OK; /* the views of the runs differ, which the caller reports */
    }
    for (size_t i = 0; i < c->n_rows; i++)
        SPIN_TRY(
            draw_row(&c->row[i], clip, pixels, &pairs[c->row[i].crop.pair], player, background));
    c->n++;
    return SPIN_OK;
}

void spin_compare_free(struct spin_compare *c)
{
    for (size_t i = 0; i < c->n_rows; i++) {
        for (int k = 0; k < c->row[i].n_pictures; k++)
            free(c->row[i].picture[k]);
        free(c->row[i].picture);
    }
    spin_json_free(c->runs);
    *c = (struct spin_compare){0};
}

/* ---- Sheets: ground truth and runs side by side, differences below --------------------------- */

struct sheet {
    int width, height;
    uint8_t *rgb;
};

static void put_pixel(struct sheet *s, int x, int y, const uint8_t rgb[3])
{
    if (x >= 0 && x < s->width && y >= 0 && y < s->height)
        memcpy(s->rgb + 3 * ((size_t)y * (size_t)s->width + (size_t)x), rgb, 3);
}

static void put_frame(struct sheet *s, int x, int y, int width, int height)
{
    static const uint8_t white[3] = {255, 255, 255};

    for (int u = x - 1; u <= x + width; u++) {
        put_pixel(s, u, y - 1, white);
        put_pixel(s, u, y + height, white);
    }
    for (int v = y; v < y + height; v++) {
        put_pixel(s, x - 1, v, white);
        put_pixel(s, x + width, v, white);
    }
}

/* Draws an image, and its enlarged crop in the lower left or lower right corner, whichever is
 * farther from the crop. */
static void put_picture(struct sheet *s, int x0, const struct spin_compare_row *row,
                        const uint8_t *picture)
{
    const struct spin_crop *crop = &row->crop;
    int times = 2 * row->width / 5 / crop->side_x, width, height, x, y;

    for (int v = 0; v < row->height; v++)
        memcpy(s->rgb + 3 * ((size_t)v * (size_t)s->width + (size_t)x0),
               picture + 3 * (size_t)v * (size_t)row->width, 3 * (size_t)row->width);
    put_frame(s, x0 + crop->x, crop->y, crop->side_x, crop->side_y);
    times = times < 2 ? 2 : times;
    width = times * crop->side_x;
    height = times * crop->side_y;
    if (width + 2 > row->width || height + 2 > row->height)
        return;
    x = x0 + (2 * crop->x + crop->side_x > row->width ? 2 : row->width - width - 2);
    y = row->height - height - 2;
    for (int v = 0; v < height; v++)
        for (int u = 0; u < width; u++)
            put_pixel(s, x + u, y + v,
                      picture + 3 * ((size_t)(crop->y + v / times) * (size_t)row->width +
                                     (size_t)(crop->x + u / times)));
    put_frame(s, x, y, width, height);
}

static spin_status make_sheet(const struct spin_compare *c, const struct spin_compare_row *row,
                              struct sheet *s)
{
    const uint8_t *truth = row->picture[0];

    s->width = (c->n + 1) * row->width + c->n * GAP;
    s->height = 2 * row->height + GAP;
    SPIN_TRY(spin_alloc((size_t)s->width * (size_t)s->height, 3, (void **)&s->rgb));
    memset(s->rgb, 255, 3 * (size_t)s->width * (size_t)s->height);
    for (int k = 0; k <= c->n; k++) {
        int x0 = k * (row->width + GAP);

        put_picture(s, x0, row, row->picture[k]);
        for (int v = 0; v < row->height && k > 0; v++)
            for (int u = 0; u < row->width; u++) {
                size_t at = 3 * ((size_t)v * (size_t)row->width + (size_t)u);
                uint8_t rgb[3];

                for (size_t i = 0; i < 3; i++) {
                    int d = GAIN * abs(row->picture[k][at + i] - truth[at + i]);

                    rgb[i] = (uint8_t)(d > 255 ? 255 : d);
                }
                put_pixel(s, x0 + u, row->height + GAP + v, rgb);
            }
    }
    return SPIN_OK;
}

/* Draws a sheet into *s, and sets *text to its PNG in base64. The caller frees *text and s->rgb. */
static spin_status sheet_text(const struct spin_compare *c, const struct spin_compare_row *row,
                              char **text, struct sheet *s)
{
    SPIN_FREED unsigned char *bytes = NULL;
    size_t n, n_text;
    FILE *out;

    *text = NULL;
    *s = (struct sheet){0};
    SPIN_TRY(make_sheet(c, row, s));
    SPIN_TRY(spin_image_encode(s->width, s->height, s->rgb, &bytes, &n));
    out = spin_text_open(text, &n_text);
    if (out)
        spin_text_base64(out, bytes, n);
    if (!out || fclose(out) != 0)
        return spin_fail(SPIN_E_MEMORY, "out of memory for an image of the comparison");
    return SPIN_OK;
}

/* ---- Curves ---------------------------------------------------------------------------------- */

/* Draws a chart of the measure `key` over the frames, with one line per run. If `file` is true,
 * writes a complete SVG file, otherwise an element for an HTML page. */
static spin_status draw_curves(const struct spin_compare *c, const char *key, const char *title,
                               const char *unit, bool file, FILE *to)
{
    struct spin_svg_chart_line line[SPIN_SVG_CHART_LINES];
    struct spin_svg_chart chart = {
        .title = title, .x_name = "frame", .y_name = unit, .line = line, .whole = true};
    double *next;
    SPIN_FREED double *values = NULL;
    size_t all = 0;

    for (int i = 0; i < c->n; i++)
        all += 2 * spin_json_length(spin_json_get(spin_json_at(c->runs, (size_t)i), "frames"));
    SPIN_TRY(spin_alloc(all + 1, sizeof *values, (void **)&values));
    next = values;
    for (int i = 0; i < c->n && i < SPIN_SVG_CHART_LINES; i++) {
        const spin_json *run = spin_json_at(c->runs, (size_t)i),
                        *frames = spin_json_get(run, "frames");
        size_t n = spin_json_length(frames);

        line[chart.n_lines++] = (struct spin_svg_chart_line){
            spin_json_string(spin_json_get(run, "name")), next, next + n, n, i, false};
        for (size_t f = 0; f < n; f++) {
            next[f] = next[n + f] = NAN;
            spin_json_number(spin_json_get(spin_json_at(frames, f), "frame"), &next[f]);
            spin_json_number(spin_json_get(spin_json_at(frames, f), key), &next[n + f]);
        }
        next += 2 * n;
    }
    if (file)
        spin_svg_chart_file(to, &chart);
    else
        spin_svg_chart_write(to, &chart);
    return SPIN_OK;
}

static spin_status add_curves(const struct spin_compare *c, spin_json *page)
{
    SPIN_FREED char *text = NULL;
    size_t n;
    FILE *out = spin_text_open(&text, &n);
    spin_status status =
        out ? SPIN_OK : spin_fail(SPIN_E_MEMORY, "out of memory for the curves of the comparison");

    if (status == SPIN_OK)
        status = draw_curves(c, "psnr", "PSNR over the frames", "PSNR, dB", false, out);
    if (status == SPIN_OK)
        status = draw_curves(c, "ssim", "SSIM over the frames", "SSIM", false, out);
    if (out && fclose(out) != 0)
        status = spin_fail(SPIN_E_MEMORY, "out of memory for the curves of the comparison");
    spin_json_set_string(page, "curves", text);
    return status;
}

/* ---- Page and figures ------------------------------------------------------------------------ */

static spin_status fill_page(const struct spin_compare *c, spin_json *page)
{
    spin_json *rows = spin_json_array();

    json_object_set(page, "runs", c->runs);
    spin_json_set_string(page, "version", SPIN_VERSION);
    spin_json_set_integer(page, "columns", c->n + 1);
    spin_json_set_integer(page, "gain", GAIN);
    spin_json_set(page, "rows", rows);
    SPIN_TRY(add_curves(c, page));
    for (size_t i = 0; i < c->n_rows; i++) {
        spin_json *row = spin_json_object();
        struct sheet s;
        char *text;
        spin_status status = sheet_text(c, &c->row[i], &text, &s);

        spin_json_push(rows, row);
        spin_json_set_integer(row, "frame", c->row[i].frame);
        spin_json_set_integer(row, "camera", c->row[i].camera);
        spin_json_set_string(row, "image", text);
        free(text);
        free(s.rgb);
        SPIN_TRY(status);
    }
    return SPIN_OK;
}

spin_status spin_compare_page(const struct spin_compare *c, const char *path, bool force)
{
    spin_json *page = spin_json_object();
    struct spin_out out;
    spin_status status = fill_page(c, page);

    if (status == SPIN_OK)
        status = spin_out_open(path, force, &out);
    if (status == SPIN_OK) {
        spin_template_write(out.file, spin_compare_html, page, true);
        status = spin_out_commit(&out);
    }
    spin_json_free(page);
    return spin_fail_context(status, "cannot write the report '%s'", path);
}

/* Opens a file in the folder for writing. */
static spin_status open_figure(struct spin_output_folder *folder, const char *name,
                               struct spin_out *out)
{
    SPIN_FREED char *path = NULL;

    SPIN_TRY(spin_path_join(folder->path, name, &path));
    return spin_out_open(path, true, out);
}

/* Writes an SVG with the sheet and, above its images, the names of the runs. `picture` is the PNG
 * of the sheet in base64. */
static void write_svg(const struct spin_compare *c, const struct spin_compare_row *row,
                      const struct sheet *s, const char *picture, FILE *to)
{
    fprintf(to,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %d %d\" "
            "font-family=\"sans-serif\" font-size=\"16\">\n",
            s->width, s->height + LABEL);
    for (int k = 0; k <= c->n; k++) {
        fprintf(to, "<text x=\"%d\" y=\"17\" text-anchor=\"middle\">",
                k * (row->width + GAP) + row->width / 2);
        spin_text_html(
            to, k ? spin_json_string(spin_json_get(spin_json_at(c->runs, (size_t)k - 1), "name"))
                  : "ground truth");
        fprintf(to, "</text>\n");
    }
    fprintf(to,
            "<image y=\"%d\" width=\"%d\" height=\"%d\" href=\"data:image/png;base64,%s\"/>\n"
            "</svg>\n",
            LABEL, s->width, s->height, picture);
}

static spin_status write_row(const struct spin_compare *c, const struct spin_compare_row *row,
                             struct spin_output_folder *folder)
{
    struct spin_out out;
    struct sheet s;
    char name[96];
    SPIN_FREED char *text = NULL, *path = NULL;
    spin_status status;

    SPIN_TRY_OUT(sheet_text(c, row, &text, &s));
    snprintf(name, sizeof name, "camera_%02d_frame_%05d.png", row->camera, row->frame);
    SPIN_TRY_OUT(spin_path_join(folder->path, name, &path));
    SPIN_TRY_OUT(spin_image_write(path, s.width, s.height, s.rgb, false));
    spin_output_folder_add(folder, name, row->frame);
    snprintf(name, sizeof name, "camera_%02d_frame_%05d.svg", row->camera, row->frame);
    SPIN_TRY_OUT(open_figure(folder, name, &out));
    write_svg(c, row, &s, text, out.file);
    status = spin_out_commit(&out);
    spin_output_folder_add(folder, name, row->frame);
out:
    free(s.rgb);
    return status;
}

static spin_status write_charts(const struct spin_compare *c, struct spin_output_folder *folder)
{
    static const char *const charts[][4] = {
        {"psnr.svg", "psnr", "PSNR over the frames", "PSNR, dB"},
        {"ssim.svg", "ssim", "SSIM over the frames", "SSIM"}};
    struct spin_out out;
    spin_status status;

    for (int i = 0; i < 2; i++) {
        SPIN_TRY(open_figure(folder, charts[i][0], &out));
        status = draw_curves(c, charts[i][1], charts[i][2], charts[i][3], true, out.file);
        if (status != SPIN_OK)
            spin_out_abandon(&out);
        SPIN_TRY(status != SPIN_OK ? status : spin_out_commit(&out));
        spin_output_folder_mark(folder, charts[i][0]);
    }
    return SPIN_OK;
}

spin_status spin_compare_figures(const struct spin_compare *c, const char *path, bool force)
{
    SPIN_LEAVES(spin_output_folder_abandon) struct spin_output_folder folder = {0};

    SPIN_TRY(spin_output_folder_begin(path, force, ".svg", &folder));
    SPIN_TRY(write_charts(c, &folder));
    for (size_t i = 0; i < c->n_rows; i++)
        SPIN_TRY(write_row(c, &c->row[i], &folder));
    SPIN_TRY(spin_output_folder_list(&folder, "figures", false));
    spin_output_folder_remove_former(&folder);
    return SPIN_OK;
}
