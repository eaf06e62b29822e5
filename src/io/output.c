/* Checks, locks and folders of outputs. Existing files are never overwritten without --force. */
#include "io/output.h"

#include <fcntl.h>
#include <strings.h>
#include <sys/file.h>
#include <unistd.h>

#include "base/base.h"

spin_status spin_output_check_file(const char *path, bool force)
{
    struct spin_out out;

    SPIN_TRY(spin_out_open(path, force, &out));
    spin_out_abandon(&out);
    spin_out_sweep(path);
    return SPIN_OK;
}

spin_status spin_output_check_folder(const char *path)
{
    SPIN_TRY(spin_folder_make(path));
    if (access(path, W_OK | X_OK) == 0)
        return SPIN_OK;
    return spin_fail(SPIN_E_IO, "cannot write to folder '%s': %s", path, strerror(errno));
}

/* Check that an existing path is a folder and, unless force is set, that the folder is empty. *n
 * receives the number of entries. */
static spin_status count_entries(const char *path, bool force, size_t *n)
{
    char **names = NULL;

    if (!spin_path_is_folder(path))
        return spin_fail(SPIN_E_IO, "cannot write folder '%s': it exists and is not a folder",
                         path);
    SPIN_TRY(spin_folder_list(path, &names, n));
    spin_folder_list_free(names);
    if (*n > 0 && !force)
        return spin_fail(SPIN_E_IO, "folder '%s' exists and is not empty; use --force to overwrite",
                         path);
    return SPIN_OK;
}

spin_status spin_output_check_empty_folder(const char *path, bool force)
{
    size_t n = 0;

    if (spin_path_is_taken(path))
        SPIN_TRY(count_entries(path, force, &n));
    return spin_output_check_folder(path);
}

/* Resolve the folder of a path, so that two paths of the same file become equal. If the folder does
 * not exist, the path is returned as given. */
static spin_status resolve_folder(const char *path, char **out)
{
    SPIN_FREED char *folder = NULL, *absolute = NULL;

    SPIN_TRY(spin_path_folder(path, &folder));
    absolute = realpath(folder, NULL);
    return absolute ? spin_path_join(absolute, spin_path_name(path), out) : spin_strdup(path, out);
}

spin_status spin_output_check_distinct(const char *const *path, int n)
{
    for (int i = 0; i < n; i++)
        for (int k = 0; k < i; k++) {
            SPIN_FREED char *a = NULL, *b = NULL;

            if (!path[i] || !path[k])
                continue;
            SPIN_TRY(resolve_folder(path[i], &a));
            SPIN_TRY(resolve_folder(path[k], &b));
            if (strcmp(a, b) == 0)
                return spin_misuse("two outputs would be '%s': give them different paths", path[i]);
        }
    return SPIN_OK;
}

/* ---- Reserved disk space -------------------------------------------------------------------- */

enum space { KEPT, TOO_MUCH, CANNOT };

static enum space reserve_bytes(struct spin_reserve *r, const char *folder, uint64_t bytes)
{
#ifdef O_TMPFILE
    if (r->bytes == 0)
        r->fd = open(folder, O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
    if (r->fd < 0)
        return CANNOT;
    if (fallocate(r->fd, 0, 0, (off_t)bytes) == 0) {
        r->bytes = bytes;
        return KEPT;
    }
    if (errno == ENOSPC || errno == EDQUOT) {
        if (r->bytes > 0 && ftruncate(r->fd, (off_t)r->bytes) == 0)
            return TOO_MUCH;
        close(r->fd);
        r->bytes = 0;
        return TOO_MUCH;
    }
    close(r->fd);
    r->bytes = 0;
#else
    (void)r, (void)folder, (void)bytes;
#endif
    return CANNOT;
}

bool spin_reserve_set(struct spin_reserve *r, const char *path, uint64_t bytes)
{
    SPIN_FREED char *folder = NULL;
    enum space got;

    /* A smaller reservation is not worth a change: the space is freed as a whole. */
    if (bytes <= r->bytes && bytes > 0)
        return true;
    if (bytes == 0) {
        if (r->bytes > 0)
            close(r->fd);
        r->bytes = 0;
        return true;
    }
    if (spin_path_folder(path, &folder) != SPIN_OK)
        return true;
    got = reserve_bytes(r, folder, bytes);
    return got == KEPT || (got == CANNOT && spin_path_free_bytes(folder) >= bytes);
}

/* ---- Locks ---------------------------------------------------------------------------------- */

/* Whether this path still names the open file: the previous owner of the lock may have removed the
 * file. */
static bool is_named(int fd, const char *path)
{
    struct stat ours, there;

    return fstat(fd, &ours) == 0 && stat(path, &there) == 0 && ours.st_dev == there.st_dev &&
           ours.st_ino == there.st_ino;
}

enum lock { HELD, TAKEN, GONE, NO_LOCKS, NO_FILE };

/* Try to lock the file, which is created if it does not exist. HELD: this process now has the lock.
 * TAKEN: another process has it. GONE: the file was removed in the meantime; the caller tries
 * again. NO_LOCKS: the file system has no locks. NO_FILE: the file cannot be opened; errno is set.
 * *fd stays open for HELD and NO_LOCKS only. */
static enum lock try_lock(const char *path, int *fd)
{
    enum lock got = HELD;

