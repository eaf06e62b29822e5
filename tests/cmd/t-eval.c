/* Options of spin-eval change what is measured and how; its totals agree with its views and with
 * the file.
 * K: eval options storage fps */

#include "base/log.h"
#include "tests/cmd/command.h"

enum { MOST = 64 };
static const char small[] =
    "--preset paper --device cpu --threads 1 --scale 0.25 --levels 4 --hash-log2 10 "
    "--finest-resolution 32 --hidden 16 --iterations 4 -q";

/* The report of one spin-eval --json. */
struct eval {
    spin_json *json;
    int n, frame[MOST], camera[MOST];
    double mean, psnr[MOST];
};

static struct eval measure(const char *bundle, const char *more)
{
    struct eval e = {0};
    const spin_json *views;
    const char *json;

    if (!ok(shell("%s/spin-eval %s/%s --scale 0.25 --json -q %s", bin, folder, bundle, more) == 0 &&
                (json = strstr(said, "{\n")) &&
                spin_json_parse("stdout", json, strlen(json), &e.json) == SPIN_OK,
            "spin-eval %s %s", bundle, more)) {
        printf("#   %s\n", said);
        exit(tap_done());
    }
    views = spin_json_get(e.json, "views");
    e.mean = number(e.json, "psnr");
    for (size_t i = 0; i < spin_json_length(views) && i < MOST; i++, e.n++) {
        e.frame[i] = (int)number(spin_json_at(views, i), "frame");
        e.camera[i] = (int)number(spin_json_at(views, i), "camera");
        e.psnr[i] = number(spin_json_at(views, i), "psnr");
    }
    return e;
}

static double mean_psnr(const struct eval *e)
{
    double sum = 0;

    for (int i = 0; i < e->n; i++)
        sum += e->psnr[i] / e->n;
    return sum;
}

/* Exactly the frames first, first + step, ... below end of every listed camera are measured. */
static bool shows(const struct eval *e, int first, int end, int step, const int *camera, int n)
{
    int wanted = 0, found = 0;

    for (int f = first; f < end; f += step)
        for (int c = 0; c < n; c++, wanted++)
            for (int i = 0; i < e->n; i++)
                found += e->frame[i] == f && e->camera[i] == camera[c];
    return wanted == found && e->n == wanted;
}

/* Views that both reports contain have the same values. */
static bool agree(const struct eval *a, const struct eval *b)
{
    int both = 0;

    for (int i = 0; i < a->n; i++)
        for (int k = 0; k < b->n; k++)
            if (a->frame[i] == b->frame[k] && a->camera[i] == b->camera[k]) {
                if (a->psnr[i] != b->psnr[k])
                    return false;
                both++;
            }
    return both > 0;
}

/* Test views are those that the training held out, also for another training of its output. */
static void test_held_out(void)
{
    static const int held[] = {3, 19, 23}, other[] = {7};
    static const char *const more[] = {"--iterations 1 --learn-exposure off",
                                       "--method frames --refine 1 --learn-exposure off"};

    for (int k = 0; k < 2; k++) {
        struct eval first, named, second;

        ok(shell("%s/spin-retrain %s/in.spin -o %s/held.spin %s --test-cams 3,19,23 --range 1:2 "
                 "--force",
                 bin, folder, folder, more[k]) == 0 &&
               shell("%s/spin-retrain %s/held.spin -o %s/again.spin %s --force", bin, folder,
                     folder, more[k]) == 0 &&
               strstr(said, "5 training and 3 test views"),
           "two trainings, %s", more[k]);
        first = measure("held.spin", "");
        named = measure("held.spin", "--test-cams 7");
        second = measure("again.spin", "");
        ok(shows(&first, 1, 2, 1, held, 3), "the cameras that it held out");
        ok(shows(&named, 1, 2, 1, other, 1), "--test-cams: exactly those");
        ok(shell("%s/spin-eval %s/held.spin --test-cams 3 --scale 0.25", bin, folder) == 0 &&
               strstr(said, "   1 view, "),
           "one view is none of several");
        ok(shell("%s/spin-eval %s/held.spin --test-cams 7,19 --scale 0.25 -q", bin, folder) == 0 &&
               strstr(said, "warning: 1 of 2 --test-cams cameras was used to train "),
           "cameras that trained it are no held-out ones, and that is said");
        ok(shell("%s/spin-eval %s/held.spin --test-cams 3 --scale 0.25 -q && %s/spin-eval "
                 "%s/held.spin --test-cams 7 --source --scale 0.25 -q && %s/spin-eval %s/held.spin "
                 "--test-cams 7 --split train --scale 0.25 -q",
                 bin, folder, bin, folder, bin, folder) == 0 &&
               !strstr(said, "were used to train"),
           "nothing is said of a held-out camera, of the source, of training views");
        ok(shows(&second, 1, 2, 1, held, 3),
           "and so do a training of its output and what measures that");
        spin_json_free(first.json), spin_json_free(named.json), spin_json_free(second.json);
        ok(shell("%s/spin-export %s/held.spin --to images -o %s/held%d && ls %s/held%d", bin,
                 folder, folder, k, folder, k) == 0 &&
               strstr(said, "cam_03_") && strstr(said, "cam_19_") && !strstr(said, "cam_15_"),
           "spin-export draws those too");
    }
}

