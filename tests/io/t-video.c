/* Frames of videos: names, any order, what is passed on the way, files that are damaged.
 * K: video dynerf datasets */
#include <pthread.h>
#include <unistd.h>

#include "io/image.h"
#include "io/video.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { FRAMES = 21, W = 64, H = 48, SEED = 3, FPS = 30 };

static void test_names(void)
{
    size_t n = 0;
    int64_t frame = -1;

    ok(spin_video_path("a/cam00.mp4#12", &n, &frame) && n == 11 && frame == 12, "cam00.mp4#12");
    ok(spin_video_path("x.MKV#0", &n, &frame) && frame == 0, "any case of letters");
    ok(!spin_video_path("cam00.mp4", &n, &frame) && !spin_video_path("cam00.mp4#", &n, &frame) &&
           !spin_video_path("cam00.mp4#1x", &n, &frame) &&
           !spin_video_path("cam00.mp4#12345678901", &n, &frame) &&
           !spin_video_path("cam00.png#1", &n, &frame) && !spin_video_path(".mp4#1", &n, &frame),
       "and nothing else");
    ok(spin_video_is_name("cam00.mp4") && !spin_video_is_name(".mp4") &&
           !spin_video_is_name("cam00.png"),
       "names of videos");
    for (int i = 0; i < 6; i++) {
        static const char *const endings[] = {"mp4", "mov", "m4v", "mkv", "webm", "avi"};
        char name[20];

        snprintf(name, sizeof name, "a.%s#3", endings[i]);
        ok(spin_video_path(name, &n, &frame) && n == strlen(name) - 2 && frame == 3, "%s", name);
    }
}

/* What tests/tools/make-video.c paints: Y, U, V to R, G, B by BT.601, limited range. */
static void colour_of(int f, double rgb[3])
{
    double y = (40 + (f * 11 + SEED * 5) % 160 - 16) * 255.0 / 219;
    double u = ((f * 7) % 60 - 30) * 255.0 / 224, v = ((f * 13 + SEED) % 60 - 30) * 255.0 / 224;
    double raw[3] = {y + 1.402 * v, y - 0.344136 * u - 0.714136 * v, y + 1.772 * u};

    for (int c = 0; c < 3; c++)
        rgb[c] = fmin(255, fmax(0, raw[c]));
}

/* The pixel in the lower right corner, where the square never is. */
static double off_by(const uint8_t *rgb, int f)
{
    const uint8_t *pixel = rgb + 3 * (W * H - 1);
    double want[3], worst = 0;

    colour_of(f, want);
    for (int c = 0; c < 3; c++)
        worst = larger(worst, fabs(pixel[c] - want[c]));
    return worst;
}

struct passed {
    unsigned seen[FRAMES];
    int n_asked, even_only;
    double worst;
};

static bool is_wanted(void *context, int64_t frame)
{
    struct passed *p = context;

    p->n_asked++;
    return !p->even_only || frame % 2 == 0;
}

static void receive_frame(void *context, int64_t frame, int width, int height, const uint8_t *rgb)
{
    struct passed *p = context;

    if (width == W && height == H && frame >= 0 && frame < FRAMES) {
        p->seen[frame]++;
        p->worst = larger(p->worst, off_by(rgb, (int)frame));
    }
}

static void test_order(const char *path)
{
    static const int order[] = {0, 1, 20, 7, 8, 9, 8, 15, 16, 3, 19, 2, 2, 13};
    double worst = 0;
    int n_good = 0, n = sizeof order / sizeof *order;

    for (int i = 0; i < n; i++) {
        int w = 0, h = 0;
        uint8_t *rgb = NULL;

        if (spin_video_read(path, order[i], NULL, &w, &h, &rgb) == SPIN_OK && w == W && h == H) {
            n_good++;
            worst = larger(worst, off_by(rgb, order[i]));
        } else {
            printf("# %s\n", spin_last_error());
        }
        free(rgb);
    }
    ok(n_good == n, "frames come in any order");
    ok(worst < 6, "each of its own colour, up to what the coding loses (%.1f of 255)", worst);
}

static void test_passing(const char *path)
{
    struct passed p = {.even_only = 0};
    struct spin_video_passer passer = {&p, is_wanted, receive_frame};
    uint8_t *rgb = NULL;
    int w, h;
    bool good = spin_video_read(path, 0, NULL, &w, &h, &rgb) == SPIN_OK;

    free(rgb);
    good = good && spin_video_read(path, 6, &passer, &w, &h, &rgb) == SPIN_OK;
    free(rgb);
    ok(good && p.seen[1] && p.seen[3] && p.seen[5] && !p.seen[6] && !p.seen[0] && p.worst < 6,
       "frames on the way are offered, each with its own picture");
    p = (struct passed){.even_only = 1};
    good = spin_video_read(path, 14, &passer, &w, &h, &rgb) == SPIN_OK;
    free(rgb);
    ok(good && p.n_asked == 6 && p.seen[8] == 1 && p.seen[12] == 1 && !p.seen[9],
       "from the key frame before it on, and given only where they are wanted");
}

