/* Chooses an importer by its name, or detects the importer of an input. For detection, probe() of
 * every importer returns a score for the input, based only on the first bytes of the input and on
 * file names (struct spin_peek). */
#include "scene/probe.h"

#include <strings.h>

#include "base/base.h"
#include "io/file.h"
#include "io/torch.h"
#include "io/zip.h"
#include "scene/bundle.h"

/* Scores are estimates: if the two highest differ by less than this, detection fails. */
#define TIE 10
/* Minimum score that spin_importer_guess() accepts. */
#define SURE 60
/* If a folder is not recognised, at most this many of its subfolders are searched for a run. */
#define MAX_BELOW 256

/* ---- Inputs that no importer reads ----------------------------------------------------------- */

enum { HEAD = 512, MOST_MEMBERS = 65536 };

static const struct kind {
    const char *magic;
    size_t at, n; /* offset of the magic bytes in the file; their number */
    enum { ARCHIVE, VIDEO, IMAGE, DOCUMENT } is;
    const char *name;
} kinds[] = {
    {"PK\3\4", 0, 4, ARCHIVE, "a ZIP archive"},
    {"\x1f\x8b", 0, 2, ARCHIVE, "packed by gzip"},
    {"ustar", 257, 5, ARCHIVE, "a tar archive"},
    {"\xfd"
     "7zXZ",
     0, 5, ARCHIVE, "packed by xz"},
    {"BZh", 0, 3, ARCHIVE, "packed by bzip2"},
    {"\x28\xb5\x2f\xfd", 0, 4, ARCHIVE, "packed by Zstandard"},
    {"7z\xbc\xaf", 0, 4, ARCHIVE, "a 7z archive"},
    {"Rar!", 0, 4, ARCHIVE, "a RAR archive"},
    {"ftyp", 4, 4, VIDEO, "a video"},
    {"\x1a\x45\xdf\xa3", 0, 4, VIDEO, "a video"},
    {"AVI ", 8, 4, VIDEO, "a video"},
    {"\x89PNG", 0, 4, IMAGE, "an image"},
    {"\xff\xd8\xff", 0, 3, IMAGE, "an image"},
    {"GIF8", 0, 4, IMAGE, "an image"},
    {"WEBP", 8, 4, IMAGE, "an image"},
    {"v/1\1", 0, 4, IMAGE, "an image"},
    {"II*\0", 0, 4, IMAGE, "an image"},
    {"%PDF", 0, 4, DOCUMENT, "a PDF document"},
};

static const struct kind *kind_of(const char *path)
{
    unsigned char head[HEAD];
    size_t n = 0;

    if (spin_file_head(path, head, sizeof head, &n) != SPIN_OK)
        return NULL;
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++)
        if (n >= kinds[i].at + kinds[i].n &&
            memcmp(head + kinds[i].at, kinds[i].magic, kinds[i].n) == 0)
            return &kinds[i];
    return NULL;
}

/* Sets `name` to the name of a member of a ZIP archive that an importer might read, or to "" if
 * there is none. Returns false if the archive cannot be opened. */
static bool find_member(const char *path, char *name, size_t n_name)
{
    static const char *const endings[] = {".ply",  ".spz",   ".splat", ".ksplat", ".sog",  ".glb",
                                          ".tsog", ".sogst", ".npz",   ".pth",    ".ckpt", ".spin"};
    struct spin_zip zip;

    *name = '\0';
    if (spin_zip_open(path, &zip) != SPIN_OK)
        return false;
    for (size_t i = 0; i < zip.n && i < MOST_MEMBERS && !*name; i++)
        for (size_t k = 0; k < sizeof endings / sizeof *endings; k++)
            if (spin_text_ends_any_case(zip.member[i].name, endings[k]))
                snprintf(name, n_name, "%s", zip.member[i].name);
    spin_zip_close(&zip);
    return true;
}

static void describe_file(const char *path, const struct kind *kind, bool want_views, char *text,
                          size_t n_text)
{
    bool is_zip = kind->is == ARCHIVE && memcmp(kind->magic, "PK", 2) == 0;
    char member[128] = "";

    if (is_zip && !find_member(path, member, sizeof member))
        snprintf(text, n_text, "it begins like %s, but is truncated or damaged", kind->name);
    else if (*member)
        snprintf(text, n_text, "it is %s that contains '%s': unpack it and give its contents",
                 kind->name, member);
    else if (kind->is == ARCHIVE)
        snprintf(text, n_text, "it is %s: unpack it and give its contents", kind->name);
    else if (want_views && kind->is != DOCUMENT)
        snprintf(text, n_text, "it is %s: give the folder that contains the %ss of all cameras",
                 kind->name, strchr(kind->name, ' ') + 1);
    else if (kind->is == DOCUMENT)
        snprintf(text, n_text, "it is %s", kind->name);
    else
        snprintf(text, n_text,
                 "it is %s, not splats: train one of the methods of 'spin-import --list' on it, "
                 "then give the folder that the method writes",
                 kind->name);
}

