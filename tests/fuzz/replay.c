/* A plain main for the fuzz targets, so that saved finds are tests in every build.
 *
 * Arguments are files and folders of files; each file is fed to the target once, in an exactly
 * sized block. What fails, fails by crashing. One TAP line per file; without files one line says
 * so. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "io/file.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n);

static int count, failed;

/* Read as it is: the library would not open all that is hostile. */
static void replay_file(const char *path)
{
    FILE *file = fopen(path, "rb");
    long n = file && fseek(file, 0, SEEK_END) == 0 ? ftell(file) : -1;
    uint8_t *data = n < 0 ? NULL : malloc((size_t)n + (n == 0));
    bool whole =
        data && fseek(file, 0, SEEK_SET) == 0 && fread(data, 1, (size_t)n, file) == (size_t)n;

    count++;
    failed += !whole;
    if (whole)
        LLVMFuzzerTestOneInput(data, (size_t)n);
    printf(whole ? "ok %d - survives '%s'\n" : "not ok %d - cannot read '%s'\n", count,
           spin_path_name(path));
    fflush(stdout);
    free(data);
    if (file)
        fclose(file);
}

static void replay(const char *path)
{
    char **names, *child;
    size_t n;

    if (!spin_path_is_folder(path)) {
        replay_file(path);
        return;
    }
    if (spin_folder_list(path, &names, &n) != SPIN_OK)
        return;
    for (size_t i = 0; i < n; i++) {
        if (spin_path_join(path, names[i], &child) == SPIN_OK)
            replay(child);
        free(child);
    }
    spin_folder_list_free(names);
}

int main(int argc, char **argv)
{
    for (int i = 1; i < argc; i++)
        replay(argv[i]);
    if (count == 0)
        printf("ok %d - no saved finds\n", ++count);
    printf("1..%d\n", count);
    return failed ? 1 : 0;
}