static void test_views(void)
{
    static const int test[] = {0, 15}, train[] = {3, 7, 12, 19, 23, 27}, residual[] = {3, 19},
                     all[] = {0, 3, 7, 12, 15, 19, 23, 27};
    struct eval one = measure("net.spin", ""), of_train = measure("net.spin", "--split train"),
                of_all = measure("net.spin", "--split all"),
                cams = measure("net.spin", "--test-cams 3,19"),
                some = measure("net.spin", "--range 1:6:3"),
                threads = measure("net.spin", "--threads 3 --device cpu");

    ok(shows(&one, 0, 6, 1, test, 2), "the test views, by default");
    ok(shows(&of_train, 0, 6, 1, train, 6), "--split train: those alone");
    ok(shows(&of_all, 0, 6, 1, all, 8), "--split all: both");
    ok(shows(&cams, 0, 6, 1, residual, 2), "--test-cams: exactly those");
    ok(shows(&some, 1, 6, 3, test, 2), "--range: frames 1 and 4");
    ok(agree(&one, &of_all) && agree(&of_train, &of_all) && agree(&cams, &of_all) &&
           agree(&some, &of_all),
       "a view has one value in all of them");
    ok(one.mean == threads.mean && agree(&one, &threads), "on any number of threads");
    near(one.mean, mean_psnr(&one), 1e-9, "the mean is that of the views");
    near(of_all.mean, (one.mean * one.n + of_train.mean * of_train.n) / (one.n + of_train.n), 1e-9,
         "and of both splits");
    near(number(spin_json_at(spin_json_get(one.json, "frames"), 2), "psnr"),
         (one.psnr[4] + one.psnr[5]) / 2, 1e-9, "a frame's is that of its views");
    ok(one.psnr[4] != one.psnr[5] && one.frame[4] == 2 && one.frame[5] == 2, "which differ");
    spin_json_free(one.json), spin_json_free(of_train.json), spin_json_free(of_all.json);
    spin_json_free(cams.json), spin_json_free(some.json), spin_json_free(threads.json);
}

static void test_pictures(void)
{
    char more[300];
    struct eval black = measure("net.spin", ""), white = measure("net.spin", "--background white"),
                source = measure("net.spin", "--source"), in = measure("in.spin", ""), half;

    ok(fabs(black.mean - white.mean) > 0.1, "--background shows behind the splats");
    ok(shell("%s/spin-eval %s/net.spin --scale 0.25 --background white -q", bin, folder) == 0 &&
           strstr(said, "a different background: --background 0,0,0 "),
       "that training was over another is said");
    ok(shell("%s/spin-eval %s/net.spin --scale 0.25 -q; %s/spin-eval %s/net.spin --scale 0.25 "
             "--source "
             "--background white -q",
             bin, folder, bin, folder) == 0 &&
           !strstr(said, "warning"),
       "not over the same, nor of the source");
    ok(shell("%s/spin-export %s/net.spin -o %s/bg.html --background white", bin, folder, folder) ==
               0 &&
           strstr(said,
                  "a different background: --background 0,0,0 draws over that of the training"),
       "spin-export says it, too");
    ok(shell("for of in '--to images -o %s/bg1 --background none' '--to images -o %s/bg2' '--to "
             "ply -o %s/bg3 --background white' '--to images -o %s/bg4 --source --background "
             "white'; do %s/spin-export %s/net.spin $of --range 0:1 || exit 1; done",
             folder, folder, folder, folder, bin, folder) == 0 &&
           !strstr(said, "different background"),
       "but not of alpha, of the same, of splats or of the source");
    is_text(spin_json_string(spin_json_get(black.json, "attributes")), "retrained",
            "the network's splats");
    is_text(spin_json_string(spin_json_get(source.json, "attributes")), "source", "--source");
    ok(source.mean == in.mean && source.mean > black.mean + 1, "are those that were imported");
    snprintf(more, sizeof more, "--scale 0.5 --images %s/half", folder);
    half = measure("net.spin", more);
    ok(half.mean != black.mean, "--scale: other pictures");
    ok(shell("test $(ls %s/half/*.png | wc -l) = 12", folder) == 0, "--images: one a view");
    ok(is_png("half", "cam_15_frame_00005.png", 3 * 80 + 2 * 4, 45), "three panels of 80 x 45");
    spin_json_free(black.json), spin_json_free(white.json), spin_json_free(source.json);
    spin_json_free(in.json), spin_json_free(half.json);
}

