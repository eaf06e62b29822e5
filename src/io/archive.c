#include "io/archive.h"

#include "base/base.h"
#include "io/zip.h"

enum { MOST_MEMBERS = 65536, PIECE = 1 << 20, LONGEST_NAME = 1024 };
/* The largest unpacked size in bytes is RATIO times the size of the archive, plus SLACK. Files of
 * splats seldom compress to less than a tenth of their size, so only archives that are made to fill
 * the disk exceed this limit. */
#define RATIO 200
#define SLACK ((uint64_t)64 << 20)

/* ---- The temporary folder -------------------------------------------------------------------- */

static const char *temporary_folder(void)
{
    static const char *const names[] = {"TMPDIR", "TEMP", "TMP"};

    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        const char *folder = getenv(names[i]);

        if (folder && *folder && spin_path_is_folder(folder))
            return folder;
    }
    return "/tmp";
}

/* Sets *name to the file name of the archive without ".zip", ".tar.gz" and similar extensions. The
 * caller frees it. */
static spin_status strip_name(const char *path, char **name)
{
    static const char *const endings[] = {".gz", ".tgz", ".tar", ".zip"};

    SPIN_TRY(spin_strdup(spin_path_name(path), name));
    for (size_t i = 0; i < sizeof endings / sizeof *endings; i++) {
        size_t n = strlen(*name), n_ending = strlen(endings[i]);

        if (n > n_ending && spin_text_ends_any_case(*name, endings[i]))
            (*name)[n - n_ending] = '\0';
    }
    return SPIN_OK;
}

/* Makes the temporary folder, which only this user can read. out->root is two levels below it,
 * because importers may also search the folder that contains their input, and must not search
 * outside the temporary folder. */
static spin_status make_folders(const char *path, struct spin_unpacked *out)
{
    SPIN_FREED char *stem = NULL, *base = NULL, *run = NULL, *name = NULL;
    char suffix[SPIN_OUT_SUFFIX];

    SPIN_TRY(spin_path_join(temporary_folder(), "spin4d", &stem));
    spin_out_sweep(stem); /* remove the folders of killed processes */
    spin_out_suffix(suffix);
    SPIN_TRY(spin_alloc(strlen(stem) + strlen(suffix) + 1, 1, (void **)&base));
    sprintf(base, "%s%s", stem, suffix);
    if (mkdir(base, 0700) != 0)
        return spin_fail(SPIN_E_IO, "cannot make folder '%s' to unpack '%s': %s", base, path,
                         strerror(errno));
    out->folder = base;
    base = NULL;
    SPIN_TRY(strip_name(path, &name));
    SPIN_TRY(spin_path_join(out->folder, "run", &run));
    SPIN_TRY(spin_path_join(run, name, &out->root));
    SPIN_TRY(spin_folder_make(out->root));
    spin_text_alias(out->root, path);
    return SPIN_OK;
}

void spin_unpacked_remove(struct spin_unpacked *u)
{
    if (u->root)
        spin_text_unalias(u->root);
    if (u->folder)
        spin_out_remove(u->folder);
    free(u->folder);
    free(u->root);
    free(u->path);
    *u = (struct spin_unpacked){0};
}

/* ---- Members --------------------------------------------------------------------------------- */

struct job {
    const char *archive, *root;
    uint64_t limit; /* largest total size of the unpacked files, in bytes */
    size_t n;       /* members read so far */
};

/* Checks the name of a member and replaces '\\', which some programs write on Windows, by '/'. */
static spin_status check_name(const struct job *job, char *name)
{
    for (char *c = name; *c; c++)
        *c = *c == '\\' ? '/' : *c;
    if (strlen(name) > LONGEST_NAME || *name == '/' || strchr(name, ':'))
        return spin_malformed("cannot unpack '%s': the member name '%.80s' is absolute or too long",
                              job->archive, name);
    for (const char *part = name; *part;) {
        size_t n = strcspn(part, "/");

        if (n == 2 && strncmp(part, "..", 2) == 0)
            return spin_malformed(
                "cannot unpack '%s': the member name '%.80s' leads out of the archive",
                job->archive, name);
        part += n + (part[n] == '/');
    }
    return SPIN_OK;
}

