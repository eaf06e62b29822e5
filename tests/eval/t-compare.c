/* The comparison of runs: which views it shows, every pixel of its sheets, and its charts.
 * K: eval report compare */
#include "eval/report/compare.h"
#include "eval/report/svg_chart.h"
#include "io/image.h"
#include "scene/image_cache.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { GAP = 4, GAIN = 4, RUNS = 2, WIDTH = 32, HEIGHT = 22 };

static const float black[3];
static const char *folder;
static spin_json *runs;

static char *whole_file(const char *name)
{
    char path[600], *text = calloc(1, 1 << 20);
    FILE *f;

    snprintf(path, sizeof path, "%s/%s", folder, name);
    f = fopen(path, "rb");
    if (!f || !text || fread(text, 1, (1 << 20) - 1, f) == 0 || fclose(f) != 0)
        exit(1);
    return text;
}

/* ---- Charts ---------------------------------------------------------------------------------- */

/* Returns what a function writes about a chart, until the next call. */
static const char *text_of(void (*write)(FILE *, const struct spin_svg_chart *),
                           const struct spin_svg_chart *chart)
{
    static char *text;
    size_t n = 0;
    FILE *to;

    free(text);
    to = open_memstream(&text, &n);
    write(to, chart);
    fclose(to);
    return text;
}

#define GRID(y, at, value)                                                                         \
    "<line class=\"grid\" x1=\"56\" x2=\"694\" y1=\"" y "\" y2=\"" y "\"/><text x=\"48\" y=\"" at  \
    "\" text-anchor=\"end\">" value "</text>\n"
#define TICK(x, value)                                                                             \
    "<line class=\"tick\" x1=\"" x "\" x2=\"" x "\" y1=\"218\" y2=\"222\"/><text x=\"" x           \
    "\" y=\"236\" text-anchor=\"middle\">" value "</text>\n"
#define NAMES(x, y)                                                                                \
    "<text x=\"375\" y=\"254\" text-anchor=\"middle\">" x                                          \
    "</text><text class=\"upright\" x=\"14\" "                                                     \
    "y=\"114\" text-anchor=\"middle\" transform=\"rotate(-90 14 114)\">" y "</text>\n"
#define DOT(style, x, y, label)                                                                    \
    "<circle class=\"dot line-" style "\" cx=\"" x "\" cy=\"" y "\" r=\"3\"><title>" label         \
    "</title></circle>\n"

/* One line with a gap, and one with a single value. y spans 20.5 to 23.9, so that ticks are one
 * apart, from 20 to 24; x spans -1 to 2. */
