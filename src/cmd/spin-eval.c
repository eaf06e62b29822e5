/* spin-eval: how good the splats of a bundle look from cameras that are known. */
#include "cmd/args.h"

#include "spin_run.h"

static struct spin_eval_options options = {.image_scale = 1, .device = "auto"};
static struct spin_args_list test_cameras;

static const struct spin_args_row rows[] = {
    SPIN_ARG_HEADING("What to measure"),
    SPIN_ARG("source", 0, NULL, FLAG, options.source,
             "measure the imported attributes instead of the retrained ones"),
    SPIN_ARG("split", 0, "test|train|all", ENUM, options.split, "the cameras (test)"),
    SPIN_ARG("test-cams", 0, "LIST", INTS, test_cameras,
             "camera numbers held out (the data set's own)", .min = 0, .max = 1e9),
    SPIN_ARG("range", 0, "A:B[:STEP]", RANGE, options.range, "frame numbers A to B-1"),
    SPIN_ARG("scale", 0, "S", DOUBLE, options.image_scale, "image scale, 0.5 halves both sides (1)",
             .min = 0.01, .max = 1),
    SPIN_ARG("background", 0, "COLOUR", COLOUR, options.background,
             "black, white or R,G,B with each in 0..1 (black)", .min = 0, .max = 1),
    SPIN_ARG("dynamic", 0, "auto|masks|images|off", ENUM, options.dynamic,
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

/* ---- For people ------------------------------------------------------------------------------ */

#define MEASURES                                                                                   \
    "{{psnr %10.3f}}{{ssim %9.4f}}{{^dynamic_from=off}}{{psnr_dynamic %10.3f}}{{/}}"               \
    "{{#lpips_vgg}}{{lpips_vgg %12.4f}}{{/}}{{#lpips_alex}}{{lpips_alex %12.4f}}{{/}}"
#define HEAD                                                                                       \
    " frame  camera      PSNR     SSIM{{^dynamic_from=off}}   dynamic{{/}}"                        \
    "{{#lpips_vgg}}   LPIPS VGG{{/}}{{#lpips_alex}}  LPIPS Alex{{/}}\n"
#define VIEWS "{{#views}}{{frame %6d}}{{camera %8d}}" MEASURES "\n{{/}}"
#define MEANS                                                                                      \
    "{{#frames}}{{frame %6d}}     all" MEASURES "\n{{/}}"                                          \
    "{{#cameras}}   all{{id %8d}}" MEASURES "\n{{/}}"
#define ALL "   all     all" MEASURES "   {{views}} views, {{attributes}} attributes\n"
#define FOOT                                                                                       \
    "{{^dynamic_from=off}}dynamic  {{dynamic %.2p}} % of the pixels, from "                        \
    "{{#dynamic_from=masks}}foreground masks{{/}}{{#dynamic_from=images}}the images{{/}}: "        \
    "PSNR {{psnr_dynamic %.3f}} there, {{psnr_static %.3f}} elsewhere\n{{/}}"                      \
    "speed    {{fps %.2f}} frames per second with decoding, {{fps_draw %.2f}} without\n"           \
    "storage  {{storage.measured %B}} for these attributes, {{storage.measured_per_frame %B}} "    \
    "a frame; the file has {{storage.file %B}}, unpacked {{storage_unpacked.file %B}}\n"

int main(int argc, char **argv)
{
    char *report;
    int code;

    if (!spin_args_parse(&command, argc, argv, &code))
        return code;
    if (!spin_args.word)
        return spin_args_misuse(&command, "IN.spin is missing");
    options.input = spin_args.word;
    options.test_cameras = test_cameras.ints;
    options.n_test_cameras = test_cameras.n;
    options.n_threads = spin_args.n_threads;
    options.force = spin_args.force;
    if (!spin_args_begin(&command, &code) ||
        !spin_args_ended(&command, spin_eval(&options, &report), &code))
        return code;
    return spin_args_report(&command, report,
                            spin_args.quiet     ? HEAD ALL
                            : spin_args.verbose ? HEAD VIEWS MEANS ALL FOOT
                                                : HEAD MEANS ALL FOOT);
}