/* Reads another video while the first one is being decoded. */
struct meeting {
    const char *other;
    pthread_t thread;
    bool started, good;
};

static void *read_other(void *context)
{
    struct meeting *m = context;
    uint8_t *rgb = NULL;
    int w, h;

    m->good = spin_video_read(m->other, 9, NULL, &w, &h, &rgb) == SPIN_OK && off_by(rgb, 9) < 6;
    free(rgb);
    return NULL;
}

static bool wants_all(void *context, int64_t frame)
{
    (void)context, (void)frame;
    return true;
}

/* Is called in the middle of decoding the first video. */
static void wait_for_other(void *context, int64_t frame, int width, int height, const uint8_t *rgb)
{
    struct meeting *m = context;
    struct timespec end;

    (void)frame, (void)width, (void)height, (void)rgb;
    if (m->started)
        return;
    m->started = true;
    clock_gettime(CLOCK_REALTIME, &end);
    end.tv_sec += 20;
    if (pthread_create(&m->thread, NULL, read_other, m) != 0)
        return;
    if (pthread_timedjoin_np(m->thread, NULL, &end) != 0) {
        m->good = false;
        pthread_detach(m->thread);
    }
}

static void test_two_at_once(const char *path)
{
    struct spin_map map;
    struct meeting m = {0};
    struct spin_video_passer passer = {&m, wants_all, wait_for_other};
    uint8_t *rgb = NULL;
    int w, h;
    bool good;

    if (spin_map_open(path, &map) != SPIN_OK)
        exit(1);
    m.other = check_truncated(path, map.size);
    spin_map_close(&map);
    good = spin_video_read(path, 0, NULL, &w, &h, &rgb) == SPIN_OK;
    free(rgb);
    good = good && spin_video_read(path, 6, &passer, &w, &h, &rgb) == SPIN_OK && off_by(rgb, 6) < 6;
    free(rgb);
    ok(good && m.started && m.good, "a video is decoded while another one is");
}

static void test_times(const char *path)
{
    double *times = NULL, worst = 0;
    int64_t n = 0;

    ok(spin_video_times(path, &times, &n) == SPIN_OK && n == FRAMES, "a time for each frame");
    for (int64_t i = 0; i < n; i++)
        worst = larger(worst, fabs(times[i] - (double)i / FPS));
    near(worst, 0, 1e-9, "in seconds since the first");
    free(times);
    ok(spin_video_times("no/such.mp4", &times, &n) == SPIN_E_NOT_FOUND, "none without a file");
}

static void test_images(const char *path)
{
    char name[4200];
    int w = 0, h = 0, channels = 0;
    uint8_t *rgb = NULL;
    struct spin_digest digest;
    struct spin_map map = {.size = 0};

    snprintf(name, sizeof name, "%s#11", path);
    ok(spin_image_size(name, &w, &h, &channels) == SPIN_OK && w == W && h == H && channels == 3,
       "a frame is an image with a size");
    ok(spin_image_read(name, NULL, &w, &h, &rgb) == SPIN_OK && off_by(rgb, 11) < 6,
       "and with pixels");
    free(rgb);
    snprintf(name, sizeof name, "%s#%d", path, FRAMES);
    ok(spin_image_read(name, NULL, &w, &h, &rgb) == SPIN_E_NOT_FOUND && !rgb &&
           strstr(spin_last_error(), "only 0 to 20"),
       "there is none after the last");
    ok(spin_image_check(name, &w, &h, &digest) == SPIN_E_NOT_FOUND &&
           strstr(spin_last_error(), "only 0 to 20"),
       "which a look tells as well");
    snprintf(name, sizeof name, "%s#0", path);
    ok(spin_image_check(name, &w, &h, &digest) == SPIN_OK && w == W && h == H &&
           spin_map_open(path, &map) == SPIN_OK && digest.size == map.size &&
           digest.crc == spin_crc32(0, map.data, map.size),
       "a frame's digest is that of its video");
    spin_map_close(&map);
}

static void test_damage(const char *path)
{
    struct spin_map map;
    char name[4200];
    int w, h, n_read = 0, n_refused = 0;
    int64_t n = 0;

    if (spin_map_open(path, &map) != SPIN_OK)
        exit(1);
    for (size_t size = 0; size < map.size; size += map.size / 40 + 1) {
        uint8_t *rgb = NULL;

        /* names come again with other contents: what is known of a file goes when it changes */
        if (spin_video_read(check_truncated(path, size), FRAMES - 1, NULL, &w, &h, &rgb) == SPIN_OK)
            n_read++;
        else
            n_refused += strchr(spin_last_error(), '\n') == NULL;
        free(rgb);
    }
    spin_map_close(&map);
    ok(n_refused > 30 && n_read < 5, "files cut short are survived (%d read, %d refused)", n_read,
       n_refused);
    ok(spin_video_info("no/such.mp4", &w, &h, &n, NULL) == SPIN_E_NOT_FOUND &&
           strstr(spin_last_error(), "no/such.mp4"),
       "a file that is not there");
    snprintf(name, sizeof name, "%s/list.mp4", check_folder());
    {
        FILE *file = fopen(name, "w");

        fprintf(file, "ffconcat version 1.0\nfile '%s'\n", path);
        fclose(file);
    }
    ok(spin_video_info(name, &w, &h, &n, NULL) == SPIN_E_MALFORMED,
       "a playlist in a video's name leads nowhere");
}

