/* Folders that exports fill: an export with force removes the files of the former export that it
 * did not overwrite, and no others.  K: export output folder */
#include "io/output.h"

#include <sys/stat.h>
#include <unistd.h>

#include "base/err.h"
#include "base/log.h"
#include "tests/check.h"
#include "tests/tap.h"

static char folder[500], warned[400];

static bool keep_warning(const char *line)
{
    snprintf(warned, sizeof warned, "%s", line);
    return true;
}

static const char *path_of(const char *name)
{
    static char path[700];

    snprintf(path, sizeof path, "%s/%s", folder, name);
    return path;
}

static void put_file(const char *name, const char *text)
{
    FILE *file = fopen(path_of(name), "w");

    if (!file || fputs(text, file) < 0 || fclose(file) != 0)
        exit(1);
}

/* Checks which of the files, separated by spaces, exist. */
static void check_present(const char *there, const char *gone, const char *what)
{
    char text[400], *rest = NULL, *name;
    bool good = true;

    snprintf(text, sizeof text, "%s", there);
    for (name = strtok_r(text, " ", &rest); name; name = strtok_r(NULL, " ", &rest))
        good = good && access(path_of(name), F_OK) == 0;
    snprintf(text, sizeof text, "%s", gone);
    for (name = strtok_r(text, " ", &rest); name; name = strtok_r(NULL, " ", &rest))
        good = good && access(path_of(name), F_OK) != 0;
    ok(good, "%s: %s; not %s", what, there, gone);
}

/* Exports the frames `first` to `last` - 1. */
static void export_frames(const char *format, int first, int last, bool force)
{
    struct spin_output_folder out;

    *warned = '\0';
    if (!ok(spin_output_folder_begin(folder, force, ".ply", &out) == SPIN_OK, "begins: %s",
            spin_last_error()))
        return;
    for (int f = first; f < last; f++) {
        char name[40];

        snprintf(name, sizeof name, "frame_%05d.ply", f);
        put_file(name, "new");
        spin_output_folder_add(&out, name, f);
    }
    ok(spin_output_folder_list(&out, format, false) == SPIN_OK, "lists: %s", spin_last_error());
    spin_output_folder_remove_former(&out);
    spin_output_folder_end(&out);
    ok(!out.path && !out.former && !out.list, "and ends");
}

static void test_former(void)
{
    struct spin_output_folder out;

    export_frames("ply", 3, 6, false);
    check_present("frame_00003.ply frame_00005.ply sequence.json", "frame_00006.ply",
                  "three frames");
    ok(spin_output_folder_begin(folder, false, ".ply", &out) == SPIN_E_IO, "not without force");
    spin_output_folder_abandon(&out);
    export_frames("ply", 5, 7, true);
    check_present("frame_00005.ply frame_00006.ply sequence.json",
                  "frame_00003.ply frame_00004.ply", "those of the former export are removed");
    ok(!*warned, "without a warning: %s", warned);
    put_file("mine.txt", "mine");
    export_frames("ply", 5, 7, true);
    ok(strstr(warned, "was not empty") != NULL, "another file is in the way: %s", warned);
    check_present("frame_00005.ply frame_00006.ply mine.txt", "", "and stays");
    unlink(path_of("mine.txt"));
}

/* Files without a number belong to some formats. */
static void test_unnumbered(void)
{
    static const char *const of[][2] = {{"images", "transforms_train.json transforms_test.json"},
                                        {"usd", "clip.usda manifest.usda still.usda"},
                                        {"figures", "psnr.svg ssim.svg"}};

    for (int i = 0; i < 3; i++) {
        static const char all[] = "transforms_train.json transforms_test.json clip.usda "
                                  "manifest.usda still.usda psnr.svg ssim.svg";
        char text[200], *rest = NULL, *name;

        export_frames(of[i][0], 1, 2, true);
        snprintf(text, sizeof text, "%s", all);
        for (name = strtok_r(text, " ", &rest); name; name = strtok_r(NULL, " ", &rest))
            put_file(name, "old");
        export_frames("ply", 1, 2, true);
        check_present("frame_00001.ply", of[i][1], of[i][0]);
        snprintf(text, sizeof text, "%s", all);
        for (name = strtok_r(text, " ", &rest); name; name = strtok_r(NULL, " ", &rest))
            ok((access(path_of(name), F_OK) == 0) == !strstr(of[i][1], name), "%s and %s", of[i][0],
               name);
    }
}

/* A list that anybody may have written: names with folders, without the number of their frame, or
 * of symbolic links. */