    *fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0666);
    if (*fd < 0)
        return NO_FILE;
    if (flock(*fd, LOCK_EX | LOCK_NB) != 0)
        got = errno == EWOULDBLOCK ? TAKEN : NO_LOCKS;
    else if (!is_named(*fd, path))
        got = GONE;
    if (got == TAKEN || got == GONE)
        close(*fd);
    return got;
}

spin_status spin_output_lock_take(const char *output, struct spin_output_lock *out)
{
    size_t n = strlen(output) + sizeof ".lock";
    enum lock got;

    *out = (struct spin_output_lock){.fd = -1};
    SPIN_TRY(spin_alloc(n, 1, (void **)&out->path));
    snprintf(out->path, n, "%s.lock", output);
    do
        got = try_lock(out->path, &out->fd);
    while (got == GONE);
    if (got == NO_LOCKS)
        spin_warn("the file system of '%s' does not support locks: make sure that no other run "
                  "writes to it",
                  output);
    if (got == HELD || got == NO_LOCKS)
        return SPIN_OK;
    if (got == TAKEN)
        (void)spin_fail(SPIN_E_IO,
                        "cannot write '%s': another run is writing it, and has locked '%s.lock'",
                        output, output);
    else
        (void)spin_fail(SPIN_E_IO, "cannot write '%s': %s", output,
                        errno == ENOENT ? "no such file or folder" : strerror(errno));
    free(out->path);
    out->path = NULL;
    return SPIN_E_IO;
}

/* Remove the file before releasing the lock, so that a process that has already opened it notices
 * that the name is gone (is_named()). Keep a file that is not empty, since it was not created as a
 * lock. */
void spin_output_lock_drop(struct spin_output_lock *lock)
{
    struct stat st;

    if (!lock->path)
        return;
    if (fstat(lock->fd, &st) == 0 && st.st_size == 0)
        unlink(lock->path);
    close(lock->fd);
    free(lock->path);
    *lock = (struct spin_output_lock){.fd = -1};
}

/* ---- Files of the previous export ------------------------------------------------------------ */

/* Compare names without regard to upper and lower case, which some file systems do not
 * distinguish. */
static int by_name(const void *a, const void *b)
{
    const struct spin_output_former *x = a, *y = b;

    return strcasecmp(x->name, y->name);
}

static bool is_regular(const char *path)
{
    struct stat st;

    return lstat(path, &st) == 0 && S_ISREG(st.st_mode);
}

/* Files of an export that belong to no single frame and are therefore not listed in sequence.json.
 */
static const struct {
    const char *format, *name;
} unnumbered[] = {{"images", "transforms_train.json"},
                  {"images", "transforms_test.json"},
                  {"streamed-sog", "lod-meta.json"},
                  {"usd", "clip.usda"},
                  {"usd", "manifest.usda"},
                  {"usd", "still.usda"},
                  {"figures", "psnr.svg"},
                  {"figures", "ssim.svg"}};
#define N_UNNUMBERED (sizeof unnumbered / sizeof *unnumbered)

static spin_status add_former(struct spin_output_folder *x, const char *name)
{
    SPIN_FREED char *path = NULL;

    SPIN_TRY(spin_path_join(x->path, name, &path));
    return is_regular(path) ? spin_strdup(name, &x->former[x->n_former++].name) : SPIN_OK;
}

static bool is_true_folder(const char *path)
{
    struct stat st;

    return lstat(path, &st) == 0 && S_ISDIR(st.st_mode);
}

/* Returns the number of characters of the folder's name in an entry of lod-meta.json, such as 4 for
 * "0_12/meta.json", or 0 if the entry has another form. Anybody may have written the file, so other
 * folders are not accepted. */
static size_t chunk_folder_length(const char *entry)
{
    static const char digits[] = "0123456789";
    size_t level = strspn(entry, digits), number;

    if (level == 0 || entry[level] != '_')
        return 0;
    number = strspn(entry + level + 1, digits);
    return number > 0 && strcmp(entry + level + 1 + number, "/meta.json") == 0 ? level + 1 + number
                                                                               : 0;
}

