/* spin-import of malformed, hostile or truncated files: exit code 1 and one line that names the
 * file and the reason, nothing on stdout, no output, and a memory use of at most the size of the
 * file, plus 64 MiB, plus the use of a command that does nothing.
 *
 *   1  every case that a manifest lists as refused, by detection and by its possible importers
 *   2  the same checkpoints in place of those inside whole runs
 *   3  one run of each method, each of its files truncated at five places
 *   4  the files of fixtures/hostile, which need not be refused
 *
 * Code inside a checkpoint is refused, naming the function that it would have called.
 * K: long hostile malformed import */
#include <fcntl.h>
#include <fnmatch.h>
#include <ftw.h>
#include <sys/resource.h>
#include <sys/wait.h>

#include "base/text.h"
#include "spin_run.h"
#include "tests/importers/runs.h"

#define MIB (1024L * 1024L)
#define ALLOWED (64 * MIB)

/* The command's memory does not include that of sanitisers. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { MEASURED = 0 };
#else
enum { MEASURED = 1 };
#endif

static const char *command, *work;
static long bare_peak; /* bytes, of a command that does nothing */
static long most;      /* bytes beyond that and the input, of all imports */

struct outcome {
    int code; /* exit code; 128 and more: killed by a signal */
    long peak;
    char out[256], err[4096];
};

static void read_text(const char *path, char *text, size_t n)
{
    FILE *file = fopen(path, "rb");

    text[file ? fread(text, 1, n - 1, file) : 0] = '\0';
    if (file)
        fclose(file);
}

static void redirect(const char *path, int fd)
{
    int file = open(path, O_WRONLY | O_CREAT | O_TRUNC, 0600);

    if (file < 0 || dup2(file, fd) < 0)
        _exit(126);
}

/* The calls of the command, with its exit code and message, in this process. */
static int call(const struct spin_import_options *options, char *line, size_t n)
{
    spin_status status = spin_import(options, NULL);
    int length = snprintf(line, n, "%s", status == SPIN_OK ? "" : "spin-import: ");

    if (status == SPIN_OK)
        return 0;
    snprintf(line + length, n - (size_t)length - 1, "%s", spin_last_error());
    spin_text_tidy(line, false);
    strcat(line, "\n");
    return status == SPIN_E_USAGE ? 2 : 1;
}

/* Runs the command with these arguments or, five times faster, calls the library with these
 * options. An infinite loop is a failure too. */
static void run_child(const char *const *args, const struct spin_import_options *options,
                      struct outcome *outcome)
{
    const struct rlimit seconds = {60, 60};
    const char *out = path_in(work, "stdout"), *err = path_in(work, "stderr");
    struct rusage usage = {0};
    int status = 0;
    pid_t child = fork();

    if (child == 0) {
        redirect(out, 1);
        redirect(err, 2);
        setrlimit(RLIMIT_CPU, &seconds);
        if (args)
            execv(command, (char *const *)args);
        status = args ? 127 : call(options, outcome->err, sizeof outcome->err);
        if (!args)
            fputs(outcome->err, stderr);
        _exit(status);
    }
    if (child < 0 || wait4(child, &status, 0, &usage) != child)
        exit(1);
    outcome->code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
    outcome->peak = usage.ru_maxrss * 1024L;
    read_text(out, outcome->out, sizeof outcome->out);
    read_text(err, outcome->err, sizeof outcome->err);
}

/* Everything runs in this process under a sanitiser, which makes commands slow to start and
 * checks each for leaks. */
static void run_import(const struct spin_import_options *options, bool by_command,
                       struct outcome *o)
{
    const char *args[] = {"spin-import",
                          options->input,
                          "-o",
                          options->output,
                          options->n_frames ? "--frames" : NULL,
                          "2",
                          NULL};

    if (MEASURED) {
        run_child(by_command ? args : NULL, options, o);
        return;
    }
    memset(o, 0, sizeof *o);
    o->code = call(options, o->err, sizeof o->err);
}

/* ---- Sizes of what is read ------------------------------------------------------------------- */

static long long tree_bytes;

static int add_bytes(const char *path, const struct stat *info, int kind, struct FTW *walk)
{
    (void)path;
    (void)walk;
    tree_bytes += kind == FTW_F ? (long long)info->st_size : 0;
    return 0;
}

static long long bytes_of(const char *path)
{
    tree_bytes = 0;
    nftw(path, add_bytes, 8, 0);
    return tree_bytes;
}

/* ---- One import ------------------------------------------------------------------------------ */

static bool left_something(const char *output)
{
    char **names = NULL;
    size_t n = 0, n_left = 0;

    if (spin_folder_list(output, &names, &n) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++) {
        unlink(path_in(output, names[i]));
        n_left++;
    }
    spin_folder_list_free(names);
    return n_left > 0;
}

