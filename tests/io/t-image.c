/* K: image datasets threads */
#include <pthread.h>
#include <unistd.h>

#include "base/err.h"
#include "base/mem.h"
#include "io/image.h"
#include "tests/check.h"
#include "tests/tap.h"

/* OpenImageIO's own locks are not compiled for ThreadSanitizer, which does not see them. */
const char *__tsan_default_suppressions(void);
const char *__tsan_default_suppressions(void) { return "race:libOpenImageIO\n"; }

/* Small PNGs of every kind, made for this test: 1-bit grey, grey with alpha, RGBA, 16-bit RGB, a
 * palette of three, one that says 60000 x 60000, and RGBA with a gamma of 1 / 2.2. */
static const unsigned char grey1[] = {
    0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44,
    0x52, 0x00, 0x00, 0x00, 0x09, 0x00, 0x00, 0x00, 0x02, 0x01, 0x00, 0x00, 0x00, 0x00, 0xa2,
    0x2d, 0xcb, 0x7e, 0x00, 0x00, 0x00, 0x0e, 0x49, 0x44, 0x41, 0x54, 0x78, 0xda, 0x63, 0x58,
    0xd5, 0xc0, 0x10, 0xca, 0x00, 0x00, 0x06, 0x02, 0x01, 0x80, 0x9f, 0x75, 0xd7, 0x13, 0x00,
    0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82,
};
static const unsigned char grey_alpha[] = {
    0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48,
    0x44, 0x52, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01, 0x08, 0x04, 0x00, 0x00,
    0x00, 0x5e, 0x2b, 0xb7, 0x01, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x44, 0x41, 0x54, 0x78,
    0xda, 0x63, 0x38, 0xf1, 0xff, 0x84, 0x31, 0x00, 0x07, 0xe5, 0x02, 0xc3, 0xb0, 0x85,
    0x1e, 0xc7, 0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82,
};
static const unsigned char rgba[] = {
    0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44,
    0x52, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01, 0x08, 0x06, 0x00, 0x00, 0x00, 0xf4,
    0x22, 0x7f, 0x8a, 0x00, 0x00, 0x00, 0x11, 0x49, 0x44, 0x41, 0x54, 0x78, 0xda, 0x63, 0xf8,
    0x9f, 0xc2, 0xd0, 0xc0, 0x25, 0x22, 0xc7, 0x00, 0x00, 0x0d, 0xdd, 0x02, 0x20, 0x66, 0x8f,
    0x64, 0xd2, 0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82,
};
static const unsigned char rgb16[] = {
    0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44, 0x52,
    0x00, 0x00, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01, 0x10, 0x02, 0x00, 0x00, 0x00, 0x2b, 0xd0, 0x34,
    0x9e, 0x00, 0x00, 0x00, 0x15, 0x49, 0x44, 0x41, 0x54, 0x78, 0xda, 0x63, 0x60, 0x60, 0xf8, 0xff,
    0xbf, 0x81, 0x81, 0xa1, 0x81, 0xa1, 0x91, 0x91, 0x11, 0x00, 0x1b, 0x00, 0x03, 0x82, 0x9e, 0x0b,
    0xe0, 0x1b, 0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82,
};
static const unsigned char palette[] = {
    0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44,
    0x52, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01, 0x02, 0x03, 0x00, 0x00, 0x00, 0x89,
    0x4c, 0x97, 0x19, 0x00, 0x00, 0x00, 0x09, 0x50, 0x4c, 0x54, 0x45, 0x01, 0x02, 0x03, 0x04,
    0x05, 0x06, 0x07, 0x08, 0x09, 0x25, 0x85, 0x56, 0xf0, 0x00, 0x00, 0x00, 0x0a, 0x49, 0x44,
    0x41, 0x54, 0x78, 0xda, 0x63, 0x50, 0x00, 0x00, 0x00, 0x22, 0x00, 0x21, 0x4e, 0x67, 0x1d,
    0x86, 0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82,
};
static const unsigned char huge[] = {
    0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48,
    0x44, 0x52, 0x00, 0x00, 0xea, 0x60, 0x00, 0x00, 0xea, 0x60, 0x08, 0x02, 0x00, 0x00,
    0x00, 0x0f, 0xb0, 0xe2, 0x15, 0x00, 0x00, 0x00, 0x09, 0x49, 0x44, 0x41, 0x54, 0x78,
    0xda, 0x63, 0x00, 0x00, 0x00, 0x01, 0x00, 0x01, 0xb1, 0x0d, 0xb6, 0x93, 0x00, 0x00,
    0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82,
};
static const unsigned char gama[] = {
    0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44,
    0x52, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01, 0x08, 0x06, 0x00, 0x00, 0x00, 0xf4,
    0x22, 0x7f, 0x8a, 0x00, 0x00, 0x00, 0x04, 0x67, 0x41, 0x4d, 0x41, 0x00, 0x00, 0xb1, 0x8f,
    0x0b, 0xfc, 0x61, 0x05, 0x00, 0x00, 0x00, 0x11, 0x49, 0x44, 0x41, 0x54, 0x78, 0xda, 0x63,
    0xf8, 0x9f, 0xc2, 0xd0, 0xc0, 0x25, 0x22, 0xc7, 0x00, 0x00, 0x0d, 0xdd, 0x02, 0x20, 0x66,
    0x8f, 0x64, 0xd2, 0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82,
};

