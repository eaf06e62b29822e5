/* spin-eval: how good the splats of a bundle look from cameras that are known. */
#include "cmd/opt.h"

#include <math.h>
#include <string.h>

static struct spin_eval_options options = {.image_scale = 1, .device = "auto"};
static struct spin_opt_common common;
static struct spin_opt_ints test_cameras;
static const char *split = "test";

static const struct spin_opt_row rows[] = {
    SPIN_OPT_HEADING("What to measure"),
    SPIN_OPT("source", 0, NULL, "the imported attributes instead of the retrained ones",
             SPIN_OPT_FLAG, &options.source, 0, 0),
    SPIN_OPT("split", 0, "test|train|all", "which cameras (test)", SPIN_OPT_CHOICE, &split, 0, 0),
    SPIN_OPT("test-cams", 0, "LIST", "camera numbers held out (the data set's own)", SPIN_OPT_INTS,
             &test_cameras, 0, 1e9),
    SPIN_OPT("range", 0, "A:B[:STEP]", "frame numbers A to B-1", SPIN_OPT_RANGE, &options.range, 0,
             0),
    SPIN_OPT("scale", 0, "S", "image scale, 0.5 halves both sides (1)", SPIN_OPT_DOUBLE,
             &options.image_scale, 0.01, 1),
    SPIN_OPT("background", 0, "COLOUR", "black, white or R,G,B with each in 0..1 (black)",
             SPIN_OPT_COLOUR, options.background, 0, 0),
    SPIN_OPT("images", 0, "DIR", "write one PNG a view: ground truth | source | render",
             SPIN_OPT_STRING, &options.images, 0, 0),
    SPIN_OPT_HEADING("Data set"),
    SPIN_OPT("data", 0, "DIR", "the multi-view video (the one named in the bundle)",
             SPIN_OPT_STRING, &options.data, 0, 0),
    SPIN_OPT("data-from", 0, "NAME", "kind of that data set (detected)", SPIN_OPT_STRING,
             &options.data_from, 0, 0),
    SPIN_OPT("pair", 0, "auto|number|order", "how frames find their images (auto)", SPIN_OPT_CHOICE,
             &options.pair, 0, 0),
    SPIN_OPT_HEADING("Machine"),
    SPIN_OPT("device", 0, "auto|cpu|cuda", "what computes (auto)", SPIN_OPT_CHOICE, &options.device,
             0, 0),
    SPIN_OPT_COMMON_ROWS(common),
};

static const char *const usage[] = {
    "spin-eval IN.spin [--data DIR] [--split test|train|all] [--source] [options]",
    NULL,
};

static const struct spin_opt_command command = {
    .name = "spin-eval",
    .summary = "PSNR and SSIM of a bundle against its data set",
    .usage = usage,
    .rows = rows,
    .common = &common,
};

static enum spin_split split_of(const char *name)
{
    if (!strcmp(name, "train"))
        return SPIN_SPLIT_TRAIN;
    return !strcmp(name, "all") ? SPIN_SPLIT_ALL : SPIN_SPLIT_TEST;
}

/* The mean of the views of one frame, beginning at `first`; returns where the next frame begins. A
 * frame's views stand together. */
static size_t frame_mean(const struct spin_eval_report *r, size_t first,
                         struct spin_eval_view *mean)
{
    size_t i = first;

    *mean = (struct spin_eval_view){.frame = r->view[first].frame};
    for (; i < r->n_views && r->view[i].frame == mean->frame; i++) {
        mean->psnr += r->view[i].psnr;
        mean->ssim += r->view[i].ssim;
        mean->psnr_channel_mean += r->view[i].psnr_channel_mean;
    }
    mean->psnr /= (double)(i - first);
    mean->ssim /= (double)(i - first);
    mean->psnr_channel_mean /= (double)(i - first);
    return i;
}

static void print_measures(double psnr, double ssim, double psnr_channel_mean)
{
    spin_print_number("psnr", psnr);
    spin_print_number("ssim", ssim);
    spin_print_number("psnr_channel_mean", psnr_channel_mean);
}

static void report_json(const struct spin_eval_report *r)
{
    struct spin_eval_view mean;

    spin_print_open(NULL, '{');
    if (r->mean.valid) {
        print_measures(r->mean.psnr, r->mean.ssim, r->mean.psnr_channel_mean);
    } else {
        print_measures(NAN, NAN, NAN);
    }
    spin_print_string("attributes", r->network ? "retrained" : "source");
    spin_print_string("split", split);
    spin_print_number("seconds_per_view", r->seconds_render);
    spin_print_open("frames", '[');
    for (size_t i = 0; i < r->n_views;) {
        i = frame_mean(r, i, &mean);
        spin_print_open(NULL, '{');
        spin_print_integer("frame", mean.frame);
        print_measures(mean.psnr, mean.ssim, mean.psnr_channel_mean);
        spin_print_close('}');
    }
    spin_print_close(']');
    spin_print_open("views", '[');
    for (size_t i = 0; i < r->n_views; i++) {
        spin_print_open(NULL, '{');
        spin_print_integer("frame", r->view[i].frame);
        spin_print_integer("camera", r->view[i].camera);
        print_measures(r->view[i].psnr, r->view[i].ssim, r->view[i].psnr_channel_mean);
        spin_print_close('}');
    }
    spin_print_close(']');
    spin_print_close('}');
}

/* A line a frame, with -v a line a view as well. */
static void report_text(const struct spin_eval_report *r)
{
    struct spin_eval_view mean;

    printf("%6s  %6s  %8s  %7s\n", "frame", "camera", "PSNR", "SSIM");
    for (size_t i = 0; i < r->n_views;) {
        size_t next = frame_mean(r, i, &mean);

        for (; common.verbose && i < next; i++)
            printf("%6d  %6d  %8.3f  %7.4f\n", r->view[i].frame, r->view[i].camera, r->view[i].psnr,
                   r->view[i].ssim);
        i = next;
        if (!common.quiet)
            printf("%6d  %6s  %8.3f  %7.4f\n", mean.frame, "all", mean.psnr, mean.ssim);
    }
    printf("%6s  %6s  %8.3f  %7.4f   %zu views, %s attributes\n", "all", "all", r->mean.psnr,
           r->mean.ssim, r->n_views, r->network ? "retrained" : "source");
}

int main(int argc, char **argv)
{
    struct spin_opt_words words;
    struct spin_eval_report report = {0};
    int code;

    if (!spin_opt_parse(&command, argc, argv, 1, &words, &code))
        return code;
    if (words.n == 0)
        return spin_opt_misuse(&command, "IN.spin is missing");
    options.input = words.word[0];
    options.split = split_of(split);
    options.test_cameras = test_cameras.value;
    options.n_test_cameras = test_cameras.n;
    options.n_threads = common.n_threads;
    options.force = common.force;
    spin_status status = spin_eval(&options, &report);
    if (status != SPIN_OK)
        return spin_opt_fail(&command, status);
    if (common.json)
        report_json(&report);
    else
        report_text(&report);
    spin_eval_report_free(&report);
    return spin_opt_finish(&command, SPIN_EXIT_OK);
}
