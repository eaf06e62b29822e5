/* omg4: times, and malformed files: in the xz, and in the pickle inside it.
 * K: omg4 import threads */
#include "tests/importers/edits.h"

#include <lzma.h>

#include "io/compress.h"

#define FROM "omg4"

static void test_times(const char *folder)
{
    const char *odd[] = {"time-duration", "10", NULL};
    const char *absent[] = {"config", "no.yaml", NULL};
    struct spin_splats a = {0}, b = {0};
    struct run run;

    ok(run_open(FROM, folder, &run) == SPIN_OK && run.sequence.sh_degree == 3 &&
           run.sequence.time_first == 0 && run.sequence.time_last == 10 &&
           strstr(run.sequence.notes, "assumed 0,10") &&
           strstr(run.sequence.notes, "opacities depend on this range"),
       "without a YAML the range of times is guessed, and the notes say so");
    ok(run.importer->frame(run.self, 0, 3, run.sequence.columns, &a) == SPIN_OK &&
           run.importer->frame(run.self, 0, 8, run.sequence.columns, &b) == SPIN_OK &&
           run.importer->frame(run.self, 0, 3, run.sequence.columns, &b) == SPIN_OK && a.n == b.n &&
           !memcmp(a.sh, b.sh, 192 * a.n) && !memcmp(a.logit_opacities, b.logit_opacities, 4 * a.n),
       "a time gives the same bits however often it is asked for");
    ok(run.importer->frame(run.self, 0, 3, SPIN_COL_MEANS, &b) == SPIN_OK && a.n == b.n &&
           !memcmp(a.means, b.means, 12 * a.n),
       "positions alone are the same positions");
    run_close(&run);
    fails_with(FROM, folder, odd, "expected A,B", "half a range");
    fails_with(FROM, folder, absent, "--config: cannot open '", "a YAML that is not there");
    ok(!strstr(spin_last_error(), "comp.xz"), "is not the checkpoint's fault");
    spin_splats_free(&a);
    spin_splats_free(&b);
}

/* ---- Malformed files --------------------------------------------------------------------------
 */

static const char *write_bytes(const char *path, const void *bytes, size_t n)
{
    FILE *file = fopen(path, "wb");

    if (!file || fwrite(bytes, 1, n, file) != n || fclose(file) != 0)
        exit(1);
    return path;
}

static const char *write_xz(const char *path, const unsigned char *bytes, size_t n)
{
    size_t room = lzma_stream_buffer_bound(n), used = 0;
    unsigned char *packed = malloc(room);

    if (!packed || lzma_easy_buffer_encode(0, LZMA_CHECK_CRC32, NULL, bytes, n, packed, &used,
                                           room) != LZMA_OK)
        exit(1);
    write_bytes(path, packed, used);
    free(packed);
    return path;
}

/* A copy of the pickle with the first `from` as `to` (of the same length). */
static void fails_changed(const unsigned char *bytes, size_t n, const char *from, const char *to,
                          size_t length, const char *word, const char *what)
{
    unsigned char *copy = malloc(n), *at;
    const char *path = path_in(new_folder(), "comp.xz");

    memcpy(copy, bytes, n);
    at = memmem(copy, n, from, length);
    if (!at) {
        ok(0, "%s: there is nothing to change", what);
    } else {
        memcpy(at, to, length);
        fails(FROM, write_xz(path, copy, n), word, what);
        ok(strstr(spin_last_error(), path) != NULL, "  and the file is named");
    }
    free(copy);
}

static void test_changed(const unsigned char *bytes, size_t n)
{
    fails_changed(bytes, n, "MLP_dc", "MLP_dx", 6, "'MLP_dc' is missing", "a network is missing");
    fails_changed(bytes, n, "M\0\x24\x85", "M\0\x22\x85", 4, "does not fit",
                  "a network of another size");
    fails_changed(bytes, n, "scale_index", "scale_indey", 11, "'scale_index'",
                  "an index is missing");
    fails_changed(bytes, n, "\x8c\x03xyz", "\x8c\x03xyy", 5, "'xyz'", "positions are missing");
    fails_changed(bytes, n, "_EndOfFileSymbol", "_EndOfFileSymbox", 16, "_EndOfFileSymbox",
                  "a class that is not on the list");
    fails_changed(bytes, n, "M\x40\x01K\x03", "M\x3f\x01K\x03", 5, NULL,
                  "fewer positions than the others have");
}

/* Changes single bytes of the pickle, with a valid checksum. */
static void test_flips(const unsigned char *bytes, size_t n)
{
    const char *path = path_in(new_folder(), "comp.xz");
    unsigned char *copy = malloc(n);
    int n_read = 0;

    memcpy(copy, bytes, n);
    for (size_t i = 0; i < 150; i++) {
        size_t at = i * 2654435761u % n;

        copy[at] ^= (unsigned char)(1 << i % 8);
        n_read += read_all(FROM, write_xz(path, copy, n)) == SPIN_OK;
        copy[at] = bytes[at];
    }
    ok(n_read < 150, "150 damaged pickles are survived (%d can be read)", n_read);
    for (size_t i = 1; i < 60; i++)
        n_read -= read_all(FROM, write_xz(path, copy, n * i / 60)) == SPIN_OK ? 1000 : 0;
    ok(n_read >= 0, "no truncation of the pickle can be read");
    free(copy);
}

static void test_xz(const char *file)
{
    const char *folder = new_folder(), *path = path_in(folder, "comp.xz");
    unsigned char *bytes = NULL, *zeros = calloc(1, 2u << 20);
    size_t n = 0;

    fails(FROM, write_bytes(path, "not an xz file at all", 21), "not an xz file", "no xz");
    fails(FROM, write_bytes(path, "", 0), path, "an empty file");
    fails(FROM, write_xz(path, (const unsigned char *)"hello", 5), path, "an xz of something else");
    ok(spin_xz_load(write_xz(path, zeros, 2u << 20), (2u << 20) - 1, &bytes, &n) ==
               SPIN_E_UNSUPPORTED &&
           strstr(spin_last_error(), "unpacks to more than") && !bytes,
       "what unpacks to more than the bound is refused");
    ok(spin_xz_load(path, 2u << 20, &bytes, &n) == SPIN_OK && n == 2u << 20 &&
           !memcmp(bytes, zeros, n),
       "what fits exactly is not");
    free(bytes);
    free(zeros);
    fails(FROM, folder, path, "a folder with that file");
    fails(FROM, new_folder(), "contains no comp.xz", "an empty folder");
    /* Recompressed: the dictionary is many times the size of the file, and each reading
     * allocates one. */
    if (spin_xz_load(file, 1u << 30, &bytes, &n) != SPIN_OK)
        exit(1);
    write_xz(path, bytes, n);
    free(bytes);
    ok(read_truncations(FROM, path) == 0, "no truncation of the file can be read");
    survive_flips(FROM, path);
}

TAP_MAIN
{
    const char *root = check_fixture("omg4");
    unsigned char *bytes = NULL;
    size_t n = 0;

    spin_log_set_level(-2);
    if (!root) {
        skip("omg4 fixtures", "there are none here");
        return;
    }
    test_times(path_in(root, "comp_xz"));
    test_xz(path_in(root, "ftgs_xz/ftgs.xz"));
    if (spin_xz_load(path_in(root, "comp_xz/comp.xz"), 1u << 30, &bytes, &n) != SPIN_OK) {
        ok(0, "unpacks comp.xz: %s", spin_last_error());
        return;
    }
    test_changed(bytes, n);
    test_flips(bytes, n);
    free(bytes);
}