static const char *write_bytes(const char *name, const void *bytes, size_t n)
{
    static char path[4096];
    static const char *folder;
    FILE *file;

    if (!folder)
        folder = check_folder();
    snprintf(path, sizeof path, "%s/%s", folder, name);
    file = fopen(path, "wb");
    if (!file || fwrite(bytes, 1, n, file) != n)
        ok(0, "writes a temporary file");
    if (file)
        fclose(file);
    return path;
}

static void reads_over(const unsigned char *png, size_t n, const float background[3], int width,
                       int height, const uint8_t *want, const char *what)
{
    int w = 0, h = 0;
    uint8_t *rgb = NULL;
    spin_status status = spin_image_read(write_bytes("a.png", png, n), background, &w, &h, &rgb);

    if (ok(status == SPIN_OK && w == width && h == height, "reads %s", what))
        check_same_bits(rgb, want, (size_t)(3 * w * h), what);
    else
        printf("#   %s\n", status ? spin_last_error() : "another size");
    free(rgb);
}

static void reads_as(const unsigned char *png, size_t n, int width, int height, const uint8_t *want,
                     const char *what)
{
    reads_over(png, n, NULL, width, height, want, what);
}

/* The first pixel is 255 100 0 with alpha 128, the second has alpha 0: colour * alpha + background
 * * (1 - alpha) in units of 255, by hand. */
static void test_backgrounds(void)
{
    static const float white[3] = {1, 1, 1}, odd[3] = {0.5f, 0, 0.2f};
    static const uint8_t over_white[] = {255, 177, 127, 255, 255, 255};
    static const uint8_t over_odd[] = {192, 50, 25, 128, 0, 51};
    static const uint8_t wide[] = {0, 255, 128, 0, 1, 1};

    reads_over(rgba, sizeof rgba, white, 2, 1, over_white, "alpha over white");
    reads_over(gama, sizeof gama, white, 2, 1, over_white, "alpha with gamma over white");
    reads_over(rgba, sizeof rgba, odd, 2, 1, over_odd, "alpha over any colour");
    reads_over(rgb16, sizeof rgb16, white, 2, 1, wide, "what has no alpha shows no background");
}