static void check_charts(void)
{
    static const double x[] = {-1, 0, 0.5, 1, 2}, y[] = {20.5, 22, NAN, 23, 23.9}, one[] = {21};
    struct spin_svg_chart_line line[] = {{"a<b", x, y, 5, 1, true}, {"c", x + 1, one, 1, 0, false}};
    struct spin_svg_chart chart = {"title", "frame", "dB", line, 2, true};
    static const char axes[] =
        GRID("218.0", "222.0", "20") GRID("166.0", "170.0", "21") GRID("114.0", "118.0", "22")
            GRID("62.0", "66.0", "23") GRID("10.0", "14.0", "24") TICK("56.0", "-1")
                TICK("268.7", "0") TICK("481.3", "1") TICK("694.0", "2") NAMES("frame", "dB");
    static const char dots[] = "M56.0 192.0L268.7 114.0M481.3 62.0L694.0 15.2\"/>\n" DOT(
        "1", "56.0", "192.0", "a&lt;b: -1, 20.5") DOT("1", "268.7", "114.0", "a&lt;b: 0, 22")
        DOT("1", "481.3", "62.0", "a&lt;b: 1, 23") DOT(
            "1", "694.0", "15.2",
            "a&lt;b: 2, 23.9") "<path class=\"line line-0\" d=\"M268.7 166.0\"/>\n" DOT("0",
                                                                                        "268.7",
                                                                                        "166.0",
                                                                                        "c: 0, 21");
    static const char halves[] = TICK("162.3", "-0.5") TICK("268.7", "0") TICK("375.0", "0.5");
    char want[8000];
    const char *text;

    near(spin_svg_chart_step(10, 5), 2, 1e-12, "ten in five pieces");
    near(spin_svg_chart_step(0.9, 5), 0.2, 1e-12, "parts of one");
    near(spin_svg_chart_step(40000, 9), 5000, 1e-9, "thousands");
    snprintf(want, sizeof want,
             "<figure><figcaption>title</figcaption>\n<p class=\"legend\">"
             "<span><svg width=\"26\" height=\"10\"><path class=\"line line-1 dashed\" d=\"M1 5L25 "
             "5\"/></svg> a&lt;b</span> <span><svg width=\"26\" height=\"10\"><path class=\"line "
             "line-0\" d=\"M1 5L25 5\"/></svg> c</span> </p>\n<svg class=\"chart\" viewBox=\"0 0 "
             "720 260\" role=\"img\" aria-label=\"title\">\n%s<path class=\"line line-1 dashed\" "
             "d=\"%s</svg></figure>\n",
             axes, dots);
    is_text(text_of(spin_svg_chart_write, &chart), want, "a chart within a page");
    line[0].dashed = false;
    snprintf(
        want, sizeof want,
        "</style>\n<rect y=\"-30\" width=\"100%%\" height=\"100%%\" fill=\"#fff\"/>\n"
        "<path class=\"line line-1\" d=\"M56 -14h24\"/><text x=\"86\" y=\"-10\">a&lt;b</text>\n"
        "<path class=\"line line-0\" d=\"M375 -14h24\"/><text x=\"405\" y=\"-10\">c</text>\n"
        "%s<path class=\"line line-1\" d=\"%s</svg>\n",
        axes, dots);
    text = text_of(spin_svg_chart_file, &chart);
    ok(strstr(text, " viewBox=\"0 -30 720 290\" ") && strstr(text, "}.line-7{stroke:#8a94a3}"),
       "a file with colours");
    is_text(strstr(text, "</style>"), want, "and the same chart");
    chart.whole = false;
    ok(strstr(text_of(spin_svg_chart_write, &chart), halves) != NULL, "ticks between integers");
    chart.n_lines = 1;
    chart.whole = true;
    line[0] = (struct spin_svg_chart_line){"a", x, (double[]){-3, -3, -3, -3, -3}, 5, 0, false};
    text = text_of(spin_svg_chart_write, &chart);
    ok(strstr(text, GRID("218.0", "222.0", "-3.6") GRID("183.3", "187.3", "-3.4")) &&
           strstr(text, GRID("10.0", "14.0", "-2.4") TICK("56.0", "-1")) && !strstr(text, "legend"),
       "one value is in the middle of an axis of round numbers; one line has no legend");
    line[0].n = 1;
    text = text_of(spin_svg_chart_file, &chart);
    ok(strstr(text, GRID("218.0", "222.0", "0") GRID("176.4", "180.4", "0.2")) &&
           strstr(text, TICK("56.0", "0") TICK("694.0", "1")),
       "a file without a range has axes from 0 to 1");
    ok(!*text_of(spin_svg_chart_write, &chart), "a page has no such chart");
    line[0] = (struct spin_svg_chart_line){"a", y + 2, y, 1, 0, false};
    ok(!*text_of(spin_svg_chart_write, &chart), "nor one without finite points");
}

/* ---- Sheets ---------------------------------------------------------------------------------- */

static uint8_t picture[1 + RUNS][HEIGHT][WIDTH][3];
static uint8_t *rows[1 + RUNS] = {&picture[0][0][0][0], &picture[1][0][0][0], &picture[2][0][0][0]};

/* True on the frame one pixel outside of a rectangle. */
static bool on_frame(int u, int v, int x, int y, int width, int height)
{
    bool within = u >= x && u < x + width && v >= y && v < y + height;

    return !within && u >= x - 1 && u <= x + width && v >= y - 1 && v <= y + height;
}

/* The expected value of a pixel at u, v of image k: the enlarged crop covers the frame of the crop,
 * which covers the image. x, y: corner of the enlarged crop; times: 0 if there is none. */
