/* Maps, paths, folders, write-then-rename.  K: io file */
#include <errno.h>
#include <sys/time.h>
#include <time.h>
#include <sys/wait.h>
#include <unistd.h>

#include "spin_run.h"
#include "io/output.h"
#include "tests/check.h"
#include "tests/tap.h"

static const char *root; /* a fresh folder */

static const char *in_root(const char *name)
{
    static char ring[8][512];
    static int next;

    next = (next + 1) % 8;
    snprintf(ring[next], sizeof ring[0], "%s/%s", root, name);
    return ring[next];
}

static void put_file(const char *path, const char *text)
{
    FILE *file = fopen(path, "wb");

    if (file) {
        fputs(text, file);
        fclose(file);
    }
}

static void error_is(spin_status got, spin_status want, const char *part, const char *what)
{
    if (!ok(got == want && strstr(spin_last_error(), part), "%s", what))
        printf("#   status %d, '%s'\n", got, spin_last_error());
}

static void maps(void)
{
    struct spin_map map;
    char want[600];

    put_file(in_root("a"), "hello");
    ok(spin_map_open(in_root("a"), &map) == SPIN_OK && map.size == 5 &&
           memcmp(map.data, "hello", 5) == 0,
       "maps a file");
    spin_map_close(&map);
    put_file(in_root("empty"), "");
    ok(spin_map_open(in_root("empty"), &map) == SPIN_OK && map.size == 0 && map.data,
       "maps nothing");
    spin_map_close(&map);
    put_file(in_root("lfs"), "version https://git-lfs.github.com/spec/");
    error_is(spin_map_open(in_root("lfs"), &map), SPIN_E_UNSUPPORTED, "git lfs pull",
             "a Git LFS pointer is none");
    put_file(in_root("lfs"), "version https://git-lfs.github.com/spec");
    ok(spin_map_open(in_root("lfs"), &map) == SPIN_OK && map.size == 39,
       "a shorter text is a file");
    spin_map_close(&map);
    ok(spin_map_open(in_root("none"), &map) == SPIN_E_NOT_FOUND, "a missing file is not found");
    snprintf(want, sizeof want, "cannot open '%s': no such file or folder", in_root("none"));
    is_text(spin_last_error(), want, "and the text names it");
    error_is(spin_map_open(root, &map), SPIN_E_IO, "it is a folder", "a folder is not mapped");
    mkfifo(in_root("fifo"), 0600);
    error_is(spin_map_open(in_root("fifo"), &map), SPIN_E_IO, "not an ordinary file",
             "a fifo does not block");
    unlink(in_root("fifo"));
}

static void join_is(const char *dir, const char *name, const char *want)
{
    char *path;

    ok(spin_path_join(dir, name, &path) == SPIN_OK && strcmp(path, want) == 0, "joins to '%s'",
       want);
    free(path);
}

static void folder_is(const char *path, const char *want)
{
    char *folder;

    ok(spin_path_folder(path, &folder) == SPIN_OK && strcmp(folder, want) == 0, "'%s' lies in '%s'",
       path, want);
    free(folder);
}

static void relative_is(const char *from, const char *to, const char *want)
{
    char *path;

    if (spin_path_relative(from, to, &path) != SPIN_OK) {
        ok(0, "relative: %s", spin_last_error());
        return;
    }
    if (!ok(strcmp(path, want) == 0, "relative path '%s'", want))
        printf("#   got '%s'\n", path);
    free(path);
}

static void paths(void)
{
    char *path;

    join_is("a", "b", "a/b");
    join_is("a/", "b", "a/b");
    join_is("", "b", "b");
    join_is("/", "b", "/b");
    folder_is("a", ".");
    folder_is("a/b", "a");
    folder_is("a/b/", "a");
    folder_is("/a", "/");
    folder_is("/", "/");
    folder_is("/a//b", "/a");
    is_text(spin_path_name("a/b.ply"), "b.ply", "last component");
    is_text(spin_path_name("b.ply"), "b.ply", "last component of a bare name");

    spin_folder_make(in_root("p/q/r"));
    spin_folder_make(in_root("p/s"));
    relative_is(in_root("p/q"), in_root("p/s"), "../s");
    relative_is(in_root("p/q/r"), in_root("p"), "../..");
    relative_is(in_root("p"), in_root("p/q/r"), "q/r");
    relative_is(in_root("p"), in_root("p"), ".");
    relative_is(in_root("p/q/r"), in_root("p/s"), "../../s");
    relative_is("/proc", "/dev", "/dev");
    relative_is("/", "/dev", "/dev");
    ok(spin_path_relative(root, in_root("none"), &path) == SPIN_E_NOT_FOUND && !path,
       "no relative path to what is not there");
    ok(spin_path_absolute(in_root("p/../p/q"), &path) == SPIN_OK && path[0] == '/' &&
           !strstr(path, ".."),
       "absolute path");
    free(path);
}

