/* spin-eval: how good the splats of a bundle look from cameras that are known. */
#include "cmd/args.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "spin_run.h"
#include "cmd/print.h"

static struct spin_eval_options options = {.image_scale = 1, .device = "auto"};
static struct spin_args_list test_cameras;
static const char *split = "test";
static const char *dynamic = "auto";

static const struct spin_args_row rows[] = {
    SPIN_ARG_HEADING("What to measure"),
    SPIN_ARG("source", 0, NULL, FLAG, options.source,
             "measure the imported attributes instead of the retrained ones"),
    SPIN_ARG("split", 0, "test|train|all", CHOICE, split, "the cameras (test)"),
    SPIN_ARG("test-cams", 0, "LIST", INTS, test_cameras,
             "camera numbers held out (the data set's own)", .min = 0, .max = 1e9),
    SPIN_ARG("range", 0, "A:B[:STEP]", RANGE, options.range, "frame numbers A to B-1"),
    SPIN_ARG("scale", 0, "S", DOUBLE, options.image_scale, "image scale, 0.5 halves both sides (1)",
             .min = 0.01, .max = 1),
    SPIN_ARG("background", 0, "COLOUR", COLOUR, options.background,
             "black, white or R,G,B with each in 0..1 (black)", .min = 0, .max = 1),
    SPIN_ARG("dynamic", 0, "auto|masks|images|off", CHOICE, dynamic,
             "where the dynamic regions are: the data set's masks, or what changes in its images "
             "(auto)"),
    SPIN_ARG("lpips", 0, "DIR", STRING, options.lpips,
             "measure LPIPS with the weights in this folder, see the manual"),
    SPIN_ARG("lpips-backbone", 0, "FILE", STRING, options.lpips_backbone,
             "the network of LPIPS, as torchvision publishes it"),
    SPIN_ARG("lpips-lin", 0, "FILE", STRING, options.lpips_lin,
             "its linear heads, as the lpips package has them"),
    SPIN_ARG("images", 0, "DIR", STRING, options.images,
             "write one PNG per view: ground truth | source | render"),
    SPIN_ARG("report", 0, "FILE.html", STRING, options.report,
             "write a page with curves, tables and pictures"),
    SPIN_ARG("log", 0, "FILE", STRING, options.log,
             "for the report: what spin-retrain --log wrote"),
    SPIN_ARG_HEADING("Data set"),
    SPIN_ARG_DATA_ROWS(options),
    SPIN_ARG_HEADING("Machine"),
    SPIN_ARG_DEVICE_ROW(options),
    SPIN_ARG_END,
};

static const char *const usage[] = {
    "spin-eval IN.spin [--data DIR] [--split test|train|all] [--source] [options]",
    NULL,
};

static const struct spin_args_command command = {
    .name = "spin-eval",
    .summary = "PSNR, SSIM and LPIPS of a bundle against its data set",
    .usage = usage,
    .rows = rows,
};

static enum spin_split split_of(const char *name)
{
    if (!strcmp(name, "train"))
        return SPIN_SPLIT_TRAIN;
    return !strcmp(name, "all") ? SPIN_SPLIT_ALL : SPIN_SPLIT_TEST;
}

/* ---- Reports --------------------------------------------------------------------------------- */

static const char *const dynamic_names[] = {"auto", "masks", "images", "off"};
static const char *const lpips_names[] = {"lpips_vgg", "lpips_alex"};

/* Ids of the cameras, each once, in order of appearance in the first frame; n of them. */
static int *list_cameras(const struct spin_eval_report *r, size_t *n)
{
    int *list = calloc(r->n_views + 1, sizeof *list);

    *n = 0;
    for (size_t i = 0; list && i < r->n_views; i++) {
        size_t k = 0;

        while (k < *n && list[k] != r->view[i].camera)
            k++;
        if (k == *n)
            list[(*n)++] = r->view[i].camera;
    }
    return list;
}

/* Where the next frame's views begin. A frame's views stand together. */
static size_t next_frame(const struct spin_eval_report *r, size_t i)
{
    int frame = r->view[i].frame;

    while (i < r->n_views && r->view[i].frame == frame)
        i++;
    return i;
}