/* Adds the folders of the chunks of a streamed SOG that spin4d wrote. */
static spin_status add_former_chunks(struct spin_output_folder *x)
{
    SPIN_LEAVES(spin_json_freed) spin_json *root = NULL;
    SPIN_FREED char *index = NULL;
    const spin_json *names;
    const char *generator;

    SPIN_TRY(spin_path_join(x->path, "lod-meta.json", &index));
    if (!is_regular(index) || spin_json_load(index, &root) != SPIN_OK)
        return SPIN_OK;
    spin_inputs_own(index); /* this export may replace the file although it was read */
    generator = spin_json_string(spin_json_get(spin_json_get(root, "asset"), "generator"));
    names = spin_json_get(root, "filenames");
    if (!generator || strncmp(generator, "spin4d ", 7) != 0 || spin_json_length(names) == 0)
        return SPIN_OK;
    SPIN_TRY(
        spin_grow(x->n_former + spin_json_length(names), sizeof *x->former, (void **)&x->former));
    for (size_t i = 0; i < spin_json_length(names); i++) {
        const char *entry = spin_json_string(spin_json_at(names, i));
        size_t n = entry ? chunk_folder_length(entry) : 0;
        SPIN_FREED char *name = NULL, *path = NULL;

        if (n == 0)
            continue;
        SPIN_TRY(spin_strdup(entry, &name));
        name[n] = '\0';
        SPIN_TRY(spin_path_join(x->path, name, &path));
        if (!is_true_folder(path))
            continue;
        x->former[x->n_former++] = (struct spin_output_former){.name = name, .is_folder = true};
        name = NULL;
    }
    return SPIN_OK;
}

/* Returns the file name in an entry of sequence.json, or NULL if the name is not accepted. Since
 * anybody may have written sequence.json, a name is accepted only if it contains the number of the
 * frame and no folder. */
static const char *former_name(const spin_json *entry)
{
    const char *name = spin_json_string(spin_json_get(entry, "file"));
    char digits[24];
    int64_t number;

    if (!name || strpbrk(name, "/\\:") ||
        !spin_json_integer(spin_json_get(entry, "frame"), &number))
        return NULL;
    snprintf(digits, sizeof digits, "%lld", (long long)number);
    return strstr(name, digits) ? name : NULL;
}

/* Adds the files in `unnumbered` that an export of this format writes. */
static spin_status add_unnumbered_former(struct spin_output_folder *x, const char *format)
{
    for (size_t i = 0; i < N_UNNUMBERED; i++)
        if (strcmp(format, unnumbered[i].format) == 0)
            SPIN_TRY(add_former(x, unnumbered[i].name));
    return SPIN_OK;
}

static spin_status add_all_former(struct spin_output_folder *x, const spin_json *root)
{
    const spin_json *frames = spin_json_get(root, "frames");
    const char *format = spin_json_string(spin_json_get(root, "format"));
    size_t n_most = spin_json_length(frames) + N_UNNUMBERED;

    SPIN_TRY(spin_alloc(n_most, sizeof *x->former, (void **)&x->former));
    SPIN_TRY(add_unnumbered_former(x, format ? format : ""));
    for (size_t i = 0; i < spin_json_length(frames); i++) {
        const char *name = former_name(spin_json_at(frames, i));

        if (name)
            SPIN_TRY(add_former(x, name));
    }
    return format && strcmp(format, "streamed-sog") == 0 ? add_former_chunks(x) : SPIN_OK;
}

static spin_status read_former(struct spin_output_folder *x)
{
    SPIN_LEAVES(spin_json_freed) spin_json *root = NULL;
    SPIN_FREED char *path = NULL;
    const char *generator;
    size_t n = 0;

    SPIN_TRY(spin_path_join(x->path, SPIN_SEQUENCE, &path));
    if (!is_regular(path) || spin_json_load(path, &root) != SPIN_OK)
        return SPIN_OK;
    /* Allow this export to replace sequence.json although the file was read. */
    spin_inputs_own(path);
    generator = spin_json_string(spin_json_get(root, "generator"));
    if (!generator || strncmp(generator, "spin4d ", 7) != 0)
        return SPIN_OK;
    SPIN_TRY(add_all_former(x, root));
    qsort(x->former, x->n_former, sizeof *x->former, by_name);
    for (size_t i = 0; i < x->n_former; i++) /* drop duplicates */
        if (n > 0 && by_name(&x->former[n - 1], &x->former[i]) == 0)
            free(x->former[i].name);
        else
            x->former[n++] = x->former[i];
    x->n_former = n;
    return SPIN_OK;
}

