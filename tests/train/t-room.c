/* A disk that is too small is reported before the first iteration.
 * K: retrain outputs */
#include <errno.h>
#include <fcntl.h>
#include <sys/statvfs.h>

#include "spin_run.h"
#include "io/file.h"
#include "run/run.h"
#include "tests/check.h"
#include "tests/tap.h"

/* Replaces the C library's function. */
static uint64_t n_free;

int statvfs(const char *restrict path, struct statvfs *restrict fs)
{
    (void)path;
    *fs = (struct statvfs){.f_bavail = n_free, .f_frsize = 1};
    return 0;
}

/* Available memory; 0: that of the machine. */
static size_t n_memory;

FILE *fopen(const char *restrict path, const char *restrict mode)
{
    static char text[64];
    int fd;

    if (strcmp(path, "/proc/meminfo") == 0 && n_memory > 0) {
        snprintf(text, sizeof text, "MemAvailable: %zu kB\n", n_memory / 1024);
        return fmemopen(text, strlen(text), "r");
    }
    fd = open(path, mode[0] == 'r' ? O_RDONLY : O_WRONLY | O_CREAT | O_TRUNC, 0666);
    return fd >= 0 ? fdopen(fd, mode) : NULL;
}

static uint64_t n_reserve = UINT64_MAX;

int fallocate(int fd, int mode, off_t first, off_t n)
{
    (void)fd, (void)mode, (void)first;
    errno = ENOSPC;
    return (uint64_t)n <= n_reserve ? 0 : -1;
}

static struct spin_digest imprint_of(const char *path)
{
    struct spin_map map;
    struct spin_digest digest = {0};

    if (spin_map_open(path, &map) != SPIN_OK)
        return digest;
    digest = spin_map_digest(&map);
    spin_map_close(&map);
    return digest;
}

/* Splats that outgrow the disk: the training stops while its checkpoint fits, and resumes on a
 * larger disk. */
static void test_growth(struct spin_retrain_options o, const char *folder)
{
    struct spin_retrain_report report;
    struct spin_digest want, got;
    char whole[320], out[320], part[330];

    snprintf(whole, sizeof whole, "%s/whole.spin", folder);
    snprintf(out, sizeof out, "%s/grown.spin", folder);
    snprintf(part, sizeof part, "%s.part", out);
    o.iterations = 60;
    o.densify_every = 10;
    o.backdrop = SPIN_BACKDROP_OFF;
    o.output = whole;
    ok(spin_train(&o, &report) == SPIN_OK, "an unbroken training");
    o.output = out;
    n_reserve = 6000000;
    ok(spin_train(&o, &report) == SPIN_E_IO &&
           strstr(spin_last_error(), "the checkpoint may grow to ") &&
           strstr(spin_last_error(), part) && strstr(spin_last_error(), "continue with --resume"),
       "stops before the splats outgrow the disk");
    ok(spin_path_exists(part), "and keeps its state");
    o.resume = true;
    ok(spin_train(&o, &report) == SPIN_E_IO && spin_path_exists(part), "which stays");
    n_reserve = UINT64_MAX;
    ok(spin_train(&o, &report) == SPIN_OK, "with more room it goes on: %s", spin_last_error());
    want = imprint_of(whole);
    got = imprint_of(out);
    ok(want.size > 0 && got.size == want.size && got.crc == want.crc, "to the same bytes");
}

/* Frames that do not fit into memory need space on the disk beside the other files. */
static void test_temporary_files(struct spin_retrain_options o)
{
    struct spin_retrain_report whole, report = {0};

    o.dry_run = true;
    ok(spin_train(&o, &whole) == SPIN_OK && whole.bytes_scratch == 0, "fits into memory");
    n_memory = whole.bytes_needed; /* includes images that need not be kept */
    while (spin_train(&o, &report) == SPIN_OK && report.bytes_scratch == 0 && n_memory > 1 << 20)
        n_memory -= 1 << 18;
    ok(report.bytes_scratch > 1 << 20 && report.bytes_needed < n_memory &&
           report.bytes_disk == n_free,
       "with less memory, frames are kept in temporary files: %zu bytes", report.bytes_scratch);
    o.dry_run = false;
    n_free = report.bytes_scratch / 2;
    ok(spin_train(&o, &report) == SPIN_E_IO &&
           strstr(spin_last_error(), "the state of the training needs about ") &&
           strstr(spin_last_error(), " for checkpoint and output, but the disk has ") &&
           strstr(spin_last_error(), "free: free some space, or give a folder on another disk "
                                     "with --scratch") &&
           !spin_path_exists(o.output),
       "which do not fit on the disk: %s", spin_last_error());
    o.scratch = "off";
    ok(spin_train(&o, &report) == SPIN_E_MEMORY && report.bytes_scratch == 0,
       "--scratch off: the memory is insufficient");
    n_memory = 0;
    n_free = (uint64_t)1 << 40;
}
TAP_MAIN
{
    struct spin_import_options in = {.from = "d3dgs"};
    struct spin_retrain_options o;
    struct spin_retrain_report report;
    char bundle[300], output[300];
    const char *clip = check_fixture("court-mini"), *folder = check_folder();

    snprintf(bundle, sizeof bundle, "%s/in.spin", folder);
    snprintf(output, sizeof output, "%s/out.spin", folder);
    n_free = (uint64_t)1 << 40;
    in.input = in.data = clip;
    in.output = bundle;
    if (!ok(clip && spin_import(&in, NULL) == SPIN_OK, "imports the clip"))
        return;
    spin_set_verbosity(-1);
    spin_retrain_preset("paper", &o);
    o.input = bundle;
    o.output = output;
    o.image_scale = 0.1;
    o.iterations = 1;
    o.levels = 2;
    o.hash_log2 = 8;
    o.finest_resolution[0] = o.finest_resolution[1] = o.finest_resolution[2] = 32;
    o.hidden = 8;
    o.n_threads = 1;
    n_free = 4 * 3 * sizeof(float) * 2940 * 6; /* the positions, but no network */
    ok(spin_train(&o, &report) == SPIN_E_IO && strstr(spin_last_error(), output) &&
           strstr(spin_last_error(), "the disk has 847 kB free"),
       "too small a disk is an error");
    ok(!spin_path_exists(output) && report.iterations == 1 && report.seconds == 0,
       "before the first step");
    n_free += 1 << 20;
    ok(spin_train(&o, &report) == SPIN_OK && spin_path_exists(output), "with more it goes on");

    spin_retrain_preset("quick", &o); /* no table, and splats share attributes */
    o.input = bundle;
    o.output = output;
    o.image_scale = 0.1;
    o.iterations = 1;
    o.force = true;
    n_free = 4 * (3 + 11) * sizeof(float) * 2940;
    ok(spin_train(&o, &report) == SPIN_OK, "without a network one frame's values are enough");
    n_free--;
    ok(spin_train(&o, &report) == SPIN_E_IO, "and less is not");
    n_free = (uint64_t)1 << 40;
    test_growth(o, folder);
    remove(output);
    o.force = false;
    test_temporary_files(o);
}