/* Describes a folder that is empty or whose files are all of one kind, and returns true; returns
 * false for other folders. Only the first few files are read. */
static bool describe_folder(const char *path, bool want_views, char *text, size_t n_text)
{
    enum { LOOKED_AT = 8 };
    const struct kind *kind = NULL;
    char **names = NULL, first[128] = "";
    size_t n = 0, n_files = 0;
    bool same = true;

    if (spin_folder_list(path, &names, &n) != SPIN_OK)
        return false;
    for (size_t i = 0; i < n && n_files < LOOKED_AT; i++) {
        SPIN_FREED char *file = NULL;
        const struct kind *found;

        /* sequence.json is written by spin-export */
        if (names[i][0] == '.' || strcmp(names[i], "sequence.json") == 0 ||
            spin_path_join(path, names[i], &file) != SPIN_OK)
            continue;
        found = spin_path_is_folder(file) ? NULL : kind_of(file);
        same = same && found && (!kind || found->is == kind->is);
        kind = found;
        if (n_files++ == 0)
            snprintf(first, sizeof first, "%s", names[i]);
    }
    spin_folder_list_free(names);
    if (n_files == 0)
        snprintf(text, n_text, "it is an empty folder: give the one %s",
                 want_views ? "with the images" : "that a method wrote");
    else if (!same || kind->is == DOCUMENT)
        return false;
    else if (kind->is == ARCHIVE)
        snprintf(text, n_text, "it contains an archive, '%s': unpack it", first);
    else if (want_views)
        snprintf(text, n_text,
                 "it is a folder of %ss without a supported file of cameras: see spin-importers(7) "
                 "for the supported data sets",
                 strchr(kind->name, ' ') + 1);
    else
        snprintf(text, n_text,
                 "it is a folder of %ss, not of splats: give the folder that a method wrote, and "
                 "this folder with --data",
                 strchr(kind->name, ' ') + 1);
    return true;
}

/* Describes an input that is a URL or a pattern and not a path, and returns true; returns false for
 * other inputs. */
static bool describe_missing(const char *path, char *text, size_t n_text)
{
    const char *scheme = strstr(path, "://"), *slash = strrchr(path, '/');

    if (scheme && strncmp(path, "file://", 7) == 0)
        snprintf(text, n_text, "it is a URL: give the path without 'file://'");
    else if (scheme && scheme > path)
        snprintf(text, n_text, "it is a URL: download it first");
    else if (strpbrk(path, "*?[") && slash)
        snprintf(text, n_text, "it is a pattern: give the folder, '%.*s'", (int)(slash - path),
                 path);
    else if (strpbrk(path, "*?["))
        snprintf(text, n_text, "it is a pattern: give the folder of the files");
    else
        return false;
    return true;
}

bool spin_foreign_input(const char *path, bool want_views, char *text, size_t n_text)
{
    const struct kind *kind;

    *text = '\0';
    if (spin_path_is_folder(path))
        return describe_folder(path, want_views, text, n_text);
    kind = kind_of(path);
    if (kind)
        describe_file(path, kind, want_views, text, n_text);
    return kind != NULL;
}

spin_status spin_foreign_missing(const char *path)
{
    char what[400];

    if (!spin_path_exists(path) && describe_missing(path, what, sizeof what))
        return spin_fail(SPIN_E_NOT_FOUND, "cannot open '%s': %s", path, what);
    return SPIN_OK;
}

enum { PEEK_HEAD = 16384, PEEK_NAMES = 4096, PEEK_NAMES_BYTES = 1 << 20 };

/* ---- Peek ---------------------------------------------------------------------------------- */

static spin_status peek_head(const char *path, struct spin_peek *out)
{
    void *head;

    SPIN_TRY(spin_alloc(PEEK_HEAD, 1, &head));
    out->head = head;
    return spin_file_head(path, head, PEEK_HEAD, &out->n_head);
}