/* Returns what is wrong with the refusal, or NULL. `word` must be in the line. */
static const char *refusal_fault(const struct outcome *o, const char *word)
{
    const char *end = strchr(o->err, '\n');

    if (o->code != 1)
        return "the exit code is not 1";
    if (strncmp(o->err, "spin-import: ", 13) != 0 || !end || end[1])
        return "not one line that begins with the command's name";
    if (end[-1] == '.')
        return "the line ends in a full stop";
    if (!strstr(o->err, word))
        return "the line does not name the file";
    if (o->out[0])
        return "there is something on stdout";
    return NULL;
}

enum wish { REFUSED, ANY };

/* Imports `input`, the first time that its line must contain this word with the command; the
 * result is one line of the test. */
static void import(const char *from, const char *input, const char *word, enum wish wish,
                   struct outcome *o)
{
    static const char *output, *last_word;
    bool by_command = !from && word != last_word;
    const char *fault = NULL;
    long long allowed = bare_peak + ALLOWED + bytes_of(input);
    struct spin_import_options options = {.input = input, .from = from};

    if (!output)
        output = new_folder();
    last_word = word;
    options.output = path_in(output, "out.spin");
    run_import(&options, by_command, o);
    /* A method that is defined at any time requires options for sampling before it reads its
     * files. */
    if (o->code == 2 && strstr(o->err, "--frames")) {
        options.n_frames = 2;
        run_import(&options, by_command, o);
    }
    if (wish == REFUSED || o->code != 0)
        fault = refusal_fault(o, word);
    if (left_something(output) != (o->code == 0) && !fault)
        fault = "something was left behind";
    if (o->peak - (allowed - ALLOWED) > most)
        most = (long)(o->peak - (allowed - ALLOWED));
    if (!fault && MEASURED && o->peak > allowed)
        fault = "it took too much memory";
    ok(!fault, "%s%s%s: %s", from ? from : "detected", ": ", spin_path_name(input),
       wish == REFUSED ? "refused" : "no harm");
    if (fault)
        printf("#   %s: code %d, %ld KiB of %lld, %s\n", fault, o->code, o->peak / 1024,
               allowed / 1024, o->err);
}

/* ---- 1: the cases of the manifests ----------------------------------------------------------- */

static bool is_refused(const char *expect)
{
    return strcmp(expect, "reject") == 0 || strcmp(expect, "error") == 0;
}

/* The files that a folder's manifest lists as refused; NULL-terminated. */
static const char **refused_in(const char *folder)
{
    static const char *files[128];
    spin_json *manifest = load_manifest(folder);
    const spin_json *cases = spin_json_get(manifest, "cases");
    size_t n = 0;

    for (size_t i = 0; i < spin_json_length(cases) && n < 127; i++) {
        const spin_json *one = spin_json_at(cases, i);
        const char *file = spin_json_string(spin_json_get(one, "file"));
        const char *expect = spin_json_string(spin_json_get(one, "expect"));

        if (file && expect && is_refused(expect))
            files[n++] = path_in(folder, file);
    }
    files[n] = NULL;
    spin_json_free(manifest);
    return files;
}

static void listed(const char *name, const char *const *importers)
{
    const char *folder = check_fixture(name);
    struct outcome o;

    if (!folder) {
        skip(name, "no such fixture");
        return;
    }
    for (const char **file = refused_in(folder); *file; file++) {
        import(NULL, *file, *file, REFUSED, &o);
        for (const char *const *from = importers; *from; from++)
            import(*from, *file, *file, REFUSED, &o);
    }
}

/* The message names the function that a code-carrying checkpoint would have called, beyond the
 * word for it. */
static void names_the_code(void)
{
    static const struct {
        const char *file, *global;
    } evil[] = {
        {"torch_container/malformed/evil_os_system.pth", "'os.system'"},
        {"torch_container/malformed/evil_posix_nested.pth", "'posix.system'"},
        {"torch_container/malformed/evil_stack_global.pth", "'builtins.eval'"},
        {"torch_container/malformed/evil_unused.pth", "'subprocess.Popen'"},
        {"torch_container/malformed/legacy_evil.pth", "'os.system'"},
    };

    for (size_t i = 0; i < sizeof evil / sizeof *evil; i++) {
        const char *path = check_fixture(evil[i].file);
        struct outcome o;

        if (!path) {
            skip(evil[i].file, "no such fixture");
            continue;
        }
        import(NULL, path, evil[i].global, REFUSED, &o);
        import("realtime4dgs", path, evil[i].global, REFUSED, &o);
    }
}

/* ---- Runs with one file replaced */

/* One run of each method: the input of spin-import, and the files in it. `needed` ones are read,
 * so nothing may be imported from a run in which they are broken. */