static void test_moving(void)
{
    struct eval images = measure("in.spin", "--dynamic images"),
                off = measure("in.spin", "--dynamic off");

    is_text(spin_json_string(spin_json_get(images.json, "dynamic_from")), "images",
            "--dynamic images");
    ok(number(images.json, "psnr_dynamic") < number(images.json, "psnr_static"),
       "what moves is worse than what is still");
    ok(isnan(number(off.json, "psnr_dynamic")), "--dynamic off: not measured");
    spin_json_free(images.json), spin_json_free(off.json);
}

/* Total size of the members whose names begin with this prefix. */
static double bytes_of(const struct spin_zip *zip, const char *with)
{
    double sum = 0;

    for (size_t i = 0; i < zip->n; i++)
        if (!strncmp(zip->member[i].name, with, strlen(with)))
            sum += (double)zip->member[i].packed_size;
    return sum;
}

static void check_storage(const char *bundle, const char *more, const char *const measured[3])
{
    struct eval e = measure(bundle, more);
    const spin_json *s = spin_json_get(e.json, "storage");
    struct spin_zip zip;
    struct stat st;
    char path[600];
    double sum = 0;

    snprintf(path, sizeof path, "%s/%s", folder, bundle);
    if (!ok(spin_zip_open(path, &zip) == SPIN_OK && stat(path, &st) == 0, "%s is a zip", bundle))
        return;
    near(number(s, "file"), (double)st.st_size, 0, "the file's bytes");
    near(number(s, "source"), bytes_of(&zip, "source/"), 0, "the source's");
    near(number(s, "refined"), bytes_of(&zip, "refined/"), 0, "the refined frames'");
    near(number(s, "positions"),
         bytes_of(&zip, "trained/means/") + bytes_of(&zip, "trained/residual/"), 0,
         "the positions'");
    near(number(s, "tracks"), bytes_of(&zip, "trained/track"), 0, "the tracks'");
    near(number(s, "table"), bytes_of(&zip, "trained/table.npy"), 0, "the table's");
    near(number(s, "heads"), bytes_of(&zip, "trained/heads.npy"), 0, "the heads'");
    for (int i = 0; i < 3; i++)
        sum += measured[i] ? bytes_of(&zip, measured[i]) : 0;
    ok(sum > 0, "there are some");
    near(number(s, "measured"), sum, 0, "those of what was measured");
    near(number(s, "measured_per_frame"),
         sum / (double)spin_json_length(spin_json_get(e.json, "frames")), 1e-6, "a frame's share");
    spin_zip_close(&zip);
    spin_json_free(e.json);
}

static void test_storage(void)
{
    static const char *const
        network[] = {"trained/means/", "trained/table.npy", "trained/heads.npy"},
        *const residual[] = {"trained/", NULL, NULL}, *const source[] = {"source/", NULL, NULL},
        *const refined[] = {"refined/", NULL, NULL};

    check_storage("net.spin", "", network);
    check_storage("own.spin", "", residual);
    check_storage("net.spin", "--source", source);
    check_storage("in.spin", "", source);
    check_storage("refined.spin", "", refined);
}

/* The figures are consistent, and parts do not exceed the whole. */
static void test_speed(void)
{
    double start = spin_now_s(), whole, decode, draw;
    struct eval e = measure("net.spin", "--split all");

    whole = spin_now_s() - start;
    decode = number(e.json, "seconds_decode");
    draw = number(e.json, "seconds_draw");
    near(number(e.json, "fps") * (decode + draw), 1, 1e-9, "fps: a picture with its decoding");
    near(number(e.json, "fps_draw") * draw, 1, 1e-9, "fps_draw: a picture without");
    ok(decode > 0 && draw > 0 && 6 * decode + e.n * draw < whole,
       "six decodings and 48 pictures in %.2f s", whole);
    spin_json_free(e.json);
    shell("%s/spin-eval %s/net.spin --scale 0.25 --threads 1", bin, folder);
    ok(strstr(said, "frames per second with decoding") != NULL, "as text too");
    shell("%s/spin-eval %s/net.spin --scale 0.25 -q", bin, folder);
    ok(strstr(said, "frames per second") == NULL && strstr(said, "12 views"), "-q: only the mean");
}