/* Lists the names of the members of a zip, one per line: at most PEEK_NAMES names and
 * PEEK_NAMES_BYTES bytes. If the zip cannot be read, *out stays unchanged, and the reason is
 * reported when an importer opens it. */
static spin_status peek_members(const char *path, char **out)
{
    struct spin_zip zip;
    size_t bytes = 1, used = 0;
    void *text = NULL;
    spin_status status;

    if (spin_zip_open(path, &zip) != SPIN_OK)
        return SPIN_OK;
    for (size_t i = 0; i < zip.n && i < PEEK_NAMES && bytes < PEEK_NAMES_BYTES; i++)
        bytes += strlen(zip.member[i].name) + 1;
    status = spin_alloc(bytes, 1, &text);
    for (size_t i = 0; status == SPIN_OK && i < zip.n; i++) {
        size_t n = strlen(zip.member[i].name);

        if (used + n + 2 > bytes)
            break;
        if (strchr(zip.member[i].name, '\n'))
            continue;
        if (used > 0)
            ((char *)text)[used++] = '\n';
        memcpy((char *)text + used, zip.member[i].name, n);
        used += n;
    }
    spin_zip_close(&zip);
    *out = text;
    return status;
}

/* Reads part of the file `name` in a folder if the file helps to distinguish related methods. From
 * params.npz (Dynamic 3D Gaussians and its descendants), the names of the members are read. In
 * addition, the first bytes of one file are read, namely of the first that exists in this list:
 * cfg_args (descendants of 3DGS); a checkpoint, which begins with the names of the optimiser's
 * groups; deformation.pth, which begins with the keys of the network; point_cloud.ply. */
static spin_status peek_inside(const char *folder, const char *name, struct spin_peek *out,
                               char **members)
{
    /* These names are in alphabetical order, since the files of a folder are visited in that order.
     */
    static const char *const heads[] = {"cfg_args", "chkpnt", "deformation.pth", "point_cloud.ply"};
    enum { CHECKPOINT = 1 }; /* index of "chkpnt", which is a prefix of file names */
    bool head = false;
    SPIN_FREED char *path = NULL;
    spin_status status = SPIN_OK;

    for (size_t i = 0; i < sizeof heads / sizeof *heads; i++)
        head = head || (!out->head && strncmp(name, heads[i], strlen(heads[i])) == 0 &&
                        (i == CHECKPOINT || strlen(name) == strlen(heads[i])));
    if (strcmp(name, "params.npz") != 0 && !head)
        return SPIN_OK;
    SPIN_TRY(spin_path_join(folder, name, &path));
    if (!head)
        status = peek_members(path, members);
    else
        (void)peek_head(path, out); /* a file that cannot be read has an empty head */
    return status;
}

/* Reads the first bytes of a checkpoint ckpt_*.pt: of the file `name` itself or, if `name` is the
 * folder "ckpts", of the first such file in it. Several methods use these names, so the importers
 * need the contents to distinguish them. */
static void peek_ckpts(const char *folder, const char *name, struct spin_peek *out)
{
    SPIN_FREED char *path = NULL;
    char **names = NULL;
    size_t n = 0;

    if (out->head || spin_path_join(folder, name, &path) != SPIN_OK)
        return;
    if (strncmp(name, "ckpt_", 5) == 0 && spin_text_ends(name, ".pt"))
        (void)peek_head(path, out);
    if (strcmp(name, "ckpts") != 0 || spin_folder_list(path, &names, &n) != SPIN_OK)
        return;
    for (size_t i = 0; i < n && !out->head; i++)
        peek_ckpts(path, names[i], out);
    spin_folder_list_free(names);
}

static spin_status peek_folder(const char *path, struct spin_peek *out, char **members)
{
    char **names;
    size_t n;

    SPIN_TRY(spin_folder_list(path, &names, &n));
    for (size_t i = PEEK_NAMES; i < n; i++) {
        free(names[i]);
        names[i] = NULL;
    }
    out->is_folder = true;
    out->names = (const char *const *)names;
    for (size_t i = 0; names[i]; i++)
        SPIN_TRY(peek_inside(path, names[i], out, members));
    for (size_t i = 0; names[i]; i++)
        peek_ckpts(path, names[i], out);
    return SPIN_OK;
}