/* Whether to skip a member: a metadata file of macOS, or "./", the root folder of the archive. */
static bool is_needless(const char *name)
{
    const char *last = spin_path_name(name);

    return strncmp(name, "__MACOSX/", 9) == 0 || strncmp(last, "._", 2) == 0 ||
           strcmp(last, ".DS_Store") == 0 || strcmp(name, "./") == 0 || strcmp(name, ".") == 0;
}

/* Checks the name of a member, makes the folders in its path, and sets *path to the file to write;
 * NULL if the member is a folder or is skipped. */
static spin_status place_member(struct job *job, const char *member, bool is_folder, char **path)
{
    SPIN_FREED char *name = NULL, *folder = NULL, *file = NULL;

    *path = NULL;
    if (spin_cancelled())
        return spin_fail_cancelled();
    if (++job->n > MOST_MEMBERS)
        return spin_unsupported(
            "cannot unpack '%s': it has more than %d members; unpack it yourself", job->archive,
            MOST_MEMBERS);
    SPIN_TRY(spin_strdup(member, &name));
    SPIN_TRY(check_name(job, name));
    if (is_needless(name))
        return SPIN_OK;
    SPIN_TRY(spin_path_join(job->root, name, &file));
    if (is_folder || spin_text_ends(name, "/"))
        return spin_folder_make(file);
    SPIN_TRY(spin_path_folder(file, &folder));
    SPIN_TRY(spin_folder_make(folder));
    if (spin_path_is_taken(file))
        return spin_malformed("cannot unpack '%s': it has several members named '%.80s'",
                              job->archive, name);
    *path = file;
    file = NULL;
    return SPIN_OK;
}

static spin_status unpack_zip(struct job *job)
{
    SPIN_LEAVES(spin_zip_close) struct spin_zip zip = {0};
    uint64_t sum = 0;

    SPIN_TRY(spin_zip_open(job->archive, &zip));
    for (size_t i = 0; i < zip.n; i++)
        sum += zip.member[i].size < job->limit ? zip.member[i].size : job->limit + 1;
    if (sum > job->limit)
        return spin_malformed(
            "cannot unpack '%s': it contains more than %llu bytes, far more than its "
            "own size suggests; if you trust it, unpack it yourself",
            job->archive, (unsigned long long)job->limit);
    for (size_t i = 0; i < zip.n; i++) {
        const struct spin_zip_member *member = &zip.member[i];
        const unsigned char *data;
        SPIN_FREED char *path = NULL;
        SPIN_FREED void *owned = NULL;

        SPIN_TRY(place_member(job, member->name, false, &path));
        if (!path)
            continue;
        SPIN_TRY(spin_zip_read(&zip, member, true, job->limit, &data, &owned));
        SPIN_TRY(spin_out_whole(path, data, (size_t)member->size, false));
    }
    return SPIN_OK;
}

/* Copies the current member of `tar` to `out` or, if `tar` is NULL, the rest of the stream. */
static spin_status copy_pieces(struct spin_stream *s, struct spin_tar *tar, struct spin_out *out)
{
    SPIN_FREED unsigned char *piece = NULL;
    size_t n = PIECE;

    SPIN_TRY(spin_alloc(PIECE, 1, (void **)&piece));
    while (n > 0) {
        if (spin_cancelled())
            return spin_fail_cancelled();
        if (tar) {
            n = tar->unread < PIECE ? (size_t)tar->unread : PIECE;
            SPIN_TRY(spin_tar_read(tar, piece, n));
        } else {
            SPIN_TRY(spin_stream_read(s, piece, PIECE, &n));
        }
        SPIN_TRY(spin_out_write(out, piece, n));
    }
    return SPIN_OK;
}

static spin_status write_file(const char *path, struct spin_stream *s, struct spin_tar *tar)
{
    struct spin_out out;
    spin_status status;

    SPIN_TRY(spin_out_open(path, false, &out));
    status = copy_pieces(s, tar, &out);
    if (status == SPIN_OK)
        return spin_out_commit(&out);
    spin_out_abandon(&out);
    return status;
}

/* Reads the stream to its end, past the end of the tar archive, so that the checksum of a gzip file
 * is verified. */
static spin_status drain(struct spin_stream *s)
{
    unsigned char piece[SPIN_TAR_BLOCK];
    size_t n = 1;

    while (n > 0)
        SPIN_TRY(spin_stream_read(s, piece, sizeof piece, &n));
    return SPIN_OK;
}