static void folders(void)
{
    char **names;
    size_t n;

    ok(spin_folder_make(in_root("x/y//z/")) == SPIN_OK && spin_path_is_folder(in_root("x/y/z")),
       "makes folders along the way");
    ok(spin_folder_make(in_root("x/y")) == SPIN_OK, "an existing folder is fine");
    put_file(in_root("x/file"), "");
    error_is(spin_folder_make(in_root("x/file")), SPIN_E_IO, "a file has that name",
             "a file is not");
    ok(spin_folder_make(in_root("x/file/below")) != SPIN_OK, "nor is a folder below a file");
    put_file(in_root("x/b10"), "");
    put_file(in_root("x/B"), "");
    ok(spin_folder_list(in_root("x"), &names, &n) == SPIN_OK && n == 4, "lists a folder");
    ok(n == 4 && !strcmp(names[0], "B") && !strcmp(names[1], "b10") && !strcmp(names[2], "file") &&
           !strcmp(names[3], "y") && !names[4],
       "sorted by bytes, ended by NULL");
    spin_folder_list_free(names);
    ok(spin_folder_list(in_root("x/y/z"), &names, &n) == SPIN_OK && n == 0 && names && !names[0],
       "lists an empty folder");
    spin_folder_list_free(names);
    ok(spin_folder_list(in_root("none"), &names, &n) == SPIN_E_NOT_FOUND && !names, "or says no");
    ok(spin_path_exists(in_root("x/B")) && !spin_path_is_folder(in_root("x/B")),
       "a file is no folder");
}

static size_t n_entries(const char *path)
{
    char **names;
    size_t n = 0;

    if (spin_folder_list(path, &names, &n) == SPIN_OK)
        spin_folder_list_free(names);
    return n;
}

/* In place of the C library's: counts, and fails on demand. */
static int n_syncs;
static bool sync_fails;

int fsync(int fd)
{
    (void)fd;
    n_syncs++;
    errno = EIO;
    return sync_fails ? -1 : 0;
}

static void syncs(void)
{
    struct spin_out out;

    for (int wanted = 0; wanted < 2; wanted++) {
        n_syncs = 0;
        ok(spin_out_open(in_root("out/s"), true, &out) == SPIN_OK && !out.sync,
           "a writer does not wait for the disk by itself");
        out.sync = wanted;
        ok(spin_out_write(&out, "one", 3) == SPIN_OK && spin_out_commit(&out) == SPIN_OK &&
               n_syncs == wanted,
           wanted ? "but when told to" : "and does not");
    }
    unlink(in_root("out/s"));
    sync_fails = true;
    ok(spin_out_open(in_root("out/s"), true, &out) == SPIN_OK, "opens one more");
    out.sync = true;
    error_is(spin_out_commit(&out), SPIN_E_IO, "out/s", "a disk that fails then is an error");
    ok(!spin_path_exists(in_root("out/s")), "which leaves nothing");
    sync_fails = false;
}

/* A name as spin_out_open() gives, of a process that is no more. elsewhere: of another place. */
static const char *left_name(const char *path, bool elsewhere)
{
    static char name[300];
    char suffix[SPIN_OUT_SUFFIX];
    char *place;

    spin_out_suffix(suffix);
    place = strrchr(suffix, '.');
    if (elsewhere)
        place[1] = place[1] == '0' ? '1' : '0';
    snprintf(name, sizeof name, "%s.tmp.999999999%s", path, place);
    return name;
}

