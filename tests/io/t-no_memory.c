/* Every reader and writer of a format with each of its allocations missing once: that is told as a
 * lack of memory, not as a damaged file, and no library's own handler ends the process. K: memory
 * zip npy json png jpeg webp zstd xz gzip shim */
#include "tests/no_memory.h"

#include <limits.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/mem.h"
#include "io/compress.h"
#include "io/image.h"
#include "io/json.h"
#include "io/npy.h"
#include "io/webp.h"
#include "tests/check.h"

static char folder[] = "/tmp/spin-no-memory-XXXXXX";
static char place[128];

static const char *in_folder(const char *name)
{
    snprintf(place, sizeof place, "%s/%s", folder, name);
    return place;
}

static spin_status write_npz(void *path)
{
    SPIN_LEAVES(spin_zip_writer_abandon) struct spin_zip_writer w = {0};
    const uint64_t shape[1] = {1000};
    static float values[1000];

    SPIN_TRY(spin_zip_writer_open(path, true, &w));
    SPIN_TRY(spin_npz_write(&w, "stored", "<f4", 1, shape, values));
    SPIN_TRY(spin_npz_write_begin_deflated(&w, "deflated", "<f4", 1, shape));
    SPIN_TRY(spin_zip_member_write(&w, values, sizeof values));
    SPIN_TRY(spin_zip_member_end(&w));
    return spin_zip_writer_commit(&w);
}

static spin_status read_npz(void *path)
{
    SPIN_LEAVES(spin_npz_close) struct spin_npz npz = {0};
    struct spin_array a;

    SPIN_TRY(spin_npz_open(path, &npz));
    SPIN_TRY(spin_npz_array(&npz, "stored", true, &a));
    return spin_npz_array(&npz, "deflated", true, &a);
}

/* Numbers and texts that are longer than what Jansson reserves at first. */
static spin_status read_json(void *none)
{
    static const char text[] =
        "{\"a text that is longer than sixteen\": 123456789012345678, \"b\": [1, 2.5, \"\\u00e9\","
        " \"another text that is longer than that\", {}], \"c\": {\"d\": {\"e\": true}}}";
    SPIN_LEAVES(spin_json_freed) spin_json *json = NULL;
    int64_t number = 0;

    (void)none;
    SPIN_TRY(spin_json_parse("text", text, sizeof text - 1, &json));
    if (!spin_json_integer(spin_json_get(json, "a text that is longer than sixteen"), &number) ||
        number != 123456789012345678 || spin_json_length(spin_json_get(json, "b")) != 5)
        return spin_malformed("other values were read");
    return SPIN_OK;
}

static spin_status write_json(void *none)
{
    static const char want[] =
        "{\n  \"name\": \"court\",\n  \"list\": [1.5, \"x\"],\n  \"n\": 7\n}";
    spin_json *json = spin_json_object(), *list = spin_json_array();
    SPIN_FREED char *text = NULL;

    (void)none;
    spin_json_set_string(json, "name", "court");
    spin_json_push_number(list, 1.5);
    spin_json_push_string(list, "x");
    spin_json_set(json, "list", list);
    spin_json_set_integer(json, "n", 7);
    SPIN_TRY(spin_json_finish(json, &text));
    return strcmp(text, want) == 0 ? SPIN_OK : spin_malformed("another text: %s", text);
}

static spin_status read_image(void *path)
{
    static const float black[3];
    SPIN_FREED uint8_t *rgb = NULL;
    int width, height;

    SPIN_TRY(spin_image_size(path, &width, &height, &(int){0}));
    return spin_image_read(path, black, &width, &height, &rgb);
}

static spin_status write_png(void *none)
{
    static uint8_t rgb[3 * 64 * 64];
    SPIN_FREED unsigned char *bytes = NULL;
    size_t n;

    (void)none;
    for (size_t i = 0; i < sizeof rgb; i++)
        rgb[i] = (uint8_t)(i * i >> 3);
    return spin_image_encode(64, 64, rgb, &bytes, &n);
}

enum { SIDE = 48 };
static uint8_t rgba[4 * SIDE * SIDE];
static unsigned char *webp;
static size_t n_webp;

static spin_status write_webp(void *none)
{
    unsigned char *out = NULL;

    (void)none;
    SPIN_TRY(spin_webp_write(rgba, SIDE, SIDE, 4, &out, &n_webp));
    free(webp);
    webp = out;
    return SPIN_OK;
}

static spin_status read_webp(void *none)
{
    uint8_t back[sizeof rgba];

    (void)none;
    return spin_webp_read(webp, n_webp, SIDE, SIDE, back);
}

static unsigned char *packed;
static size_t packed_room, n_packed;

static spin_status write_zstd(void *none)
{
    (void)none;
    return spin_zstd_write(rgba, sizeof rgba, 3, &packed, &packed_room, &n_packed);
}