static void test_data(void)
{
    double by[3];
    static const char *const pair[] = {"--pair number", "--pair order", ""};

    ok(shell("%s/spin-eval %s/in.spin --data-from transforms", bin, folder) == 1 &&
           strstr(said, "transforms"),
       "--data-from: another reader looks for other files");
    ok(shell("%s/spin-eval %s/in.spin --data %s", bin, folder, folder) == 1 && strstr(said, folder),
       "--data: another folder is none");
    ok(shell("%s/spin-eval %s/in.spin --device cuda", bin, folder) == 1 &&
           strstr(said, "no CUDA device"),
       "--device cuda: there is none");
    /* Two frames with the numbers of the data set's rows 1 and 3. */
    ok(shell("%s/spin-export %s/in.spin --to ply -o %s/ply --range 1:4:2", bin, folder, folder) ==
               0 &&
           shell("cd %s/ply && rm sequence.json && mv frame_00001.ply frame_00009.ply && "
                 "mv frame_00003.ply frame_00011.ply",
                 folder) == 0 &&
           shell("%s/spin-import %s/ply -o %s/two.spin", bin, folder, folder) == 0,
       "two frames with numbers");
    for (int i = 0; i < 3; i++) {
        char more[300];
        struct eval e;

        snprintf(more, sizeof more, "--data %s --data-from panoptic %s", clip, pair[i]);
        e = measure("two.spin", more);
        by[i] = e.mean;
        ok(e.n == 4 && e.frame[0] == 9 && e.frame[3] == 11, "frames have the clip's numbers");
        spin_json_free(e.json);
    }
    ok(by[0] > by[1] + 0.1, "--pair: by number the pictures fit, by order they do not");
    ok(by[0] == by[2], "auto: by number, where both have numbers");
}

static int count(const char *text)
{
    int n = 0;

    for (const char *at = said; (at = strstr(at, text)); at += strlen(text))
        n++;
    return n;
}

static void test_report(void)
{
    ok(shell("%s/spin-eval %s/net.spin --scale 0.25 --report %s/without.html -q", bin, folder,
             folder) == 0 &&
           shell("grep -o '<svg class=.chart' %s/without.html; true", folder) == 0,
       "--report");
    ok(count("<svg") == 1, "has a curve");
    ok(shell("%s/spin-eval %s/net.spin --scale 0.25 --report %s/with.html --log %s/log -q", bin,
             folder, folder, folder) == 0 &&
           !strstr(said, "of another run"),
       "--report with --log");
    ok(shell("sed 's/\"test_psnr\": /&1/' %s/log >%s/other; %s/spin-eval %s/net.spin --scale 0.25 "
             "--report %s/other.html --log %s/other -q",
             folder, folder, bin, folder, folder, folder) == 0 &&
           strstr(said, "/other' seems to belong to another run: its last test PSNR is 1"),
       "a log of another run is seen");
    ok(shell("test $(grep -c '<svg class=.chart' %s/with.html) -gt $(grep -c '<svg class=.chart' "
             "%s/without.html)",
             folder, folder) == 0,
       "--log: more curves");
    ok(shell("%s/spin-eval %s/net.spin --scale 0.25 --report %s/with.html -q", bin, folder,
             folder) == 1,
       "does not overwrite");
    ok(shell("%s/spin-eval %s/net.spin --scale 0.25 --report %s/with.html -q --force", bin, folder,
             folder) == 0,
       "--force does");
}

TAP_MAIN
{
    begin_commands();
    ok(shell("%s/spin-retrain %s/in.spin -o %s/net.spin --log %s/log --eval-every 2 %s", bin,
             folder, folder, folder, small) == 0 &&
           shell("%s/spin-retrain %s/in.spin -o %s/own.spin --residual points %s", bin, folder,
                 folder, small) == 0 &&
           shell("%s/spin-retrain %s/in.spin -o %s/refined.spin --method frames --refine 2 %s", bin,
                 folder, folder, small) == 0,
       "three bundles: %s", said);
    test_held_out();
    test_views();
    test_pictures();
    test_moving();
    test_storage();
    test_speed();
    test_data();
    test_report();
}