/* Changes the display matrix in the header of an MP4 to the given 2 x 2 part, row by row. */
static void set_matrix(const char *path, const int m[4])
{
    static const size_t at[4] = {0, 4, 12, 16};
    FILE *file = fopen(path, "r+b");
    char bytes[1 << 16];
    size_t n = 0;
    const char *tkhd = NULL;

    if (file && fseek(file, -(long)sizeof bytes, SEEK_END) != 0)
        rewind(file);
    n = file ? fread(bytes, 1, sizeof bytes, file) : 0;
    for (size_t i = 0; i + 80 < n && !tkhd; i++)
        tkhd = memcmp(bytes + i, "tkhd", 4) == 0 ? bytes + i : NULL;
    for (int i = 0; tkhd && i < 4; i++) {
        uint32_t value = (uint32_t)m[i] << 16;
        const uint8_t big[4] = {(uint8_t)(value >> 24), (uint8_t)(value >> 16), 0, 0};

        fseek(file, ftell(file) - (long)n + (tkhd - bytes) + 44 + (long)at[i], SEEK_SET);
        fwrite(big, 1, 4, file);
        fseek(file, 0, SEEK_END);
    }
    if (file)
        fclose(file);
    ok(tkhd != NULL, "the header of the video is changed");
}

/* Reads frame 0 and returns whether it has the size and its pixel x, y is white: in the video as it
 * is stored, a white square of 8 pixels is in the upper left corner. */
static bool has_square(const char *path, int width, int height, int x, int y)
{
    int w = 0, h = 0, w_info = 0, h_info = 0;
    int64_t n;
    uint8_t *rgb = NULL;
    bool good = spin_video_read(path, 0, NULL, &w, &h, &rgb) == SPIN_OK && w == width &&
                h == height && spin_video_info(path, &w_info, &h_info, &n, NULL) == SPIN_OK &&
                w_info == width && h_info == height;

    for (int dy = -2; dy <= 2 && good; dy++)
        for (int dx = -2; dx <= 2 && good; dx++)
            good = rgb[3 * ((y + dy) * w + x + dx)] > 200;
    free(rgb);
    return good;
}

static void test_rotation(const char *path)
{
    static const struct {
        int m[4], w, h, x, y;
        const char *what;
    } cases[] = {
        {{1, 0, 0, 1}, W, H, 4, 4, "upright"},
        {{0, 1, -1, 0}, H, W, H - 5, 4, "turned by 90 degrees"},
        {{-1, 0, 0, -1}, W, H, W - 5, H - 5, "turned by 180 degrees"},
        {{0, -1, 1, 0}, H, W, 4, W - 5, "turned by 270 degrees"},
        {{-1, 0, 0, 1}, W, H, W - 5, 4, "mirrored"},
    };
    int w, h;
    int64_t n;

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        set_matrix(path, cases[i].m);
        ok(has_square(path, cases[i].w, cases[i].h, cases[i].x, cases[i].y),
           "a video is shown %s as its header says", cases[i].what);
    }
    set_matrix(path, (const int[4]){1, 1, -1, 1});
    ok(spin_video_info(path, &w, &h, &n, NULL) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "multiple of 90"),
       "other angles are refused");
    set_matrix(path, (const int[4]){1, 0, 0, 1});
}

TAP_MAIN
{
    const char *build = getenv("SPIN_BUILD");
    char path[4100], command[9000];

    test_names();
    if (spin_video_start() != SPIN_OK) {
        ok(strstr(spin_last_error(), "libavformat-dev") != NULL,
           "without FFmpeg it says what to do");
        skip("videos", "built without FFmpeg");
        return;
    }
    snprintf(path, sizeof path, "%s/made.mp4", check_folder());
    snprintf(command, sizeof command, "'%s/tests/tools/make-video' '%s' %d %d %d %d",
             build ? build : "build/release", path, FRAMES, W, H, SEED);
    if (system(command) != 0) {
        skip("videos", "tests/tools/make-video is not built, or cannot encode");
        return;
    }
    {
        int w = 0, h = 0;
        int64_t n = 0;

        ok(spin_video_info(path, &w, &h, &n, NULL) == SPIN_OK && w == W && h == H && n == FRAMES,
           "size and number of frames");
    }
    test_order(path);
    test_passing(path);
    test_two_at_once(path);
    test_times(path);
    test_images(path);
    test_rotation(path);
    test_damage(path);
}