static void test_foreign(void)
{
    static const char head[] = "{\"generator\": \"%s\", \"format\": \"ply\", \"frames\": [%s]}";
    static const char frames[] = "{\"file\": \"mine7.txt\", \"frame\": 7},"
                                 "{\"file\": \"mine7.txt\", \"frame\": 7},"
                                 "{\"file\": \"mine8.txt\", \"frame\": 9},"
                                 "{\"file\": \"sub/mine10.txt\", \"frame\": 10},"
                                 "{\"file\": \"link11\", \"frame\": 11},"
                                 "{\"file\": \"mine12.txt\"}, {\"frame\": 13}, 4";
    char text[1000];

    mkdir(path_of("sub"), 0777);
    if (symlink("mine8.txt", path_of("link11")) != 0)
        exit(1);
    for (int i = 0; i < 2; i++) {
        put_file("mine7.txt", "mine");
        put_file("mine8.txt", "mine");
        put_file("mine12.txt", "mine");
        put_file("sub/mine10.txt", "mine");
        snprintf(text, sizeof text, head, i ? "spin4d 0.0" : "another 1.0", frames);
        put_file("sequence.json", text);
        export_frames("ply", 1, 2, true);
        check_present("mine8.txt mine12.txt sub/mine10.txt link11 frame_00001.ply",
                      i ? "mine7.txt" : "", "a list");
        ok((access(path_of("mine7.txt"), F_OK) == 0) == (i == 0),
           "counts if this program has written it");
    }
    put_file("sequence.json", "{\"frames\": ");
    export_frames("ply", 1, 2, true);
    check_present("frame_00001.ply mine8.txt", "", "a list that cannot be read");
}

/* Writes the index of a streamed SOG with these chunks, and the list of the export. */
static void put_index(const char *generator, const char *chunks)
{
    char text[600];

    snprintf(text, sizeof text, "{\"asset\": {\"generator\": \"%s\"}, \"filenames\": [%s]}",
             generator, chunks);
    put_file("lod-meta.json", text);
    put_file("sequence.json", "{\"generator\": \"spin4d 0.0\", \"format\": \"streamed-sog\"}");
}

static void put_chunk(const char *name)
{
    char file[80];

    mkdir(path_of(name), 0777);
    snprintf(file, sizeof file, "%s/meta.json", name);
    put_file(file, "old");
    snprintf(file, sizeof file, "%s/quats.webp", name);
    put_file(file, "old");
}

/* The folders of chunks that a former streamed SOG lists, and foreign ones. */
static void test_chunks(void)
{
    static const char *const names[] = {"0_0", "1_0", "2_0", "3_x", "away", "mine"};

    snprintf(folder, sizeof folder, "%s/chunks", check_folder());
    mkdir(folder, 0777);
    put_chunk("0_0");
    put_chunk("1_12");
    put_index("spin4d 0.0", "\"0_0/meta.json\", \"1_12/meta.json\", \"1_12/meta.json\"");
    export_frames("ply", 1, 2, true);
    ok(!*warned, "chunks that are removed cause no warning: %s", warned);
    check_present("frame_00001.ply sequence.json", "0_0 1_12 lod-meta.json",
                  "chunks of a former export");
    if (symlink("away", path_of("1_12")) != 0)
        exit(1);
    for (int i = 0; i < 2; i++) {
        for (int k = 0; k < 6; k++)
            put_chunk(names[k]);
        put_file("2_0/notes", "mine");
        put_index(i ? "spin4d 0.0" : "another 1.0",
                  "\"0_0/meta.json\", \"1_12/meta.json\", \"2_0/meta.json\", \"mine/meta.json\", "
                  "\"3_x/meta.json\", \"../chunks/1_0/meta.json\", \"1_0/quats.webp\", 4");
        export_frames("ply", 1, 2, true);
        check_present("1_0/meta.json 2_0/notes away/meta.json mine/meta.json 3_x/meta.json",
                      i ? "0_0 2_0/meta.json" : "", "other folders, links and files stay");
        ok((access(path_of("0_0"), F_OK) == 0) == (i == 0), "only chunks of this program go");
        ok(i == 0 || strstr(warned, "cannot remove 1 file"), "the folder of a file is kept: %s",
           warned);
    }
}

static void test_abandon(void)
{
    struct spin_output_folder out;

    snprintf(folder, sizeof folder, "%s/two", check_folder());
    ok(spin_output_folder_begin(folder, false, ".ply", &out) == SPIN_OK && out.created, "a folder");
    spin_output_folder_abandon(&out);
    ok(access(folder, F_OK) != 0, "that stays empty is removed");
    mkdir(folder, 0777);
    ok(spin_output_folder_begin(folder, false, ".ply", &out) == SPIN_OK && !out.created, "one");
    spin_output_folder_abandon(&out);
    ok(access(folder, F_OK) == 0, "that was there is not");
}

TAP_MAIN
{
    spin_log_set_level(-1);
    spin_log_set_sink(keep_warning);
    snprintf(folder, sizeof folder, "%s/out", check_folder());
    test_former();
    test_unnumbered();
    test_foreign();
    test_chunks();
    test_abandon();
}