static const struct run_files {
    const char *run;
    const char *needed[4]; /* patterns of paths below it */
} runs[] = {
    {"d3dgs/cloud", {"params.npz"}},
    {"tc3dgs/trained", {"params.npz"}},
    {"realtime4dgs/rot4d_noshfs", {"*.pth"}},
    {"rotor4dgs/old_names", {"*.ckpt"}},
    {"freetimegs/still_sh0_no_optimizers", {"ckpts/*.pt"}},
    {"hybrid4dgs/small/model", {"*.pth"}},
    {"ex4dgs/small/model", {"*.pth"}},
    {"omg4/comp_xz", {"comp.xz"}},
    {"4dgaussian/coarse_and_fine/model",
     {"point_cloud/iteration_14000/deformation.pth",
      "point_cloud/iteration_14000/point_cloud.ply"}},
    {"ed3dgs/annealed_early/model",
     {"point_cloud/iteration_5400/deformation.pth", "point_cloud/iteration_5400/point_cloud.ply"}},
    {"spacetimegs/full_techni/model", {"*.ply"}}, /* without the network: there are no cameras */
    {"deformable3dgs/real_small/model", {"*/deform.pth", "*/point_cloud.ply"}},
    {"grid4d/dnerf_like/model", {"deform/iteration_50000/*", "point_cloud/iteration_50000/*"}},
    {"dash/default_like/model",
     {"deform/iteration_50000/*", "point_cloud/iteration_50000/point_cloud.ply"}},
    {"modecgs/default_like/model", {"*/deformation_GAD.pth", "*.ply", "*.npy"}},
    {"3dgstream", {"frame*.ply"}}, /* without the networks: the moved clouds are there */
    {"3dgstream/fvv", {"*.pth", "*.ply"}},
    {"ply/inria_sh1", {"*.ply"}},
    {"splats/spz2", {"*.spz"}},
    {"splats/spz3", {"*.spz"}},
    {"splats/spz4", {"*.spz"}},
    {"splats/glb", {"*.glb"}},
    {"splat4d/default_bounds", {"*.splat4d"}},
    {"4dgs/birth_sh2", {"*.4dgs"}},
};
enum { N_RUNS = sizeof runs / sizeof runs[0], MAX_FILES = 64 };

static const char *tree_root, *tree_copy;
static const char *tree_file[MAX_FILES]; /* as in the run, below its root */
static int n_tree_files;

/* Creates folders and links files. Expected values of a fixture are not part of the run. */
static int link_entry(const char *path, const struct stat *info, int kind, struct FTW *walk)
{
    const char *below = path + strlen(tree_root), *name = spin_path_name(path);
    const char *to;

    (void)info;
    (void)walk;
    if (strncmp(name, "expected", 8) == 0 || strcmp(name, "manifest.json") == 0)
        return 0;
    to = path_in(tree_copy, *below ? below + 1 : ".");
    if (kind == FTW_D)
        return spin_folder_make(to) != SPIN_OK;
    if (n_tree_files < MAX_FILES)
        tree_file[n_tree_files++] = path_in("", below + 1) + 1;
    return symlink(path, to);
}

/* A copy of the run in a new folder of its name; its files are in tree_file. */
static const char *copy_run(const char *run)
{
    char absolute[4096];

    if (!realpath(run, absolute))
        exit(1);
    tree_root = absolute;
    tree_copy = path_in(new_folder(), spin_path_name(run));
    n_tree_files = 0;
    if (nftw(absolute, link_entry, 16, FTW_PHYS) != 0)
        exit(1);
    tree_root = NULL;
    return tree_copy;
}

static bool is_needed(const struct run_files *run, const char *file)
{
    for (int i = 0; i < 4 && run->needed[i]; i++) {
        if (fnmatch(run->needed[i], file, 0) == 0)
            return true;
    }
    return false;
}

static void put_link(const char *path, const char *target)
{
    char absolute[4096];

    unlink(path);
    if (!realpath(target, absolute) || symlink(absolute, path) != 0)
        exit(1);
}

static bool is_checkpoint(const char *name)
{
    return fnmatch("*.pth", name, 0) == 0 || fnmatch("*.ckpt", name, 0) == 0;
}

/* ---- 2: hostile checkpoints inside runs -------------------------------------------------------
 */

static void replace_checkpoint(const struct run_files *r, const char *run)
{
    const char *folder = check_fixture("torch_container/malformed");
    const char *copy = copy_run(run), **hostile = refused_in(folder);

    for (int f = 0; f < n_tree_files; f++) {
        const char *name = spin_path_name(tree_file[f]), *place = path_in(copy, tree_file[f]);
        struct outcome o;

        if (!is_checkpoint(name) || !is_needed(r, tree_file[f]))
            continue;
        printf("# %s/%s\n", r->run, tree_file[f]);
        for (const char **file = hostile; *file; file++) {
            put_link(place, *file);
            import(NULL, copy, name, REFUSED, &o);
        }
        return; /* one file of a run is enough */
    }
}