static spin_status read_zstd(void *none)
{
    uint8_t back[sizeof rgba];

    (void)none;
    return spin_zstd_read(packed, n_packed, back, sizeof back);
}

static spin_status write_gzip(void *none)
{
    (void)none;
    return spin_gzip_write(NULL, 6, rgba, sizeof rgba, &packed, &packed_room, &n_packed);
}

static spin_status read_gzip(void *none)
{
    uint8_t back[sizeof rgba];
    size_t n;

    (void)none;
    return spin_gzip_read(packed, n_packed, back, sizeof back, &n);
}

static spin_status read_xz(void *path)
{
    SPIN_FREED unsigned char *bytes = NULL;
    size_t n;

    return spin_xz_load(path, 1 << 20, &bytes, &n);
}

/* Loading, in processes that have not loaded anything yet. */
static void loading(spin_status (*need)(void), const char *what)
{
    int how = 0, n_failed = 0;
    bool good = true, loaded = false;

    if (!CAN_RUN_OUT) {
        skip(what, "another allocator");
        return;
    }
    for (long n = 1; good && !loaded && n < 20000; n += n < 100 ? 1 : n / 20) {
        pid_t child = fork();

        if (child == 0) {
            spin_status status;

            atomic_store(&calls_until_none, n);
            status = need();
            if (atomic_exchange(&calls_until_none, 0) > 0)
                _exit(status == SPIN_OK ? 0 : 3);
            if (status == SPIN_E_MEMORY && strstr(spin_last_error(), "memory"))
                _exit(need() == SPIN_OK ? 1 : 2);
            if (status != SPIN_OK)
                printf("# allocation %ld: %d %s\n", n, (int)status, spin_last_error());
            fflush(stdout);
            _exit(status == SPIN_OK ? 1 : 2);
        }
        good =
            child > 0 && waitpid(child, &how, 0) == child && WIFEXITED(how) && WEXITSTATUS(how) < 2;
        loaded = good && WEXITSTATUS(how) == 0;
        n_failed += !loaded;
    }
    ok(good && loaded && n_failed > 0, "%s: told as such, and loads when there is memory", what);
}

static void images(void)
{
    static const char *const names[] = {"grey.jpg", "turned.jpg", "palette-alpha.png",
                                        "interlaced16.png", "grey16-key.png"};
    char path[512];

    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        const char *found;

        snprintf(path, sizeof path, "pictures/%s", names[i]);
        found = check_fixture(path);
        snprintf(path, sizeof path, "%s", found ? found : "");
        if (found && spin_image_start() == SPIN_OK)
            without_memory(read_image, path, names[i], LONG_MAX);
        else
            skip(names[i], "no fixture, or no image library");
    }
    if (spin_image_start() == SPIN_OK)
        without_memory(write_png, NULL, "writing PNG", LONG_MAX);
}

TAP_MAIN
{
    char path[256];
    FILE *pipe;

    if (!mkdtemp(folder)) {
        ok(0, "a folder to write to");
        return;
    }
    for (size_t i = 0; i < sizeof rgba; i++)
        rgba[i] = (uint8_t)(i * i >> 5 | (i % 4 == 3 ? 255 : 0));
    loading(spin_zstd_need, "loading libzstd");
    strcpy(path, in_folder("a.npz"));
    without_memory(write_npz, path, "writing NPZ", LONG_MAX);
    without_memory(read_npz, path, "reading NPZ", LONG_MAX);
    without_memory(read_json, NULL, "reading JSON", LONG_MAX);
    without_memory(write_json, NULL, "writing JSON", LONG_MAX);
    images();
    if (spin_webp_need() == SPIN_OK) {
        /* libwebp 1.2 does not survive all of its own. */
        without_memory(write_webp, NULL, "writing WebP", 50);
        without_memory(read_webp, NULL, "reading WebP", 1);
    }
    if (spin_zstd_need() == SPIN_OK) {
        without_memory(write_zstd, NULL, "writing zstd", LONG_MAX);
        without_memory(read_zstd, NULL, "reading zstd", LONG_MAX);
    }
    without_memory(write_gzip, NULL, "writing gzip", LONG_MAX);
    without_memory(read_gzip, NULL, "reading gzip", LONG_MAX);
    snprintf(path, sizeof path, "xz -c > '%s'", in_folder("a.xz"));
    pipe = popen(path, "w");
    if (pipe && fwrite(rgba, sizeof rgba, 1, pipe) == 1 && pclose(pipe) == 0) {
        strcpy(path, place);
        without_memory(read_xz, path, "reading xz", LONG_MAX);
    } else {
        skip("reading xz", "no xz");
    }
    free(webp);
    free(packed);
    snprintf(path, sizeof path, "rm -r '%s'", folder);
    ok(system(path) == 0, "leaves nothing");
}