static const uint8_t *want_pixel(int k, int u, int v, const struct spin_crop *crop, int x, int y,
                                 int times)
{
    static const uint8_t white[3] = {255, 255, 255};
    int width = times * crop->side_x, height = times * crop->side_y;

    if (times > 0 && on_frame(u, v, x, y, width, height))
        return white;
    if (times > 0 && u >= x && u < x + width && v >= y && v < y + height)
        return picture[k][crop->y + (v - y) / times][crop->x + (u - x) / times];
    if (on_frame(u, v, crop->x, crop->y, crop->side_x, crop->side_y))
        return white;
    return picture[k][v][u];
}

/* x, y, times: as above. Frames of the ground truth and the first run may reach one pixel into the
 * gap, which is white. */
static void check_sheet(struct spin_crop crop, int x, int y, int times, const char *what)
{
    struct spin_compare c = {.runs = runs, .n = RUNS, .n_rows = 1};
    char path[700];
    int width = 0, height = 0, wrong = 0;
    uint8_t *sheet = NULL;

    c.row[0] = (struct spin_compare_row){crop, WIDTH, HEIGHT, 12, 3, rows, 1 + RUNS};
    snprintf(path, sizeof path, "%s/sheets", folder);
    if (spin_compare_figures(&c, path, true) != SPIN_OK)
        exit(1);
    snprintf(path, sizeof path, "%s/sheets/camera_03_frame_00012.png", folder);
    if (spin_image_read(path, black, &width, &height, &sheet) != SPIN_OK)
        exit(1);
    ok(width == 3 * WIDTH + 2 * GAP && height == 2 * HEIGHT + GAP, "%s: %d x %d", what, width,
       height);
    for (int v = 0; v < height; v++)
        for (int u = 0; u < width; u++) {
            int k = u / (WIDTH + GAP), left = u % (WIDTH + GAP);
            const uint8_t *got = sheet + 3 * (v * width + u);
            int down = v - HEIGHT - GAP;

            for (int i = 0; i < 3; i++) {
                int want = 255;

                if (left < WIDTH && v < HEIGHT)
                    want = want_pixel(k, left, v, &crop, x, y, times)[i];
                else if (left < WIDTH && down >= 0 && k > 0)
                    want = GAIN * abs(picture[k][down][left][i] - picture[0][down][left][i]);
                wrong += got[i] != (want > 255 ? 255 : want);
            }
        }
    ok(wrong == 0, "%s: %d values are wrong", what, wrong);
    free(sheet);
}

static void check_sheets(void)
{
    for (int k = 0; k <= RUNS; k++)
        for (int v = 0; v < HEIGHT; v++)
            for (int u = 0; u < WIDTH; u++)
                for (int i = 0; i < 3; i++)
                    picture[k][v][u][i] =
                        (uint8_t)(7 * u + 3 * v + 50 * i + (k ? (u * v + 29 * k) % 70 : 0));
    check_sheet((struct spin_crop){.x = 2, .y = 3, .side_x = 4, .side_y = 5}, 18, 5, 3,
                "enlarged three times, on the right");
    check_sheet((struct spin_crop){.x = 20, .y = 1, .side_x = 8, .side_y = 6}, 2, 8, 2,
                "twice, on the left");
    check_sheet((struct spin_crop){.x = 12, .y = 1, .side_x = 8, .side_y = 5}, 14, 10, 2,
                "in the middle, on the right");
    check_sheet((struct spin_crop){.x = 13, .y = 1, .side_x = 8, .side_y = 5}, 2, 10, 2,
                "one pixel further, on the left");
    check_sheet((struct spin_crop){.x = 1, .y = 5, .side_x = 15, .side_y = 10}, 0, 0, 2,
                "as large as it can be");
    check_sheet((struct spin_crop){.x = 1, .y = 5, .side_x = 16, .side_y = 9}, 0, 0, 0,
                "too wide to be enlarged");
    check_sheet((struct spin_crop){.x = 1, .y = 5, .side_x = 9, .side_y = 11}, 0, 0, 0,
                "too high to be enlarged");
}

/* ---- Choice of rows, and figures ------------------------------------------------------------- */