static void sweeps_file(void)
{
    /* Names of earlier versions; process 1 lives, no system has so many. */
    static const char *const before[] = {"out/f.tmp.999999999", "out/f.tmp.1",
                                         "out/g.tmp.999999999"};
    const struct timeval minutes = {time(NULL) - 120, 0}, hours = {time(NULL) - 7200, 0};
    char live[300], elsewhere[300], folder[310], suffix[SPIN_OUT_SUFFIX];

    for (int i = 0; i < 3; i++) {
        put_file(in_root(before[i]), "x");
        utimes(in_root(before[i]), (struct timeval[]){minutes, minutes});
    }
    spin_out_suffix(suffix);
    snprintf(live, sizeof live, "out/f%s", suffix);
    put_file(in_root(live), "x");
    utimes(in_root(live), (struct timeval[]){hours, hours});
    put_file(in_root(left_name("out/f", false)), "x");
    snprintf(elsewhere, sizeof elsewhere, "%s", left_name("out/f", true));
    put_file(in_root(elsewhere), "x");
    utimes(in_root(elsewhere), (struct timeval[]){minutes, minutes});
    snprintf(folder, sizeof folder, "%s", left_name("out/f", false));
    mkdir(in_root(folder), 0777);
    strcat(folder, "/try");
    put_file(in_root(folder), "x");
    spin_out_sweep(in_root("out/f/"));
    ok(!spin_path_exists(in_root("out/f.tmp.999999999")) && spin_path_exists(in_root(before[1])) &&
           spin_path_exists(in_root(before[2])) && spin_path_exists(in_root(live)),
       "what a killed writer left is swept, and nothing else");
    ok(spin_path_exists(in_root(elsewhere)), "another host may still write what is minutes old");
    utimes(in_root(elsewhere), (struct timeval[]){hours, hours});
    spin_out_sweep(in_root("out/f"));
    ok(!spin_path_exists(in_root(elsewhere)), "but not what is hours old");
    unlink(in_root(live));
    unlink(in_root(before[1]));
    unlink(in_root(before[2]));
    ok(n_entries(in_root("out")) == 1, "a folder goes with what is in it");
}

static void outputs(void)
{
    struct spin_out out;
    struct spin_map map;

    spin_folder_make(in_root("out"));
    ok(spin_out_open(in_root("out/f"), false, &out) == SPIN_OK, "opens an output");
    ok(!spin_path_exists(in_root("out/f")), "which has not its name yet");
    ok(spin_out_write(&out, "one", 3) == SPIN_OK && spin_out_write(&out, NULL, 0) == SPIN_OK &&
           out.bytes == 3,
       "writes and counts");
    ok(spin_out_commit(&out) == SPIN_OK && n_entries(in_root("out")) == 1,
       "commit leaves one file");
    error_is(spin_out_open(in_root("out/f"), false, &out), SPIN_E_IO,
             "it exists; use --force to overwrite", "an existing file is kept");
    ok(spin_out_open(in_root("out/f"), true, &out) == SPIN_OK &&
           spin_out_write(&out, "2", 1) == SPIN_OK,
       "unless forced");
    spin_out_abandon(&out);
    ok(spin_map_open(in_root("out/f"), &map) == SPIN_OK && map.size == 3,
       "abandon leaves the old content");
    spin_map_close(&map);
    ok(n_entries(in_root("out")) == 1, "and no temporary file");
    spin_out_abandon(&out);
    sweeps_file();
    error_is(spin_out_open(in_root("none/f"), false, &out), SPIN_E_NOT_FOUND, "none/f",
             "no folder to write into");
    error_is(spin_out_open(in_root("out"), true, &out), SPIN_E_IO, "it is a folder",
             "a folder is not overwritten");
    error_is(spin_out_open("/dev/null", true, &out), SPIN_E_IO, "not an ordinary file",
             "nor is a device");
}

/* In a folder: what is left of names with one ending, when nobody has written to it for a minute.
 */
static void sweeps_folder(void)
{
    static const char *const left[] = {"many/0.ply.tmp.999999999", "many/1.ply.tmp.999999999",
                                       "many/2.ply.tmp.1", "many/notes.tmp.999999999",
                                       "many/.ply.tmp.999999999"};
    const struct timeval old[2] = {{1000, 0}, {1000, 0}};
    struct spin_output_folder folder;

    spin_folder_make(in_root("many"));
    for (int i = 0; i < 5; i++) {
        put_file(in_root(left[i]), "x");
        if (i != 1)
            utimes(in_root(left[i]), old);
    }
    ok(spin_output_folder_begin(in_root("many"), false, ".ply", &folder) == SPIN_E_IO &&
           n_entries(in_root("many")) == 5,
       "a folder that is not taken is not swept");
    spin_out_sweep_folder(in_root("many"), "");
    ok(n_entries(in_root("many")) == 5, "nor is anything without an ending");
    ok(spin_output_folder_begin(in_root("many"), true, ".ply", &folder) == SPIN_OK &&
           n_entries(in_root("many")) == 4 && !spin_path_exists(in_root(left[0])),
       "of a folder that is taken what killed writers have left goes, and nothing else");
    spin_output_folder_end(&folder);
}

/* Two writers of one name, be they processes of one number in two containers, do not touch each
 * other's bytes. */