static void test_kinds(void)
{
    uint8_t bits[54];
    static const uint8_t first[9] = {1, 0, 1, 0, 1, 0, 1, 0, 1};
    static const uint8_t grey[] = {200, 200, 200, 40, 40, 40};
    static const uint8_t over[] = {128, 50, 0, 0, 0, 0};
    static const uint8_t wide[] = {0, 255, 128, 0, 1, 1};
    static const uint8_t colours[] = {1, 2, 3, 7, 8, 9};

    for (int i = 0; i < 9; i++) {
        memset(bits + 3 * i, first[i] ? 255 : 0, 3);
        memset(bits + 27 + 3 * i, first[i] || i == 8 ? 0 : 255, 3);
    }
    reads_as(grey1, sizeof grey1, 9, 2, bits, "a 1-bit mask");
    reads_as(grey_alpha, sizeof grey_alpha, 2, 1, grey, "grey with alpha over black");
    reads_as(rgba, sizeof rgba, 2, 1, over, "colour with alpha over black");
    reads_as(gama, sizeof gama, 2, 1, over, "alpha with gamma the same way");
    reads_as(rgb16, sizeof rgb16, 2, 1, wide, "16 bits, rounded");
    reads_as(palette, sizeof palette, 2, 1, colours, "a palette");
}

/* The same pixels by either shim. What the plain one refuses is read by OpenImageIO alone, where
 * that is. */
static void test_pictures(void)
{
    static const struct {
        const char *name;
        uint32_t crc; /* 0: OpenImageIO's own way from four colours to three */
        bool refused;
    } list[] = {{"interlaced16.png", 0xb96644e7, false},
                {"palette-alpha.png", 0xbb2564f9, false},
                {"grey16-key.png", 0xf7948b61, false},
                {"grey.jpg", 0xe9cd592e, false},
                {"turned.jpg", 0x5ae5e91a, false},
                {"stray.jpg", 0xe9cd592e, true},
                {"cmyk.jpg", 0, true}};

    for (size_t i = 0; i < sizeof list / sizeof *list; i++) {
        char path[64];
        int w = 0, h = 0, width = 0, height = 0, channels;
        uint8_t *rgb = NULL;
        spin_status status, sized;

        snprintf(path, sizeof path, "fixtures/pictures/%s", list[i].name);
        status = spin_image_read(path, NULL, &w, &h, &rgb);
        sized = spin_image_size(path, &width, &height, &channels);
        if (getenv("SPIN_IMAGE_SHIM") && list[i].refused)
            ok(status == SPIN_E_MALFORMED && strstr(spin_last_error(), list[i].name),
               "%s is refused without OpenImageIO", list[i].name);
        else if (!ok(status == SPIN_OK && sized == SPIN_OK && w == width && h == height &&
                         (!list[i].crc || spin_crc32(0, rgb, (size_t)(3 * w * h)) == list[i].crc),
                     "the pixels of %s", list[i].name))
            printf("#   %08x %s\n", rgb ? spin_crc32(0, rgb, (size_t)(3 * w * h)) : 0,
                   status || sized ? spin_last_error() : "");
        free(rgb);
    }
}

static void test_size(void)
{
    int w = 0, h = 0, channels = 0;
    uint8_t *rgb = NULL;
    const char *path = write_bytes("rgba.jpg", rgba, sizeof rgba);

    ok(spin_image_size(path, &w, &h, &channels) == SPIN_OK && w == 2 && h == 1 && channels == 4,
       "size without decoding, whatever the file is called");
    path = write_bytes("huge.png", huge, sizeof huge);
    ok(spin_image_read(path, NULL, &w, &h, &rgb) == SPIN_E_UNSUPPORTED && !rgb &&
           strstr(spin_last_error(), "60000 x 60000") && strstr(spin_last_error(), "huge.png"),
       "refuses a huge image by its header");
}

static void fails(const char *path, spin_status code, const char *what)
{
    int w, h;
    uint8_t *rgb = NULL;
    spin_status status = spin_image_read(path, NULL, &w, &h, &rgb);

    if (!ok(status == code && !rgb && strstr(spin_last_error(), spin_path_name(path)), "%s", what))
        printf("#   status %d, '%s'\n", status, status ? spin_last_error() : "");
    free(rgb);
}

