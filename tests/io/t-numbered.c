/* K: numbered names sequence frame pattern camera hash */
#include "io/numbered.h"

#include "base/base.h"
#include "tests/tap.h"

enum { MOST = 32 };

/* The names of a sequence in the order of its frames, separated by commas. */
static const struct row {
    const char *what, *names;
    const char *numbers; /* "": an order without numbers; NULL: the names are refused */
    const char *says;    /* refused: part of the message; otherwise a --pattern, or NULL */
} rows[] = {
    /* plain */
    {"padded", "frame_0000.ply,frame_0001.ply,frame_0002.ply", "0 1 2", NULL},
    {"unpadded", "1.ply,2.ply,9.ply,10.ply,11.ply", "1 2 9 10 11", NULL},
    {"mixed widths", "f7.png,f08.png,f009.png,f10.png", "7 8 9 10", NULL},
    {"gaps", "a_1.ply,a_5.ply,a_6.ply,a_40.ply", "1 5 6 40", NULL},
    {"every tenth", "x_0.ply,x_10.ply,x_20.ply,x_30.ply", "0 10 20 30", NULL},
    {"from 1001", "shot.1001.exr,shot.1002.exr,shot.1003.exr", "1001 1002 1003", NULL},
    {"one name", "frame_0007.ply", "7", NULL},
    {"one name with a version", "frame_0007_v2.ply", "7", NULL},
    {"extensions in both cases", "frame_1.ply,frame_2.PLY,frame_3.Ply", "1 2 3", NULL},
    {"words in both cases", "Frame_1.ply,frame_2.ply,FRAME_3.ply", "1 2 3", NULL},
    {"blanks", "frame 1.ply,frame 2.ply,frame 10.ply", "1 2 10", NULL},
    {"two extensions", "frame_1.compressed.ply,frame_2.compressed.ply", "1 2", NULL},
    {"an extension with digits", "a1.splat4d,a2.splat4d", "1 2", NULL},
    {"letters beyond ASCII", "bild\xc3\xa4_1.ply,bild\xc3\xa4_2.ply", "1 2", NULL},
    /* constant numbers */
    {"version behind", "frame_0000_v2.ply,frame_0001_v2.ply,frame_0002_v2.ply", "0 1 2", NULL},
    {"SH degree behind", "0000_sh3.ply,0001_sh3.ply,0002_sh3.ply", "0 1 2", NULL},
    {"frame rate behind", "frame_0000_30fps.ply,frame_0001_30fps.ply", "0 1", NULL},
    {"camera before", "cam07_frame_0001.png,cam07_frame_0002.png", "1 2", NULL},
    {"resolution", "a_1920x1080_0001.png,a_1920x1080_0002.png", "1 2", NULL},
    {"a word with a digit", "mp3d_4k_0001.ply,mp3d_4k_0002.ply,mp3d_4k_0010.ply", "1 2 10", NULL},
    {"iteration behind", "f0001_iter7000.ply,f0002_iter7000.ply", "1 2", NULL},
    {"a date before", "2026-09-11_frame_0001.ply,2026-09-11_frame_0002.ply", "1 2", NULL},
    /* two varying numbers, one of which counts */
    {"scores", "f_0000_psnr31.20.ply,f_0001_psnr28.31.ply,f_0002_psnr29.00.ply", "0 1 2", NULL},
    {"scores without a word", "f_0_31.20.ply,f_1_28.31.ply,f_2_29.77.ply", "0 1 2", NULL},
    {"counts", "frame_0001_n12034.ply,frame_0002_n11998.ply,frame_0003_n12100.ply", "1 2 3", NULL},
    {"counts before", "12034pts_1.ply,11998pts_2.ply,12100pts_3.ply", "1 2 3", NULL},
    {"iterations of each frame", "f0_iter9000.ply,f1_iter7000.ply,f2_iter8000.ply", "0 1 2", NULL},
    {"time beside the frame", "frame_0_t0.00.ply,frame_1_t0.03.ply,frame_2_t0.07.ply", "0 1 2",
     NULL},
    {"milliseconds beside the index", "0_0000.ply,1_0033.ply,2_0067.ply,3_0100.ply", "0 1 2 3",
     NULL},
    {"the same number twice", "f1_1.ply,f2_2.ply,f3_3.ply", "1 2 3", NULL},
    {"the same number twice with a gap", "a1_b1.ply,a2_b2.ply,a4_b4.ply", "1 2 4", NULL},
    {"the same number with zeros", "a1_b0001.ply,a2_b0002.ply,a4_b0004.ply", "1 2 4", NULL},
    {"frame beside a number with a gap", "frame1_b1.ply,frame2_b2.ply,frame3_b4.ply", "1 2 3",
     NULL},
    {"counts in order", "1_11998.ply,2_12034.ply,3_12100.ply", "1 2 3", NULL},
    {"decimals beside the index", "1_0.5.ply,2_1.0.ply,3_1.5.ply", "1 2 3", NULL},
    {"numbers in another order", "a1_b7.ply,a2_b93.ply,a3_b40.ply", "1 2 3", NULL},
    {"versions", "frame_1_v3.ply,frame_2_v1.ply,frame_3_v2.ply", "1 2 3", NULL},
    {"words that vary", "f_1_walk.ply,f_2_run.ply,f_3_fall.ply", "1 2 3", NULL},
    /* hashes */
    {"hashes behind", "frame_0001_a3f9c2.ply,frame_0002_77e01b.ply,frame_0003_0b22dd.ply", "1 2 3",
     NULL},
    {"hashes before", "9f3e01ab_1.ply,00ab12cd_2.ply,7c7c7c7c_3.ply", "1 2 3", NULL},
    {"UUIDs behind",
     "1_550e8400-e29b-41d4-a716-446655440000.ply,2_123e4567-e89b-12d3-a456-42661417400a.ply", "1 2",
     NULL},
    {"a hash in a single name", "frame_0007_a3f9c2.ply", "7", NULL},
    {"four letters and runs of digits in a single name", "x7_ab3c.ply", "7", NULL},
    {"three in a single name", "x7_b33c.ply", "33", NULL},
    {"a short word in a single name", "frame_0007_v2.ply", "7", NULL},
    {"only hashes", "a3f9c201.ply,77e01bcc.ply,0b22dd1e.ply", NULL, "hashes"},
    /* decimals and time stamps */
    {"decimals", "t_0.00.ply,t_0.25.ply,t_0.50.ply,t_1.00.ply", "", NULL},
    {"decimals of several lengths", "t_0.125.ply,t_0.25.ply,t_0.5.ply,t_1.0.ply", "", NULL},
    {"decimals above 9", "t9.5.ply,t10.0.ply,t10.5.ply", "", NULL},
    {"seconds", "0.25s.ply,0.5s.ply,0.75s.ply", "", NULL},
    {"dots as separators", "shot1.8.ply,shot1.9.ply,shot1.10.ply", "8 9 10", NULL},
    {"dates", "2026-08-31.ply,2026-09-01.ply,2026-09-11.ply", "20260831 20260901 20260911", NULL},
    {"time stamps", "2026-09-11_11-59-58.png,2026-09-11_11-59-59.png,2026-09-11_12-00-00.png", "",
     NULL},
    {"time stamps across a day", "20260911_235959.png,20260912_000000.png,20260912_000001.png", "",
     NULL},
    {"time stamps with milliseconds",
     "20260911_120000_900.png,20260911_120001_000.png,20260911_120001_100.png", "", NULL},
    {"time stamps with T", "20260911T115959.ply,20260911T120000.ply,20260911T120001.ply",
     "115959 120000 120001", NULL},
    {"clock times", "10-59-59.ply,11-00-00.ply,11-00-01.ply", "105959 110000 110001", NULL},
    {"long numbers", "20260911120000.ply,20260911120001.ply,20260911120010.ply", "", NULL},
    {"nanoseconds", "1757590000000000000.png,1757590000033333333.png,1757590000066666666.png", "",
     NULL},
    {"negative numbers", "frame_-2.ply,frame_-1.ply,frame_0.ply,frame_1.ply", "", NULL},
    /* no numbers */
    {"words", "back.ply,front.ply,side.ply", "", NULL},
    {"words and a version", "back_v2.ply,front_v2.ply", "", NULL},
    /* refused */
    {"the same number", "frame_01.ply,frame_1.ply,frame_2.ply", NULL, "are both frame 1"},
    {"two clips", "left_0.ply,left_1.ply,right_0.ply,right_1.ply", NULL, "are both frame 0"},
    {"cameras and frames", "c0_f0.ply,c0_f1.ply,c1_f0.ply,c1_f1.ply", NULL, "'c%d_f*.ply'"},
    {"two numbers that count", "a_1_30.ply,a_2_20.ply,a_3_10.ply", NULL, "'a_*_%d.ply'"},
    {"two numbers of equal merit", "a_1_5.ply,a_2_6.ply,a_3_7.ply", NULL, "'a_%d_*.ply'"},
    {"one of two numbers has a gap", "a1_b1.ply,a2_b2.ply,a3_b4.ply", NULL,
     "--pattern 'a%d_b*.ply' or --pattern 'a*_b%d.ply'"},
    {"as usual, beside a number that does not vary", "v7_a01_b1.ply,v7_a02_b3.ply,v7_a03_b2.ply",
     NULL, "--pattern 'v7_a%02d_b*.ply' or --pattern 'v7_a*_b%d.ply'"},
    {"the first of two numbers has a gap", "a1_b1.ply,a2_b2.ply,a9_b3.ply", NULL, "--pattern"},
    {"a wide gap", "a1_b1.ply,a2_b2.ply,a3_b40.ply", NULL, "--pattern"},
    {"numbers of different steps", "a1_b10.ply,a2_b20.ply,a3_b30.ply", NULL, "--pattern"},
    {"two words for frames", "frame1_f1.ply,frame2_f2.ply,frame3_f4.ply", NULL, "--pattern"},
    {"two files", "a1_b1.ply,a2_b3.ply", NULL, "--pattern"},
    {"two files in two orders", "a1_b3.ply,a2_b1.ply", NULL, "--pattern"},
    {"frame and index disagree", "frame_1_3.ply,frame_2_2.ply,frame_3_1.ply", NULL, "--pattern"},
    {"a name without a number", "frame_1.ply,frame_2.ply,scene.ply", NULL, "no frame number"},
    {"a name with one more number", "f_1.ply,f_2_v2.ply,f_3.ply", NULL, "differ in how many"},
    {"only scores", "psnr28.1.ply,psnr29.4.ply,psnr27.2.ply", NULL, "a score"},
    {"only iterations", "iter_7000.ply,iter_30000.ply", NULL, "an iteration"},
    /* patterns */
    {"the first number", "a_1_30.ply,a_2_20.ply,a_3_10.ply", "1 2 3", "a_%d_*.ply"},
    {"the second number", "a_3_10.ply,a_2_20.ply,a_1_30.ply", "10 20 30", "a_*_%d.ply"},
    {"padded number", "frame_0001_v2.ply,frame_0002_v2.ply", "1 2", "frame_%04d_v2.ply"},
    {"hash signs", "frame_0009_v2.ply,frame_0010_v2.ply", "9 10", "frame_####_v2.ply"},
    {"iterations after all", "iter_7000.ply,iter_30000.ply", "7000 30000", "iter_%d.ply"},
};