/* ---- 3: every file truncated */

static void write_part(const char *path, const struct spin_map *whole, size_t n)
{
    FILE *file;

    unlink(path);
    file = fopen(path, "wb");
    if (!file || fwrite(whole->data, 1, n, file) != n || fclose(file) != 0)
        exit(1);
}

/* A file that is not read, or that may be missing, can be truncated without harm. Under a
 * sanitiser, where a command takes long to start, each file is truncated at one of the places;
 * the importers' own tests truncate it at many. */
static void cut_file(const struct run_files *r, const char *run, const char *copy, const char *file)
{
    const char *place = path_in(copy, file), *source = path_in(run, file);
    bool needed = is_needed(r, file);
    struct spin_map whole;
    struct outcome o;

    if (spin_map_open(source, &whole) != SPIN_OK)
        exit(1);
    const size_t sizes[] = {whole.size / 2, 0, 1, whole.size / 4, whole.size - 1};

    printf("# %s/%s\n", r->run, file);
    for (size_t i = 0; i < (needed ? 5 : 1) && whole.size > 4; i++) {
        if (!MEASURED && needed && i != whole.size % 5)
            continue;
        write_part(place, &whole, sizes[i]);
        import(NULL, copy, needed ? spin_path_name(file) : copy, needed ? REFUSED : ANY, &o);
    }
    spin_map_close(&whole);
    put_link(place, source);
}

static void cut_short(const struct run_files *r, const char *run)
{
    const char *copy = copy_run(run);

    for (int f = 0; f < n_tree_files; f++)
        cut_file(r, run, copy, tree_file[f]);
}

/* ---- 4: saved inputs of fuzzers */

/* Under a sanitiser, where a command takes long to start, each goes to one importer, in turn. */
static void finds(const char *name, const char *const *importers)
{
    const char *folder = path_in("fixtures/hostile", name);
    char **names = NULL;
    size_t n = 0, n_importers = 0;
    struct outcome o;

    while (importers[n_importers])
        n_importers++;
    if (spin_folder_list(folder, &names, &n) != SPIN_OK) {
        skip(folder, "not here");
        return;
    }
    for (size_t i = 0; i < n; i++) {
        const char *path = path_in(folder, names[i]);

        import(NULL, path, path, ANY, &o);
        for (size_t k = 0; k < n_importers; k++)
            if (MEASURED || k == i % n_importers)
                import(importers[k], path, path, ANY, &o);
    }
    spin_folder_list_free(names);
}

TAP_MAIN
{
    static const char *const of_torch[] = {"realtime4dgs", "hybrid4dgs", "ex4dgs", "rotor4dgs",
                                           "omg4",         "freetimegs", NULL};
    static const char *const of_freetimegs[] = {"freetimegs", "ply", NULL};
    static const char *const of_npz[] = {"d3dgs", "tc3dgs", NULL};
    static const char *const of_ply[] = {"ply", NULL};
    static const char *const of_xz[] = {"omg4", NULL};
    static const char *const of_any[] = {"d3dgs", "ply", "realtime4dgs", "omg4", NULL};
    const char *bin = getenv("SPIN_BIN");
    const char *version[] = {"spin-import", "--version", NULL};
    struct outcome bare;

    work = new_folder();
    command = path_in(bin ? bin : "build/release/bin", "spin-import");
    run_child(version, NULL, &bare);
    bare_peak = bare.peak;
    if (!ok(bare.code == 0, "%s runs", command))
        return;
    listed("torch_container/malformed", of_torch);
    listed("d3dgs/variants", of_npz);
    listed("ply/variants", of_ply);
    names_the_code();
    for (int i = 0; i < N_RUNS; i++) {
        const char *run = check_fixture(runs[i].run);

        if (!run) {
            skip(runs[i].run, "no such fixture");
            continue;
        }
        if (check_fixture("torch_container/malformed"))
            replace_checkpoint(&runs[i], run);
        cut_short(&runs[i], run);
    }
    finds("torch", of_torch);
    finds("chkpnt", of_torch);
    finds("freetimegs", of_freetimegs);
    finds("zip", of_npz);
    finds("npy", of_npz);
    finds("xz", of_xz);
    finds("ply", of_ply);
    finds("json", of_any);
    finds("colmap", of_any);
    finds("easyvolcap", of_any);
    finds("bundle", of_any);
    printf("# most memory beyond the bare command and the input: %ld KiB\n", most / 1024);
}