spin_status spin_peek_open(const char *path, struct spin_peek *out)
{
    char *copy, *members = NULL;
    spin_status status;

    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_strdup(path, &copy));
    out->path = copy;
    if (spin_path_is_folder(path)) {
        SPIN_TRY_OUT(peek_folder(path, out, &members));
    } else {
        SPIN_TRY_OUT(peek_head(path, out));
        if (spin_zip_detect(out->head, out->n_head))
            SPIN_TRY_OUT(peek_members(path, &members));
    }
    if (!out->head) {
        char *empty = NULL;

        SPIN_TRY_OUT(spin_strdup("", &empty));
        out->head = (const unsigned char *)empty;
    }
    if (!members)
        SPIN_TRY_OUT(spin_strdup("", &members));
    out->tail_names = members;
    return SPIN_OK;
out:
    free(members);
    spin_peek_free(out);
    return status;
}

void spin_peek_free(struct spin_peek *peek)
{
    free((void *)(uintptr_t)peek->path);
    free((void *)(uintptr_t)peek->head);
    free((void *)(uintptr_t)peek->tail_names);
    spin_folder_list_free((char **)(uintptr_t)peek->names);
    memset(peek, 0, sizeof *peek);
}

/* ---- Choosing -------------------------------------------------------------------------------- */

static bool is_candidate(const struct spin_importer *importer, bool want_views)
{
    return want_views ? importer->views != NULL : importer->open != NULL;
}

/* Writes the names of all importers, such as "d3dgs, ply". */
static void list_names(bool want_views, char *text, size_t n_text)
{
    size_t used = 0;

    text[0] = '\0';
    for (const struct spin_importer *const *i = spin_importer_list(); *i && used < n_text; i++) {
        if (is_candidate(*i, want_views))
            used +=
                (size_t)snprintf(text + used, n_text - used, "%s%s", used ? ", " : "", (*i)->name);
    }
}

static spin_status find_by_name(const char *from, bool want_views, const struct spin_importer **out)
{
    char names[512];

    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++) {
        if (strcasecmp((*i)->name, from) == 0 && is_candidate(*i, want_views)) {
            *out = *i;
            return SPIN_OK;
        }
    }
    if (spin_plugin_fault(from))
        return spin_unsupported("%s", spin_plugin_fault(from));
    list_names(want_views, names, sizeof names);
    return spin_misuse("no importer of %s is called '%s'; available: %s",
                       want_views ? "data sets" : "runs", from, names);
}

/* Returns whether spin_torch_open() may give a better error message for an unknown file: if it is
 * empty, a web page, a Git LFS pointer or a damaged checkpoint. */
static bool is_torch_like(const struct spin_peek *peek)
{
    static const char *const heads[] = {"version https://git-lfs", "<!doctype", "<!DOCTYPE",
                                        "<html"};
    const unsigned char *head = peek->head;

    for (size_t i = 0; i < sizeof heads / sizeof *heads; i++) {
        if (peek->n_head >= strlen(heads[i]) && memcmp(head, heads[i], strlen(heads[i])) == 0)
            return true;
    }
    if (peek->n_head >= 4 && memcmp(head, "PK\3\4", 4) == 0)
        return !*peek->tail_names || strstr(peek->tail_names, "data.pkl");
    return peek->n_head == 0 || (peek->n_head >= 2 && head[0] == 0x80 && head[1] <= 5);
}

/* The importers with the two highest scores. */
struct choice {
    const struct spin_importer *best, *second;
    int score, second_score;
};

static struct choice choose_importer(const struct spin_peek *peek, bool want_views)
{
    struct choice c = {0};

    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++) {
        int score;

        if (!is_candidate(*i, want_views) || !(*i)->probe)
            continue;
        score = (*i)->probe(peek);
        if (score > c.score) {
            c.second = c.best;
            c.second_score = c.score;
            c.best = *i;
            c.score = score;
        } else if (score > c.second_score) {
            c.second = *i;
            c.second_score = score;
        }
    }
    return c;
}

const struct spin_importer *spin_importer_guess(const char *path, bool want_views)
{
    struct spin_peek peek;
    struct choice c;

    if (spin_peek_open(path, &peek) != SPIN_OK)
        return NULL;
    c = choose_importer(&peek, want_views);
    spin_peek_free(&peek);
    return c.score >= SURE && c.score - c.second_score >= TIE ? c.best : NULL;
}

static spin_status fail_foreign(const char *path, bool want_views)
{
    char what[400];

    if (spin_foreign_input(path, want_views, what, sizeof what))
        return spin_fail(SPIN_E_NOT_RECOGNISED, "cannot recognise '%s': %s", path, what);
    return spin_fail(SPIN_E_NOT_RECOGNISED,
                     "cannot recognise '%s': no importer reads it (see spin-import --list)", path);
}