static size_t split_names(char *text, const char **name)
{
    size_t n = 0;

    for (char *at = text; (name[n] = strsep(&at, ",")) != NULL; n++)
        ;
    return n;
}

/* Reads the names in another order: backwards, then every second one first. */
static spin_status read_row(const struct row *row, const char *const *name, size_t n,
                            const char **mixed, struct spin_numbers *out)
{
    struct spin_numbering numbering = {
        .name = mixed, .n = n, .pattern = row->numbers ? row->says : NULL};
    size_t k = 0;

    for (size_t odd = 0; odd < 2; odd++)
        for (size_t i = n; i-- > 0;)
            if (i % 2 == odd)
                mixed[k++] = name[i];
    return spin_numbered_read(&numbering, out);
}

static int has_order(const struct spin_numbers *got, const char *const *mixed,
                     const char *const *name, size_t n)
{
    int good = got->n_frames == n;

    for (size_t i = 0; i < n && good; i++)
        good = strcmp(mixed[got->order[i]], name[i]) == 0;
    return good;
}

static void check_row(const struct row *row)
{
    const char *name[MOST], *mixed[MOST];
    char text[1024], numbers[256] = "";
    struct spin_numbers got;
    size_t n, used = 0;

    snprintf(text, sizeof text, "%s", row->names);
    n = split_names(text, name);
    if (read_row(row, name, n, mixed, &got) != SPIN_OK) {
        ok(!row->numbers && strstr(spin_last_error(), row->says), "%s: refused: %s", row->what,
           spin_last_error());
        return;
    }
    for (size_t i = 0; i < got.n_frames; i++)
        if (got.number[got.order[i]] >= 0)
            used += (size_t)snprintf(numbers + used, sizeof numbers - used, "%s%d", used ? " " : "",
                                     got.number[got.order[i]]);
    ok(has_order(&got, mixed, name, n), "%s: the order", row->what);
    is_text(numbers, row->numbers, row->what);
    spin_numbers_free(&got);
}