static spin_status unpack_tar(struct job *job, struct spin_stream *s)
{
    SPIN_LEAVES(spin_tar_close) struct spin_tar tar = {.stream = s};

    for (;;) {
        SPIN_FREED char *path = NULL;

        SPIN_TRY(spin_tar_next(&tar));
        if (!tar.name)
            return drain(s);
        SPIN_TRY(place_member(job, tar.name, tar.is_folder, &path));
        if (path)
            SPIN_TRY(write_file(path, s, &tar));
    }
}

/* Sets *out to whether a file is a tar archive, either plain or compressed with gzip. */
static spin_status is_tar(const char *path, bool *out)
{
    SPIN_LEAVES(spin_stream_close) struct spin_stream s = {0};
    unsigned char head[SPIN_TAR_BLOCK];
    size_t n;

    SPIN_TRY(spin_stream_open(path, sizeof head, &s));
    SPIN_TRY(spin_stream_read(&s, head, sizeof head, &n));
    *out = spin_tar_looks_like(head, n);
    return SPIN_OK;
}

static spin_status unpack_stream(struct job *job)
{
    SPIN_LEAVES(spin_stream_close) struct spin_stream s = {0};
    SPIN_FREED char *name = NULL, *path = NULL;
    bool tar;

    SPIN_TRY(is_tar(job->archive, &tar));
    SPIN_TRY(spin_stream_open(job->archive, job->limit, &s));
    if (tar)
        return unpack_tar(job, &s);
    SPIN_TRY(strip_name(job->archive, &name));
    SPIN_TRY(place_member(job, name, false, &path));
    return path ? write_file(path, &s, NULL) : SPIN_OK;
}

/* ---- Archives -------------------------------------------------------------------------------- */

static bool read_kind(const char *path, bool *zip)
{
    unsigned char head[SPIN_TAR_BLOCK];
    size_t n = 0;

    if (spin_path_is_folder(path) || spin_file_head(path, head, sizeof head, &n) != SPIN_OK)
        return false;
    *zip = spin_zip_detect(head, n);
    return *zip || spin_tar_looks_like(head, n) || (n > 2 && head[0] == 0x1f && head[1] == 0x8b);
}

/* Whether a zip file is a checkpoint of PyTorch, whose pickle is the member <name>/data.pkl. */
static bool is_checkpoint(const char *path)
{
    SPIN_LEAVES(spin_zip_close) struct spin_zip zip = {0};

    if (spin_zip_open(path, &zip) != SPIN_OK)
        return false;
    for (size_t i = 0; i < zip.n; i++) {
        const char *slash = strchr(zip.member[i].name, '/');

        if (slash && strcmp(slash + 1, "data.pkl") == 0)
            return true;
    }
    return false;
}

bool spin_archive_detect(const char *path)
{
    bool zip;

    return read_kind(path, &zip) &&
           !(zip && (spin_text_ends_any_case(path, ".npz") || is_checkpoint(path)));
}

/* Sets u->path to the contents of the archive: descends from u->root as long as a folder has a
 * single entry. */
static spin_status descend(struct spin_unpacked *u)
{
    SPIN_TRY(spin_strdup(u->root, &u->path));
    while (spin_path_is_folder(u->path)) {
        char **names, *path = NULL;
        size_t n;
        spin_status status;

        SPIN_TRY(spin_folder_list(u->path, &names, &n));
        status = n == 1 ? spin_path_join(u->path, names[0], &path) : SPIN_OK;
        spin_folder_list_free(names);
        if (!path)
            return status;
        free(u->path);
        u->path = path;
    }
    return SPIN_OK;
}

spin_status spin_archive_unpack(const char *path, struct spin_unpacked *out)
{
    struct job job = {.archive = path};
    struct stat st;
    uint64_t free_bytes;
    bool zip = false;

    *out = (struct spin_unpacked){0};
    if (stat(path, &st) != 0 || !read_kind(path, &zip))
        return spin_malformed("cannot unpack '%s': it is no zip, tar or gzip file", path);
    SPIN_TRY(make_folders(path, out));
    job.root = out->root;
    job.limit = RATIO * (uint64_t)st.st_size + SLACK;
    free_bytes = spin_path_free_bytes(out->root);
    job.limit = free_bytes < job.limit ? free_bytes : job.limit;
    SPIN_TRY(zip ? unpack_zip(&job) : unpack_stream(&job));
    return descend(out);
}