/* Adds an image of one colour. */
static void add_view(struct spin_views *views, int camera, int width, int height, float value)
{
    static float image[3 * WIDTH * HEIGHT];
    struct spin_view v = {.camera_id = camera};
    char path[600];

    v.camera = (struct spin_camera){.width = width,
                                    .height = height,
                                    .fx = 20,
                                    .fy = 20,
                                    .w2c = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
    for (int i = 0; i < 3 * width * height; i++)
        image[i] = value;
    snprintf(path, sizeof path, "%s/%d.png", folder, camera);
    v.path = path;
    if (spin_image_save(path, width, height, image, false) != SPIN_OK ||
        spin_views_add(views, &v) != SPIN_OK)
        exit(1);
}

static bool has_row(const struct spin_compare *c, int i, int camera, int width, int height,
                    struct spin_crop crop)
{
    const struct spin_compare_row *row = &c->row[i];

    return row->camera == camera && row->frame == 7 && row->width == width &&
           row->height == height && row->crop.pair == crop.pair && row->crop.x == crop.x &&
           row->crop.y == crop.y && row->crop.side_x == crop.side_x &&
           row->crop.side_y == crop.side_y;
}

static bool is_colour(const uint8_t *image, int n, int r, int g, int b)
{
    for (int i = 0; i < n; i++)
        if (image[3 * i] != r || image[3 * i + 1] != g || image[3 * i + 2] != b)
            return false;
    return true;
}

static void check_curves(const struct spin_compare *c)
{
    static const double frame[] = {7, 9, 10}, psnr[] = {20, NAN, 22.5}, ssim[] = {0.5, 0.75, 1},
                        other[] = {8, 11}, lower[] = {18, 19}, less[] = {0.25, 0.375};
    struct spin_svg_chart_line line[] = {{"a<b", frame, psnr, 3, 0, false},
                                         {"c", other, lower, 2, 1, false}};
    struct spin_svg_chart chart = {"", "frame", "PSNR, dB", line, 2, true};
    char path[700], *list, *svg, want[400];
    size_t at;

    snprintf(path, sizeof path, "%s/figures", folder);
    ok(spin_compare_figures(c, path, false) == SPIN_OK, "figures");
    for (int i = 0; i < 2; i++) {
        char *text = whole_file(i ? "figures/ssim.svg" : "figures/psnr.svg");

        is_text(text, text_of(spin_svg_chart_file, &chart),
                i ? "SSIM" : "PSNR, without one of a frame");
        line[0].y = ssim;
        line[1].y = less;
        chart.y_name = "SSIM";
        free(text);
    }
    svg = whole_file("figures/camera_05_frame_00007.svg");
    at = (size_t)snprintf(
        want, sizeof want,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 65 48\" "
        "font-family=\"sans-serif\" "
        "font-size=\"16\">\n"
        "<text x=\"9\" y=\"17\" text-anchor=\"middle\">ground truth</text>\n"
        "<text x=\"32\" y=\"17\" text-anchor=\"middle\">a&lt;b</text>\n"
        "<text x=\"55\" y=\"17\" text-anchor=\"middle\">c</text>\n"
        "<image y=\"24\" width=\"65\" height=\"24\" href=\"data:image/png;base64,");
    ok(strncmp(svg, want, at) == 0 && strstr(svg, "\"/>\n</svg>\n"), "labels above the sheet");
    list = whole_file("figures/sequence.json");
    ok(check_report(list, "frames.0.frame") == 7 && strstr(list, "camera_05_frame_00007.png") &&
           strstr(list, "camera_05_frame_00007.svg") && strstr(list, "camera_02_frame_00007.png"),
       "sequence.json lists all");
    free(list);
    free(svg);
}

static void check_rows(void)
{
    struct spin_device *d = check_device(1);
    int row_of[1] = {0}, frame_of[1] = {0};
    struct spin_clip clip = {.n_frames = 1, .has_views = true};
    struct spin_pair pair[2] = {{0, 0}, {0, 1}};
    struct spin_eval_view view[2] = {{.frame = 7, .camera = 2, .q.psnr = 30},
                                     {.frame = 7, .camera = 5, .q.psnr = 20}};
    struct spin_eval_report report = {.view = view, .n_views = 2};
    struct spin_frame_info frame = {.n = 0};
    struct spin_bundle bundle = {.meta.frame = &frame};
    struct spin_splats none = {0};
    struct spin_player player;
    struct spin_compare c = {0};
    struct spin_image_cache pixels;
    float background[3] = {1.5f, -1, 100.4f / 255};

    clip.dataset_frame = row_of;
    clip.frame = frame_of;
    add_view(&clip.views, 2, 31, 22, 0.2f);
    add_view(&clip.views, 5, 19, 10, 0.6f);
    spin_player_open_reader(&player, d, NULL, NULL);
    c.runs = runs; /* spin_compare_free() releases it */
    if (spin_image_cache_open(&clip.views, 0, black, &pixels) != SPIN_OK ||
        spin_player_show_splats(&player, &none) != SPIN_OK)
        exit(1);
    player.bundle = &bundle;
    player.now_frame = 0;
    ok(spin_compare_draw(&c, &clip, &pixels, pair, &report, &player, background) == SPIN_OK &&
           c.n == 1 && c.n_rows == 2,
       "two views of a clip without motion");
    ok(has_row(&c, 0, 5, 19, 10,
               (struct spin_crop){.pair = 1, .x = 6, .y = 3, .side_x = 7, .side_y = 4}) &&
           has_row(&c, 1, 2, 31, 22,
                   (struct spin_crop){.pair = 0, .x = 10, .y = 7, .side_x = 11, .side_y = 8}),
       "the middle of each, the worst first");
    ok(is_colour(c.row[0].picture[0], 190, 153, 153, 153) &&
           is_colour(c.row[0].picture[1], 190, 255, 0, 100) &&
           is_colour(c.row[1].picture[0], 682, 51, 51, 51) &&
           is_colour(c.row[1].picture[1], 682, 255, 0, 100),
       "the ground truth, and the render limited to 0..255");
    background[1] = 1;
    ok(spin_compare_draw(&c, &clip, &pixels, pair, &report, &player, background) == SPIN_OK &&
           c.n == 2 && is_colour(c.row[0].picture[2], 190, 255, 255, 100) &&
           is_colour(c.row[1].picture[2], 682, 255, 255, 100),
       "a second run");
    check_curves(&c);
    for (int k = 0; k < 3; k++) {
        view[1].camera = k == 0 ? 6 : 5;
        view[0].frame = k == 1 ? 8 : 7;
        report.n_views = k == 2 ? 1 : 2;
        ok(spin_compare_draw(&c, &clip, &pixels, pair, &report, &player, background) == SPIN_OK &&
               c.n == 2,
           "not a run with %s",
           k == 0   ? "another camera"
           : k == 1 ? "another frame"
                    : "fewer views");
    }
    report.n_views = 2;
    clip.views.view[0].camera.width = 30;
    ok(spin_compare_draw(&c, &clip, &pixels, pair, &report, &player, background) == SPIN_E_USAGE &&
           strstr(spin_last_error(), "camera 2 differ in size"),
       "%s", spin_last_error());
    spin_compare_free(&c);
    spin_player_close(&player);
    spin_image_cache_close(&pixels);
    spin_views_free(&clip.views);
    check_device_free(d);
}

TAP_MAIN
{
    static const char text[] =
        "[{\"name\": \"a<b\", \"frames\": [{\"frame\": 7, \"psnr\": 20, \"ssim\": 0.5},"
        "{\"frame\": 9, \"psnr\": null, \"ssim\": 0.75}, {\"frame\": 10, \"psnr\": 22.5, \"ssim\": "
        "1}]}, {\"name\": \"c\", \"frames\": [{\"frame\": 8, \"psnr\": 18, \"ssim\": 0.25},"
        "{\"frame\": 11, \"psnr\": 19, \"ssim\": 0.375}]}]";

    folder = check_folder();
    if (spin_json_parse("runs", text, strlen(text), &runs) != SPIN_OK)
        exit(1);
    check_charts();
    check_sheets();
    check_rows();
}