static void test_bad_files(void)
{
    fails("no/such/image.png", SPIN_E_NOT_FOUND, "a missing file");
    fails(check_folder(), SPIN_E_IO, "a folder");
    fails(write_bytes("empty.png", "", 0), SPIN_E_MALFORMED, "an empty file");
    fails(write_bytes("text.jpg", "hello, image\n", 13),
          getenv("SPIN_IMAGE_SHIM") ? SPIN_E_UNSUPPORTED : SPIN_E_MALFORMED, "text called .jpg");
    for (size_t n = 1; n < sizeof rgb16 - 16; n += 9) {
        int w, h;
        uint8_t *rgb = NULL;

        if (spin_image_read(write_bytes("cut.png", rgb16, n), NULL, &w, &h, &rgb) == SPIN_OK) {
            ok(0, "a PNG cut to %zu bytes is refused", n);
            free(rgb);
            return;
        }
    }
    ok(1, "a PNG is refused at shorter lengths");
}

static void test_truncated_jpeg(void)
{
    const char *path = check_fixture("datasets/panoptic_mini/ims/3/000003.jpg");
    struct spin_map map;
    size_t n_bytes, n_read = 0;

    if (!path || spin_map_open(path, &map) != SPIN_OK) {
        skip("truncated jpg", "no fixture datasets/panoptic_mini");
        return;
    }
    n_bytes = map.size;
    spin_map_close(&map);
    fails(check_truncated(path, n_bytes / 2), SPIN_E_MALFORMED, "half a JPEG");
    for (size_t n = 1; n < n_bytes; n += 13) {
        int w, h;
        uint8_t *rgb = NULL;

        n_read += spin_image_read(check_truncated(path, n), NULL, &w, &h, &rgb) == SPIN_OK;
        free(rgb);
    }
    fails(check_truncated(path, n_bytes - 1), SPIN_E_MALFORMED, "a JPEG one byte short");
    ok(n_read == 0, "a JPEG is refused at shorter lengths");
}

static void test_look(void)
{
    struct spin_digest a, b, c;
    unsigned char changed[sizeof rgb16];
    int w = 0, h = 0;
    char path[4096];

    snprintf(path, sizeof path, "%s", write_bytes("look.png", rgb16, sizeof rgb16));
    ok(spin_image_check(path, &w, &h, &a) == SPIN_OK && w == 2 && h == 1 &&
           a.size == sizeof rgb16 && a.crc == spin_crc32(0, rgb16, sizeof rgb16),
       "a look has the size and the digest");
    memcpy(changed, rgb16, sizeof changed);
    changed[45] ^= 1; /* in the pixels: a look does not decode them */
    ok(spin_image_check(write_bytes("look.png", changed, sizeof changed), &w, &h, &b) == SPIN_OK &&
           a.size == b.size && a.crc != b.crc,
       "another bit, another digest");
    ok(spin_image_check(write_bytes("other.png", rgb16, sizeof rgb16), &w, &h, &c) == SPIN_OK &&
           a.size == c.size && a.crc == c.crc,
       "another name, the same digest");
    for (size_t n = 0; n < sizeof rgb16 - 4; n++) /* without the CRC of IEND it can be read */
        if (spin_image_check(write_bytes("cut.png", rgb16, n), &w, &h, &a) == SPIN_OK) {
            ok(0, "a look refuses a PNG cut to %zu bytes", n);
            return;
        }
    ok(strstr(spin_last_error(), "cut.png") != NULL,
       "a look refuses a PNG cut anywhere, and names it");
    ok(spin_image_check(write_bytes("huge.png", huge, sizeof huge), &w, &h, &a) ==
           SPIN_E_UNSUPPORTED,
       "and one that is too large");
    ok(spin_image_check("no/such/image.png", &w, &h, &a) == SPIN_E_NOT_FOUND, "and a missing one");
}

static void test_look_at_jpeg(void)
{
    const char *path = check_fixture("court-mini/ims/0/000009.jpg");
    struct spin_digest digest;
    struct spin_map map;
    int w, h, n_good = 0;

    if (!path || spin_map_open(path, &map) != SPIN_OK) {
        ok(0, "there is the fixture court-mini");
        return;
    }
    ok(spin_image_check(path, &w, &h, &digest) == SPIN_OK && digest.size == map.size,
       "looks at a JPEG");
    for (size_t n = 1; n < map.size; n += n < map.size - 40 ? 97 : 1)
        n_good += spin_image_check(check_truncated(path, n), &w, &h, &digest) == SPIN_OK;
    ok(n_good == 0, "and refuses it cut anywhere");
    spin_map_close(&map);
}