static void check_groups(void)
{
    static const char *const names[] = {"cam0_0001.png", "cam1_0001.png", "cam0_0002.png",
                                        "cam1_0002.png"};
    static const int groups[] = {0, 1, 0, 1};
    struct spin_numbers got;

    ok(spin_numbered_read(&(struct spin_numbering){.name = names, .n = 4, .group = groups}, &got) ==
               SPIN_OK &&
           got.number[0] == 1 && got.number[1] == 1 && got.number[2] == 2 && got.number[3] == 2,
       "the frames of two cameras in one folder");
    spin_numbers_free(&got);
}

static void check_left_out(void)
{
    static const char *const names[] = {"frame_2.ply", "scene.ply", "frame_1.ply"};
    struct spin_numbers got;

    ok(spin_numbered_read(&(struct spin_numbering){.name = names, .n = 3, .pattern = "frame_#.ply"},
                          &got) == SPIN_OK &&
           got.n_frames == 2 && got.order[0] == 2 && got.number[0] == 2 && got.number[1] == -1,
       "a name that does not match the pattern is left out");
    spin_numbers_free(&got);
}

static void check_cameras(void)
{
    ok(spin_camera_number("images/cam07_0001.png") == 7, "cam07_0001");
    ok(spin_camera_number("left-Cam_7.png") == 7, "left-Cam_7");
    ok(spin_camera_number("camera 12/0001.png") == 12, "a folder 'camera 12'");
    ok(spin_camera_number("cam1/cam02.png") == 2, "the file's name counts first");
    ok(spin_camera_number("webcam1_0001.png") == -1, "webcam1");
    ok(spin_camera_number("dashcam9_1_0000.png") == -1, "dashcam9");
    ok(spin_camera_number("camping_1.png") == -1, "camping_1");
    ok(spin_camera_number("cam.png") == -1, "cam without a number");
    ok(spin_camera_number("cam0/cam3/000.png") == 3, "the nearest folder counts");
    ok(spin_camera_number("cam3/cam0/cam.png") == 0, "camera 0 is one");
    ok(spin_camera_number("cam00") == 0 && spin_camera_number("/cam-5") == 5,
       "no folder, the root");
    ok(spin_camera_number("cam123456789.png") == 123456789 &&
           spin_camera_number("cam1234567890.png") == -1,
       "at most nine digits");
    ok(spin_camera_number("cam_x cam4.png") == 4 && spin_camera_number("cam__4.png") == -1 &&
           spin_camera_number("CAM.4") == 4 && spin_camera_number("cameras1.png") == -1,
       "one separator; the first word with a number");
}

static void check_split(void)
{
    char *folder;
    const char *rest;

    ok(spin_pattern_split("run/frame_%d/a.ply", &folder, &rest) == SPIN_OK &&
           strcmp(folder, "run") == 0 && strcmp(rest, "frame_%d/a.ply") == 0,
       "a pattern in a folder's name");
    free(folder);
    ok(spin_pattern_split("####.ply", &folder, &rest) == SPIN_OK && strcmp(folder, ".") == 0 &&
           strcmp(rest, "####.ply") == 0,
       "a pattern without a folder");
    free(folder);
    ok(spin_pattern_split("/%04d.ply", &folder, &rest) == SPIN_OK && strcmp(folder, "/") == 0,
       "a pattern in the root");
    free(folder);
    ok(spin_pattern_split("run/100%/a.ply", &folder, &rest) == SPIN_OK && !rest, "no pattern");
}

TAP_MAIN
{
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        check_row(&rows[i]);
    check_groups();
    check_left_out();
    check_cameras();
    check_split();
    ok(spin_compare_names("cam2", "cam10") < 0, "cam2 precedes cam10");
    ok(spin_compare_names("a01", "a1") != 0, "different names are never equal");
}
