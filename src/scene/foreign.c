#include "scene/foreign.h"

#include "base/base.h"
#include "io/file.h"
#include "io/zip.h"

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