void spin_output_folder_mark(struct spin_output_folder *x, const char *path)
{
    struct spin_output_former key = {.name = (char *)(uintptr_t)spin_path_name(path)}, *found;

    found = x->n_former ? bsearch(&key, x->former, x->n_former, sizeof key, by_name) : NULL;
    if (found)
        found->written = true;
}

/* Removes the folder of a chunk and the files that an export writes to it, and adds their number to
 * *n. Returns false if the folder contains other files, which are kept. */
static bool remove_chunk(const char *folder, size_t *n)
{
    char **names = NULL;
    size_t n_names = 0;

    if (spin_folder_list(folder, &names, &n_names) != SPIN_OK)
        return false;
    for (size_t i = 0; i < n_names; i++) {
        SPIN_FREED char *path = NULL;

        if (strcmp(names[i], "meta.json") != 0 && !spin_text_ends_any_case(names[i], ".webp"))
            continue;
        if (spin_path_join(folder, names[i], &path) == SPIN_OK && is_regular(path))
            *n += unlink(path) == 0;
    }
    spin_folder_list_free(names);
    return rmdir(folder) == 0;
}

void spin_output_folder_remove_former(struct spin_output_folder *x)
{
    size_t n = 0, n_left = 0;
    char text[48];

    for (size_t i = 0; i < x->n_former; i++) {
        SPIN_FREED char *path = NULL;

        if (x->former[i].written)
            continue;
        if (spin_path_join(x->path, x->former[i].name, &path) != SPIN_OK)
            n_left++;
        else if (x->former[i].is_folder)
            n_left += spin_path_is_taken(path) && !remove_chunk(path, &n);
        else if (is_regular(path) && unlink(path) == 0)
            n++;
        else
            n_left++;
    }
    if (n > 0)
        spin_log(0, "removed %s of the previous export from '%s'",
                 spin_text_count((long long)n, "file", text), x->path);
    if (n_left > 0)
        spin_warn("cannot remove %s of the previous export from '%s'",
                  spin_text_count((long long)n_left, "file", text), x->path);
}

void spin_output_folder_add(struct spin_output_folder *x, const char *name, int number)
{
    spin_json *item = spin_json_object();

    if (!x->list)
        x->list = spin_json_array();
    spin_json_push(x->list, item);
    spin_json_set_string(item, "file", name);
    spin_json_set_integer(item, "frame", number);
    spin_output_folder_mark(x, name);
}

spin_status spin_output_folder_list(struct spin_output_folder *x, const char *format, bool sync)
{
    SPIN_LEAVES(spin_json_freed) spin_json *root = spin_json_object();
    SPIN_FREED char *path = NULL, *text = NULL;

    spin_json_set_string(root, "generator", "spin4d " SPIN_VERSION);
    spin_json_set_string(root, "format", format);
    spin_json_set(root, "frames", x->list ? x->list : spin_json_array());
    x->list = NULL;
    SPIN_TRY(spin_path_join(x->path, SPIN_SEQUENCE, &path));
    text = spin_json_text(root, true);
    if (!text)
        return spin_fail(SPIN_E_MEMORY, "cannot write '%s': not enough memory", path);
    return spin_out_whole(path, text, strlen(text), sync);
}

/* ---- Output folders ------------------------------------------------------------------------- */

spin_status spin_output_folder_begin(const char *path, bool force, const char *ending,
                                     struct spin_output_folder *out)
{
    *out = (struct spin_output_folder){0};
    if (spin_path_is_taken(path)) {
        SPIN_TRY(count_entries(path, force, &out->n_before));
        spin_out_sweep_folder(path, ending);
    } else {
        SPIN_TRY(spin_folder_make(path));
        out->created = true;
    }
    SPIN_TRY(spin_strdup(path, &out->path));
    if (out->created)
        spin_watch_out(out->path);
    if (out->n_before > 0)
        SPIN_TRY(read_former(out));
    /* The former export also wrote sequence.json, which x->former does not contain. */
    if (out->n_before > (out->n_former ? out->n_former + 1 : 0))
        spin_warn("folder '%s' was not empty: files that are not overwritten stay in it", path);
    return SPIN_OK;
}

void spin_output_folder_end(struct spin_output_folder *folder)
{
    if (folder->path)
        spin_unwatch_out(folder->path);
    for (size_t i = 0; i < folder->n_former; i++)
        free(folder->former[i].name);
    free(folder->former);
    json_decref(folder->list);
    free(folder->path);
    *folder = (struct spin_output_folder){0};
}

void spin_output_folder_abandon(struct spin_output_folder *folder)
{
    if (folder->created && folder->path)
        (void)rmdir(folder->path); /* has no effect if the folder contains files, as intended */
    spin_output_folder_end(folder);
}