static void two_writers(void)
{
    struct spin_out a, b;
    struct spin_map map;

    ok(spin_out_open(in_root("both"), true, &a) == SPIN_OK &&
           spin_out_open(in_root("both"), true, &b) == SPIN_OK &&
           strcmp(a.temporary, b.temporary) != 0,
       "one process writes a name twice, under two temporary names");
    ok(spin_out_write(&a, "first", 5) == SPIN_OK && spin_out_write(&b, "second", 6) == SPIN_OK &&
           spin_out_commit(&b) == SPIN_OK && spin_out_commit(&a) == SPIN_OK,
       "both are whole");
    ok(spin_map_open(in_root("both"), &map) == SPIN_OK && map.size == 5 &&
           memcmp(map.data, "first", 5) == 0,
       "and the last one stays");
    spin_map_close(&map);
}

/* What appears under the name after opening is not ours to replace, nor is a link to nothing. */
static void made_meanwhile(void)
{
    struct spin_out out;
    struct spin_map map;

    ok(spin_out_open(in_root("out/m"), false, &out) == SPIN_OK, "opens an output");
    put_file(in_root("out/m"), "theirs");
    error_is(spin_out_commit(&out), SPIN_E_IO, "it exists; use --force",
             "what was made meanwhile is kept");
    ok(spin_map_open(in_root("out/m"), &map) == SPIN_OK && map.size == 6 &&
           n_entries(in_root("out")) == 2,
       "and nothing is left of ours");
    spin_map_close(&map);
    ok(spin_out_open(in_root("out/m"), true, &out) == SPIN_OK && spin_out_commit(&out) == SPIN_OK &&
           spin_map_open(in_root("out/m"), &map) == SPIN_OK && map.size == 0,
       "unless forced");
    spin_map_close(&map);
    unlink(in_root("out/m"));
    ok(symlink("nowhere", in_root("out/m")) == 0 && spin_path_is_taken(in_root("out/m")) &&
           !spin_path_exists(in_root("out/m")),
       "a link to nothing takes a name");
    error_is(spin_out_open(in_root("out/m"), false, &out), SPIN_E_IO, "it exists; use --force",
             "and is kept");
    ok(spin_out_open(in_root("out/m"), true, &out) == SPIN_OK && spin_out_commit(&out) == SPIN_OK &&
           spin_path_exists(in_root("out/m")) && !spin_path_exists(in_root("out/nowhere")),
       "unless forced: then it is replaced, and what it names is not made");
    unlink(in_root("out/m"));
}

static void full_disk(void)
{
    static char block[1 << 16];
    struct spin_out out;
    spin_status status;

    if (access("/dev/full", W_OK) != 0) {
        skip("a full disk is an error", "no /dev/full");
        return;
    }
    status = spin_out_open(in_root("out/full"), false, &out);
    if (status == SPIN_OK) { /* the same stream, onto a device that is always full */
        out.file = freopen("/dev/full", "wb", out.file);
        status = spin_out_write(&out, block, sizeof block);
        status = status == SPIN_OK ? spin_out_commit(&out) : (spin_out_abandon(&out), status);
    }
    error_is(status, SPIN_E_IO, "out/full", "a full disk is an error");
    ok(!spin_path_exists(in_root("out/full")) && n_entries(in_root("out")) == 1,
       "that leaves nothing");
}

static void heads(void)
{
    char head[8] = "";
    size_t n = 99;

    put_file(in_root("head"), "0123456789");
    ok(spin_file_head(in_root("head"), head, 4, &n) == SPIN_OK && n == 4 &&
           !memcmp(head, "0123", 5),
       "reads the first bytes and no more");
    ok(spin_file_head(in_root("empty"), head, 4, &n) == SPIN_OK && n == 0, "none of an empty file");
    error_is(spin_file_head(root, head, 4, &n), SPIN_E_IO, "it is a folder",
             "a folder has no head");
}

/* Pages come back by themselves, and what lies elsewhere is left alone. */
static void forgets(void)
{
    const size_t n = 3 * 4096 + 100;
    unsigned char *bytes = malloc(n), *copy = malloc(n);
    char path[300];
    struct spin_map map;
    FILE *file;

    for (size_t i = 0; i < n; i++)
        bytes[i] = copy[i] = (unsigned char)(i * 7);
    snprintf(path, sizeof path, "%s/forget", check_folder());
    file = fopen(path, "wb");
    if (!file || fwrite(bytes, 1, n, file) != n || fclose(file) != 0 ||
        spin_map_open(path, &map) != SPIN_OK)
        exit(1);
    for (size_t first = 0; first < n; first += 1000)
        spin_map_forget(&map, map.data + first, n - first < 5000 ? n - first : 5000);
    check_same_bits(map.data, copy, n, "what was forgotten is read again");
    spin_map_forget(&map, bytes, n);
    spin_map_forget(&map, map.data + 4096, n); /* beyond the end */
    check_same_bits(bytes, copy, n, "memory that is no map's keeps its contents");
    check_same_bits(map.data, copy, n, "and so does the map");
    spin_map_close(&map);
    free(bytes);
    free(copy);
}