/* The frame of a JPEG asks for a table that is not there: nothing is decoded, and a look sees it.
 */
static void test_lost_table(void)
{
    struct spin_digest digest;
    struct spin_map map;
    unsigned char *bytes = NULL, *frame;
    int w, h;

    if (spin_map_open("fixtures/pictures/grey.jpg", &map) == SPIN_OK) {
        bytes = memcpy(malloc(map.size), map.data, map.size);
        frame = memmem(bytes, map.size, "\xff\xc0", 2);
        frame[12] = 3;
        ok(spin_image_check(write_bytes("lost.jpg", bytes, map.size), &w, &h, &digest) ==
                   SPIN_E_MALFORMED &&
               strstr(spin_last_error(), "lost.jpg"),
           "a look refuses a JPEG without one of its tables");
        spin_map_close(&map);
    }
    ok(bytes != NULL, "there are the fixtures pictures/");
    free(bytes);
}

/* Mean colours of the test cameras as the method's own reader sees them; 0.004: JPEG decoders may
 * differ by a level (the fixture's manifest). */
static void test_means(void)
{
    static const int cameras[] = {0, 10};
    const char *path = check_fixture("datasets/panoptic_mini/expected.npz");
    struct spin_npz npz;
    struct spin_array a;
    double *want, worst = 0;

    if (!path || spin_npz_open(path, &npz) != SPIN_OK) {
        skip("mean colours", "no fixture datasets/panoptic_mini");
        return;
    }
    want = check_load(&npz, "test_mean_rgb", &a);
    for (uint64_t t = 0; want && t < a.shape[0]; t++) {
        for (size_t cam = 0; cam < 2; cam++) {
            char name[128];
            int w = 0, h = 0;
            uint8_t *rgb = NULL;
            double sum[3] = {0};

            snprintf(name, sizeof name, "datasets/panoptic_mini/ims/%d/%06d.jpg", cameras[cam],
                     (int)t);
            if (!check_fixture(name) ||
                spin_image_read(check_fixture(name), NULL, &w, &h, &rgb) != SPIN_OK) {
                ok(0, "reads %s", name);
                continue;
            }
            for (int i = 0; i < 3 * w * h; i++)
                sum[i % 3] += rgb[i] / 255.0;
            for (int c = 0; c < 3; c++)
                worst = larger(worst, fabs(sum[c] / (w * h) - want[(t * 2 + cam) * 3 + (size_t)c]));
            free(rgb);
        }
    }
    near(worst, 0, 0.004, "mean colours of twelve JPEGs");
    free(want);
    spin_npz_close(&npz);
}

static void test_round_trip(void)
{
    enum { W = 37, H = 11 };
    uint8_t pixels[3 * W * H], *rgb = NULL;
    const char *folder = check_folder();
    char path[4096], **names = NULL;
    int w = 0, h = 0;
    size_t n = 0;

    for (int i = 0; i < 3 * W * H; i++)
        pixels[i] = (uint8_t)(i * 37 + i / 7);
    snprintf(path, sizeof path, "%s/out.png", folder);
    ok(spin_image_write(path, W, H, pixels, false) == SPIN_OK, "writes a PNG");
    ok(spin_image_write(path, W, H, pixels, false) == SPIN_OK, "writes it again");
    if (ok(spin_image_read(path, NULL, &w, &h, &rgb) == SPIN_OK && w == W && h == H,
           "reads it back"))
        check_same_bits(rgb, pixels, sizeof pixels, "the same pixels");
    free(rgb);
    ok(spin_folder_list(folder, &names, &n) == SPIN_OK && n == 1, "leaves nothing beside it");
    spin_folder_list_free(names);
    ok(spin_image_write("no/such/folder/x.png", W, H, pixels, false) != SPIN_OK,
       "cannot write into a missing folder");
}

struct reader {
    const char *path;
    int n_good;
};