/* Searches the subfolders of an unrecognised folder for a run, or for a data set if want_views. If
 * exactly one is found and `in` is not NULL, sets *out to its importer and *in to its path, which
 * the caller frees. Otherwise fails; if any was found, the message names the first. */
static spin_status search_subfolders(const struct spin_peek *peek, bool want_views,
                                     const struct spin_importer **out, char **in)
{
    const struct spin_importer *first = NULL;
    SPIN_FREED char *below = NULL;
    int n = 0, n_looked_at = 0;

    for (size_t i = 0; peek->names[i] && n_looked_at < MAX_BELOW; i++) {
        const struct spin_importer *found = NULL;
        SPIN_FREED char *path = NULL;

        SPIN_TRY(spin_path_join(peek->path, peek->names[i], &path));
        if (spin_path_is_folder(path)) {
            found = spin_importer_guess(path, want_views);
            n_looked_at++;
        }
        n += found != NULL;
        if (n == 1 && found) {
            first = found;
            below = path;
            path = NULL;
        }
    }
    if (n == 0) {
        return fail_foreign(peek->path, want_views);
    } else if (n == 1 && in) {
        *out = first;
        *in = below;
        below = NULL;
        return SPIN_OK;
    }
    return spin_fail(SPIN_E_NOT_RECOGNISED, "cannot recognise '%s': %s '%s' (%s)", peek->path,
                     n > 1        ? want_views ? "it contains several data sets, such as"
                                               : "it contains several runs, such as"
                     : want_views ? "the data set is in"
                                  : "the run is in",
                     below, first->name);
}

static spin_status fail_unknown(const struct spin_peek *peek, bool want_views)
{
    struct spin_torch torch;

    if (spin_bundle_detect(peek->path))
        return spin_fail(SPIN_E_NOT_RECOGNISED,
                         "'%s' is already a bundle: describe it with --info, or pass it to "
                         "spin-retrain, spin-eval or spin-export",
                         peek->path);
    if (!is_torch_like(peek))
        return fail_foreign(peek->path, want_views);
    SPIN_TRY(spin_torch_open(peek->path, &torch));
    spin_torch_close(&torch);
    return spin_fail(SPIN_E_NOT_RECOGNISED,
                     "cannot recognise '%s': a PyTorch checkpoint that no importer reads (see "
                     "spin-import --list)",
                     peek->path);
}

static spin_status find_by_probe(const struct spin_peek *peek, bool want_views,
                                 const struct spin_importer **out, char **in)
{
    struct choice c = choose_importer(peek, want_views);

    if (!c.best)
        return peek->is_folder ? search_subfolders(peek, want_views, out, in)
                               : fail_unknown(peek, want_views);
    if (c.second && c.score - c.second_score < TIE)
        return spin_fail(
            SPIN_E_NOT_RECOGNISED,
            "cannot recognise '%s': importers '%s' and '%s' may read it: choose one with %s",
            peek->path, c.best->name, c.second->name, want_views ? "--data-from" : "--from");
    *out = c.best;
    return SPIN_OK;
}

static spin_status find_importer(const char *path, const char *from, bool want_views,
                                 const struct spin_importer **out, char **in)
{
    SPIN_LEAVES(spin_peek_free) struct spin_peek peek = {0};

    *out = NULL;
    if (from)
        SPIN_TRY(find_by_name(from, want_views, out));
    if (!from || !spin_plugin_origin(*out))
        SPIN_TRY(spin_foreign_missing(path));
    if (from)
        return SPIN_OK;
    SPIN_TRY(spin_peek_open(path, &peek));
    return find_by_probe(&peek, want_views, out, in);
}

spin_status spin_importer_find(const char *path, const char *from, bool want_views,
                               const struct spin_importer **out)
{
    return find_importer(path, from, want_views, out, NULL);
}

spin_status spin_importer_find_run(const char *path, const char *from,
                                   const struct spin_importer **out, char **in)
{
    *in = NULL;
    return find_importer(path, from, false, out, in);
}

spin_status spin_plugin_check(const char *plugin, const struct spin_plugin_option *options,
                              const char *const *pairs)
{
    for (size_t i = 0; pairs && pairs[i]; i += 2) {
        const struct spin_plugin_option *o = options;

        while (o && o->key && strcmp(o->key, pairs[i]) != 0)
            o++;
        if (!o || !o->key)
            return spin_misuse("'%s' has no option --%s", plugin, pairs[i]);
    }
    return SPIN_OK;
}