static void print_quality(const struct spin_eval_report *r, const struct spin_quality *q)
{
    spin_print_number("psnr", q->valid ? q->psnr : NAN);
    spin_print_number("ssim", q->valid ? q->ssim : NAN);
    spin_print_number("psnr_channel_mean", q->valid ? q->psnr_channel_mean : NAN);
    spin_print_number("psnr_colour_fitted", q->valid ? q->psnr_colour_fitted : NAN);
    if (r->dynamic != SPIN_DYNAMIC_OFF) {
        spin_print_number("psnr_dynamic", q->psnr_dynamic);
        spin_print_number("psnr_static", q->psnr_static);
        spin_print_number("dynamic", q->dynamic);
    }
    for (int i = 0; i < SPIN_N_LPIPS; i++)
        if (!isnan(r->mean.lpips[i]))
            spin_print_number(lpips_names[i], q->lpips[i]);
}

/* Bytes that the attributes which were measured need. */
static uint64_t bytes_needed(const struct spin_eval_report *r, const struct spin_bundle_bytes *s)
{
    if (r->trained)
        return s->positions + s->tracks + s->table + s->heads;
    return r->refined ? s->refined : s->source;
}

static void print_bytes(const char *key, const struct spin_eval_report *r,
                        const struct spin_bundle_bytes *s)
{
    spin_print_open(key, '{');
    spin_print_integer("file", (long long)s->file);
    spin_print_integer("source", (long long)s->source);
    spin_print_integer("refined", (long long)s->refined);
    spin_print_integer("positions", (long long)s->positions);
    spin_print_integer("tracks", (long long)s->tracks);
    spin_print_integer("table", (long long)s->table);
    spin_print_integer("heads", (long long)s->heads);
    spin_print_integer("measured", (long long)bytes_needed(r, s));
    spin_print_number("measured_per_frame", (double)bytes_needed(r, s) / r->n_bundle_frames);
    spin_print_close('}');
}

static const char *attributes(const struct spin_eval_report *r)
{
    return r->trained ? "retrained" : r->refined ? "frames" : "source";
}

static void report_json(const struct spin_eval_report *r)
{
    size_t n_cameras;
    int *camera = list_cameras(r, &n_cameras);

    spin_print_open(NULL, '{');
    print_quality(r, &r->mean);
    spin_print_string("attributes", attributes(r));
    spin_print_string("split", split);
    spin_print_string("dynamic_from", dynamic_names[r->dynamic]);
    spin_print_number("fps", 1 / (r->seconds_decode + r->seconds_draw));
    spin_print_number("fps_draw", 1 / r->seconds_draw);
    spin_print_number("seconds_decode", r->seconds_decode);
    spin_print_number("seconds_draw", r->seconds_draw);
    spin_print_integer("left_out", (long long)r->left_out);
    print_bytes("storage", r, &r->storage);
    print_bytes("storage_unpacked", r, &r->unpacked);
    spin_print_open("frames", '[');
    for (size_t i = 0; i < r->n_views; i = next_frame(r, i)) {
        struct spin_quality q = spin_eval_mean(r, &r->view[i].frame, NULL);

        spin_print_open(NULL, '{');
        spin_print_integer("frame", r->view[i].frame);
        print_quality(r, &q);
        spin_print_close('}');
    }
    spin_print_close(']');
    spin_print_open("cameras", '[');
    for (size_t i = 0; i < n_cameras; i++) {
        struct spin_quality q = spin_eval_mean(r, NULL, &camera[i]);

        spin_print_open(NULL, '{');
        spin_print_integer("id", camera[i]);
        print_quality(r, &q);
        spin_print_close('}');
    }
    spin_print_close(']');
    spin_print_open("views", '[');
    for (size_t i = 0; i < r->n_views; i++) {
        spin_print_open(NULL, '{');
        spin_print_integer("frame", r->view[i].frame);
        spin_print_integer("camera", r->view[i].camera);
        print_quality(r, &r->view[i].q);
        spin_print_close('}');
    }
    spin_print_close(']');
    spin_print_close('}');
    free(camera);
}

/* A value in its column; a dash when it was not measured. */
static void print_cell(double value, int width, int digits)
{
    if (isnan(value))
        printf("  %*s", width, "-");
    else
        printf("  %*.*f", width, digits, value);
}

/* frame or camera NULL: "all". */
static void print_row(const struct spin_eval_report *r, const int *frame, const int *camera,
                      const struct spin_quality *q)
{
    const int *key[2] = {frame, camera};

    for (int i = 0; i < 2; i++)
        if (key[i])
            printf("%s%6d", i ? "  " : "", *key[i]);
        else
            printf("%s%6s", i ? "  " : "", "all");
    print_cell(q->psnr, 8, 3);
    print_cell(q->ssim, 7, 4);
    if (r->dynamic != SPIN_DYNAMIC_OFF)
        print_cell(q->psnr_dynamic, 8, 3);
    for (int i = 0; i < SPIN_N_LPIPS; i++)
        if (!isnan(r->mean.lpips[i]))
            print_cell(q->lpips[i], 10, 4);
}