static void *read_often(void *self)
{
    struct reader *r = self;

    for (int i = 0; i < 20; i++) {
        int w, h;
        uint8_t *rgb = NULL;

        r->n_good += spin_image_read(r->path, NULL, &w, &h, &rgb) == SPIN_OK;
        free(rgb);
    }
    return NULL;
}

static void test_threads(void)
{
    struct reader r[4];
    pthread_t thread[4];
    const char *path = write_bytes("threads.png", rgb16, sizeof rgb16);
    int n = 0;

    for (int i = 0; i < 4; i++) {
        r[i] = (struct reader){.path = path};
        pthread_create(&thread[i], NULL, read_often, &r[i]);
    }
    for (int i = 0; i < 4; i++) {
        pthread_join(thread[i], NULL);
        n += r[i].n_good;
    }
    ok(n == 80, "four threads read at a time");
}

/* This program in a process of its own: how many lines it writes, and the last of them. */
static int run_self(const char *before, const char *self, const char *arguments, char line[1024])
{
    const char *runner = getenv("SPIN_RUN"); /* of programs of another machine */
    char command[8192];
    int n_lines = 0;
    FILE *pipe;

    snprintf(command, sizeof command, "%s %s '%s' %s", before, runner ? runner : "", self,
             arguments);
    line[0] = '\0';
    pipe = popen(command, "r");
    while (pipe && fgets(line, 1024, pipe))
        n_lines++;
    if (pipe)
        pclose(pipe);
    return n_lines;
}

/* In other processes, as shims are looked for once. */
static void test_no_shim(const char *self)
{
    char arguments[4096], line[1024];

    ok(run_self("SPIN_IMAGE_SHIM=/no/such.so SPIN_IMAGE_PLAIN_SHIM=/no/such.so", self, "without",
                line) == 1 &&
           strncmp(line, "5 ", 2) == 0 && strstr(line, "spin-image-plain.so") &&
           strstr(line, "libpng-dev"),
       "without a shim: unsupported, and what to install");
    snprintf(arguments, sizeof arguments, "read '%s'", write_bytes("text.tif", "II*", 4));
    ok(run_self("SPIN_IMAGE_SHIM=/no/such.so", self, arguments, line) == 1 &&
           strncmp(line, "5 ", 2) == 0 && strstr(line, "text.tif") &&
           strstr(line, "libopenimageio"),
       "a TIFF without OpenImageIO: its name, and what to install");
}

/* In another process, whose stderr is seen: our line is all that it says, also where OpenImageIO
 * came first. */
static void test_one_line(const char *self)
{
    char arguments[8192], line[1024], text[4096];
    unsigned char broken[sizeof rgb16];

    memcpy(broken, rgb16, sizeof broken);
    broken[29] ^= 1; /* the checksum of the header */
    snprintf(text, sizeof text, "%s", write_bytes("text.tif", "II*", 4));
    snprintf(arguments, sizeof arguments, "read '%s' '%s' 2>&1", text,
             write_bytes("broken.png", broken, sizeof broken));
    ok(run_self("", self, arguments, line) == 2 && strncmp(line, "4 cannot read image", 19) == 0 &&
           strstr(line, "broken.png"),
       "a damaged PNG is one line, and nothing of libpng's own");
}

int main(int argc, char **argv)
{
    for (int i = 2; i < argc; i++) {
        int w, h, status;
        uint8_t *rgb = NULL;

        status = spin_image_read(argv[i], NULL, &w, &h, &rgb);
        printf("%d %s\n", status, spin_last_error());
        free(rgb);
    }
    if (argc > 2)
        return 0;
    if (argc > 1) {
        int status = spin_image_start();

        printf("%d %s\n", status, spin_last_error());
        return 0;
    }
    test_no_shim(argv[0]);
    if (spin_image_start() != SPIN_OK) {
        skip("images", spin_last_error());
        return tap_done();
    }
    test_threads();
    test_kinds();
    test_pictures();
    test_backgrounds();
    test_size();
    test_bad_files();
    test_one_line(argv[0]);
    test_truncated_jpeg();
    test_look();
    test_look_at_jpeg();
    test_lost_table();
    test_means();
    test_round_trip();
    return tap_done();
}