/* ---- Files that are cut short while they are mapped -------------------------------------------
 */

static void put_bytes(const char *path, size_t n)
{
    char *text = malloc(n + 1);

    if (!text)
        exit(1);
    memset(text, 'x', n);
    text[n] = '\0';
    put_file(path, text);
    free(text);
}

static void checks(void)
{
    const char *path = in_root("checked");
    struct spin_map map, empty;
    struct spin_out out;

    put_bytes(path, 9000);
    put_file(in_root("empty"), "");
    if (spin_map_open(path, &map) != SPIN_OK || spin_map_open(in_root("empty"), &empty) != SPIN_OK)
        exit(1);
    ok(spin_map_check(&map) == SPIN_OK && spin_map_check(&empty) == SPIN_OK,
       "files that are as they were");
    ok(truncate(path, 0) == 0 && spin_out_open(in_root("copy"), false, &out) == SPIN_OK,
       "one loses everything");
    error_is(spin_out_write_at(&out, 0, map.data, 9000), SPIN_E_IO,
             "an input file was cut short while it was in use", "copying it fails with the reason");
    spin_out_abandon(&out);
    spin_map_close(&map);
    put_bytes(path, 9000);
    ok(spin_map_open(path, &map) == SPIN_OK && truncate(path, 8999) == 0, "one loses a byte");
    error_is(spin_map_check(&map), SPIN_E_IO, "checked': it was cut short", "and is no more");
    ok(truncate(path, 9000) == 0, "it gets one");
    error_is(spin_map_check(&map), SPIN_E_IO, "checked': it was changed", "it is another");
    put_bytes(in_root("other"), 10);
    ok(rename(in_root("other"), path) == 0 && spin_map_check(&map) == SPIN_OK,
       "a new file of that name leaves the old one whole");
    ok(unlink(path) == 0 && spin_map_check(&map) == SPIN_OK, "and so does removing it");
    spin_map_close(&map);
    ok(spin_map_check(&map) == SPIN_OK, "a closed map is none");
}

/* In a child: stderr goes to a file. */
static void fall(const char *path, const char *out_path)
{
    struct spin_output_folder folder;
    struct spin_out out;
    struct spin_map map;

    if (!freopen(in_root("stderr"), "w", stderr) || spin_map_open(path, &map) != SPIN_OK ||
        spin_output_folder_begin(in_root("made"), false, ".ply", &folder) != SPIN_OK ||
        spin_out_open(out_path, false, &out) != SPIN_OK)
        _exit(3);
    spin_catch_cut_files("tester");
    if (truncate(path, 0) != 0 || !spin_path_exists(out.temporary))
        _exit(4);
    _exit(map.data[8000] ? 5 : 6);
}

static void cuts(void)
{
    const char *path = in_root("cut"), *out_path = in_root("made/half");
    char line[600] = "", want[600];
    char **names = NULL;
    int code = 0, n_lines = 0;
    size_t n = 0;
    pid_t child;
    FILE *file;

    put_bytes(path, 9000);
    fflush(stdout);
    child = fork();
    if (child == 0)
        fall(path, out_path);
    ok(child > 0 && waitpid(child, &code, 0) == child && WIFEXITED(code) && WEXITSTATUS(code) == 1,
       "reading what was cut off ends the process with 1");
    file = fopen(in_root("stderr"), "r");
    while (file && fgets(line, sizeof line, file))
        n_lines++;
    if (file)
        fclose(file);
    snprintf(want, sizeof want,
             "tester: cannot read '%s': it was cut short while it was in use, or the disk failed\n",
             path);
    is_text(line, want, "a line names the file");
    ok(n_lines == 1, "one line");
    ok(!spin_path_exists(in_root("made")), "the new folder and the half-written file are gone");
    ok(spin_folder_list(root, &names, &n) == SPIN_OK && n > 0, "other files are not");
    spin_folder_list_free(names);
}

TAP_MAIN
{
    root = check_folder();
    maps();
    paths();
    folders();
    outputs();
    sweeps_folder();
    two_writers();
    made_meanwhile();
    syncs();
    full_disk();
    heads();
    forgets();
    checks();
    cuts();
}
