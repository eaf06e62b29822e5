/* The parts of the report: logs of resumed or interrupted runs, the crop of fastest motion, the
 * worst views.
 * K: eval report */
#include "spin_run.h"
#include "eval/report/report.h"
#include "scene/dataset.h"
#include "scene/image_cache.h"
#include "tests/check.h"
#include "tests/tap.h"

static const float black[3];
static const char *folder;

static const char *write_log(const char *text)
{
    static char path[600];
    FILE *f;

    snprintf(path, sizeof path, "%s/log.jsonl", folder);
    f = fopen(path, "w");
    if (!f)
        exit(1);
    fputs(text, f);
    fclose(f);
    return path;
}

static void check_history(void)
{
    struct spin_train_log h;

    ok(spin_train_log_read(write_log("{\"iteration\": 1, \"loss\": 4}\n"
                                     "{\"iteration\": 2, \"loss\": 3}\n"
                                     "{\"iteration\": 2, \"seconds\": 9, \"test_psnr\": 20}\n"
                                     "{\"iteration\": 3, \"loss\": 9}\n"
                                     "{\"iteration\": 2, \"loss\": 2}\n"
                                     "{\"iteration\": 2, \"seconds\": 8, \"test_psnr\": 21}\n"
                                     "{\"iteration\": 3, \"loss\": 1}\n"
                                     "{\"iteration\": 4, \"lo"),
                           100, &h) == SPIN_OK &&
           h.n_steps == 3 && h.n_tests == 1,
       "a resumed run that was cut short");
    ok(h.loss[1] == 2 && h.loss[2] == 1 && h.psnr[0] == 21 && h.seconds[0] == 8 &&
           h.total_seconds == 8,
       "what was done twice counts once");
    spin_train_log_free(&h);
    ok(spin_train_log_read(
           write_log("{\"iteration\": 1, \"loss\": 4}\n{\"iteration\": 2, \"loss\": 2}\n"
                     "{\"iteration\": 3, \"loss\": 1}\n"),
           2, &h) == SPIN_OK &&
           h.n_steps == 2 && h.step[0] == 2 && h.loss[0] == 3 && h.loss[1] == 1,
       "thinned to means");
    spin_train_log_free(&h);
    ok(spin_train_log_read(write_log("{\"iteration\": 1, \"loss\": 4}\nnonsense\n"), 2, &h) !=
               SPIN_OK &&
           strstr(spin_last_error(), "line 2"),
       "%s", spin_last_error());
    ok(spin_train_log_read("no/such/log", 2, &h) != SPIN_OK, "%s", spin_last_error());
}

enum { W = 96, H = 72, ROWS = 5, PLANE = W * H };

/* A static wall, and a square of 10 pixels that jumps. */
static void check_crops(void)
{
    static float image[3 * PLANE];
    struct spin_views *views;
    struct spin_clip clip = {.n_frames = ROWS, .has_views = true};
    int row_of[ROWS], frame_of[ROWS];
    struct spin_pair pair[2 * ROWS];
    struct spin_crop crop[4];
    struct spin_image_cache pixels;
    size_t n = 0;
    bool inside = true, scored = true;

    clip.dataset_frame = row_of;
    clip.frame = frame_of;
    views = &clip.views;
    for (int row = 0; row < ROWS; row++) {
        row_of[row] = frame_of[row] = row;
        for (int camera = 0; camera < 2; camera++) {
            char path[600];
            struct spin_view v = {.dataset_frame = row, .camera_id = camera, .path = path};
            int left = 14 * row + 8, top = 30;

            v.camera = (struct spin_camera){.width = W, .height = H, .fx = 90, .fy = 90};
            for (int i = 0; i < 3 * PLANE; i++)
                image[i] = 0.3f + 0.3f * (float)camera + 0.002f * (float)(i % 97);
            for (int y = top; y < top + 10 && camera == 0; y++)
                for (int x = left; x < left + 10; x++)
                    image[y * W + x] = 1;
            snprintf(path, sizeof path, "%s/%d_%d.png", folder, camera, row);
            if (spin_image_save(path, W, H, image, false) != SPIN_OK ||
                spin_views_add(views, &v) != SPIN_OK)
                exit(1);
            pair[2 * row + camera] = (struct spin_pair){row, (size_t)(2 * row + camera)};
        }
    }
    if (spin_image_cache_open(views, 0, black, &pixels) != SPIN_OK)
        exit(1);
    ok(spin_motion_crops_fast(&clip, &pixels, pair, 2 * ROWS, 4, crop, &n) == SPIN_OK,
       "looks for motion");
    ok(n == 1 || n == 2,
       "%zu crops: none of the still camera, no two frames that follow each other", n);
    for (size_t i = 0; i < n; i++) {
        int left = 14 * pair[crop[i].pair].frame + 8;

        inside = inside && pair[crop[i].pair].view % 2 == 0 && crop[i].x <= left &&
                 crop[i].x + crop[i].side_x >= left + 10 && crop[i].y <= 30 &&
                 crop[i].y + crop[i].side_y >= 40;
        /* The core of 8 x 8 pixels lies within the square, and the other 36 pixels of the square
         * count a quarter, negatively. */
        scored =
            scored && crop[i].side_x == 24 && crop[i].side_y == 24 &&
            fabs(crop[i].score - (64 - 0.25 * 36) * (0.7 - 0.002 * ((35 * W + left + 5) % 97))) < 1;
    }
    ok(inside, "each holds the whole square");
    ok(scored, "and has its score");
    spin_image_cache_close(&pixels);
    spin_views_free(views);
}

static void check_worst(void)
{
    struct spin_eval_view view[5] = {
        {.camera = 4, .q.psnr = NAN}, /* of a subject that is not there */
        {.camera = 1, .q.psnr = 9},
        {.camera = 1, .q.psnr = 8},
        {.camera = 2, .q.psnr = 20},
        {.camera = 3, .q.psnr = 10}};
    size_t out[5];

    ok(spin_motion_crops_worst(view, 5, 3, out) == 3 && out[0] == 2 && out[1] == 4 && out[2] == 3,
       "the worst view of every camera, worst first");
    ok(spin_motion_crops_worst(view, 5, 5, out) == 4 && out[3] == 1, "then the others");
}

TAP_MAIN
{
    folder = check_folder();
    check_history();
    check_crops();
    check_worst();
}