static void print_head(const struct spin_eval_report *r)
{
    printf("%6s  %6s  %8s  %7s", "frame", "camera", "PSNR", "SSIM");
    if (r->dynamic != SPIN_DYNAMIC_OFF)
        printf("  %8s", "dynamic");
    for (int i = 0; i < SPIN_N_LPIPS; i++)
        if (!isnan(r->mean.lpips[i]))
            printf("  %10s", i == SPIN_LPIPS_VGG ? "LPIPS VGG" : "LPIPS Alex");
    printf("\n");
}

static void print_foot(const struct spin_eval_report *r)
{
    char needed[32], frame[32], file[32], unpacked[32];

    if (r->dynamic != SPIN_DYNAMIC_OFF)
        printf("dynamic  %.2f %% of the pixels, from %s: PSNR %.3f there, %.3f elsewhere\n",
               100 * r->mean.dynamic,
               r->dynamic == SPIN_DYNAMIC_MASKS ? "foreground masks" : "the images",
               r->mean.psnr_dynamic, r->mean.psnr_static);
    printf("speed    %.2f frames per second with decoding, %.2f without\n",
           1 / (r->seconds_decode + r->seconds_draw), 1 / r->seconds_draw);
    printf("storage  %s for these attributes, %s a frame; the file has %s, unpacked %s\n",
           spin_print_bytes((double)bytes_needed(r, &r->storage), needed),
           spin_print_bytes((double)bytes_needed(r, &r->storage) / r->n_bundle_frames, frame),
           spin_print_bytes((double)r->storage.file, file),
           spin_print_bytes((double)r->unpacked.file, unpacked));
}

/* A line a frame and one a camera, with -v a line a view as well; with -q only the mean. */
static void report_text(const struct spin_eval_report *r)
{
    size_t n_cameras;
    int *camera = list_cameras(r, &n_cameras);

    print_head(r);
    for (size_t i = 0; i < r->n_views;) {
        size_t next = next_frame(r, i), first = i;
        struct spin_quality q = spin_eval_mean(r, &r->view[first].frame, NULL);

        for (; spin_args.verbose && i < next; i++) {
            print_row(r, &r->view[i].frame, &r->view[i].camera, &r->view[i].q);
            printf("\n");
        }
        i = next;
        if (!spin_args.quiet) {
            print_row(r, &r->view[first].frame, NULL, &q);
            printf("\n");
        }
    }
    for (size_t i = 0; !spin_args.quiet && i < n_cameras; i++) {
        struct spin_quality q = spin_eval_mean(r, NULL, &camera[i]);

        print_row(r, NULL, &camera[i], &q);
        printf("\n");
    }
    print_row(r, NULL, NULL, &r->mean);
    printf("   %zu views, %s attributes\n", r->n_views, attributes(r));
    if (!spin_args.quiet)
        print_foot(r);
    free(camera);
}

static enum spin_dynamic_from dynamic_of(const char *name)
{
    for (int i = SPIN_DYNAMIC_AUTO; i < SPIN_DYNAMIC_OFF; i++)
        if (!strcmp(name, dynamic_names[i]))
            return (enum spin_dynamic_from)i;
    return SPIN_DYNAMIC_OFF;
}

int main(int argc, char **argv)
{
    struct spin_eval_report report = {0};
    int code;

    if (!spin_args_parse(&command, argc, argv, &code))
        return code;
    if (!spin_args.word)
        return spin_args_misuse(&command, "IN.spin is missing");
    options.input = spin_args.word;
    options.split = split_of(split);
    options.dynamic = dynamic_of(dynamic);
    options.test_cameras = test_cameras.ints;
    options.n_test_cameras = test_cameras.n;
    options.n_threads = spin_args.n_threads;
    options.force = spin_args.force;
    if (!spin_args_begin(&command, &code) ||
        !spin_args_ended(&command, spin_eval(&options, &report), &code))
        return code;
    if (spin_args.json)
        report_json(&report);
    else
        report_text(&report);
    spin_eval_report_free(&report);
    return spin_args_finish(&command, SPIN_EXIT_OK);
}
