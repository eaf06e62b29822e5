/* PyTorch checkpoints: detection of the kind of file, the pickle in it, and the storages of its
 * tensors.
 *
 * The zip form keeps each storage as a member TOP/data/KEY. Opening a checkpoint only looks up the
 * members in the directory, and compares their sizes with those in the pickle. The moments of the
 * optimiser, two thirds of a checkpoint, are never read. Stored members are used in place. */
#include "io/torch.h"

#include <strings.h>

#include "base/base.h"
#include "io/compress.h"
#include "io/zip.h"

/* Maximum size of a deflated data.pkl in bytes. Its size is usually some kilobytes, or some
 * megabytes if it contains tables. */
#define PICKLE_LIMIT ((uint64_t)16 << 20)
/* Members of this size in bytes or more are used without verifying their CRC, since the
 * verification would read every byte. */
#define CRC_LIMIT ((uint64_t)64 << 20)

/* The position of a storage in the zip, and its bytes. */
struct bound {
    const struct spin_zip_member *member;
    const unsigned char *data; /* the bytes of the storage; NULL until a tensor needs them */
    void *owned; /* the block that contains the bytes if they were decompressed, or NULL */
};

struct spin_torch_file {
    char *path;
    struct spin_map map; /* the mapped file, for legacy streams only */
    struct spin_zip zip;
    bool is_zip;
    bool warned;     /* a CRC mismatch was already reported */
    bool has_crcs;   /* some CRC matches, so the writer computed CRCs */
    const char *top; /* name of the top folder in the zip, including its slash */
    size_t n_top;
    /* [n_storages] the positions of the storages, in the order of pickle.storage. */
    struct bound *bound;
};

/* ---- Other kinds of files ------------------------------------------------------------------- */

static bool begins_with(const struct spin_map *map, const char *with)
{
    size_t n = strlen(with);

    return map->size >= n && strncasecmp((const char *)map->data, with, n) == 0;
}

static bool is_safetensors(const struct spin_map *map)
{
    uint64_t n = 0;

    for (int i = 0; i < 8 && map->size > 8; i++)
        n |= (uint64_t)map->data[i] << 8 * i;
    return n >= 2 && n <= map->size - 8 && map->data[8] == '{';
}

static spin_status fail_foreign(const char *path, const struct spin_map *map)
{
    const char *what = "it is not a PyTorch checkpoint";
    const unsigned char *p = map->data;

    if (map->size == 0)
        what = "the file is empty";
    else if (begins_with(map, "<!doctype") || begins_with(map, "<html"))
        what = "it is an HTML page, not a PyTorch checkpoint: download it again";
    else if (spin_xz_detect(p, map->size))
        what = "it is an xz file, not a PyTorch checkpoint";
    else if (map->size >= 2 && p[0] == 0x80 && p[1] >= 2 && p[1] <= 5)
        what = "it is a bare pickle, not a PyTorch checkpoint";
    else if (map->size >= 262 && memcmp(p + 257, "ustar", 5) == 0)
        what = "it is a tar file, the unsupported format of PyTorch before 0.1.10";
    else if (is_safetensors(map))
        what = "it is a safetensors file, not a PyTorch checkpoint";
    return spin_unsupported("cannot read '%s': %s", path, what);
}

/* ---- The zip form --------------------------------------------------------------------------- */

/* Find the member TOP/data.pkl, of which there must be exactly one. */
static spin_status find_pickle(struct spin_torch_file *f, const struct spin_zip_member **out)
{
    static const char name[] = "/data.pkl";

    *out = NULL;
    for (size_t i = 0; i < f->zip.n; i++) {
        const char *slash = strchr(f->zip.member[i].name, '/');

        if (!slash || strcmp(slash, name) != 0)
            continue;
        if (*out && strcmp((*out)->name, f->zip.member[i].name) != 0)
            return spin_malformed("cannot read '%s': it contains two checkpoints, '%s' and '%s'",
                                  f->path, (*out)->name, f->zip.member[i].name);
        *out = &f->zip.member[i];
        f->top = (*out)->name;
        f->n_top = (size_t)(slash - (*out)->name) + 1;
    }
    if (!*out)
        return spin_unsupported(
            "cannot read '%s': a zip file without 'data.pkl' is not a PyTorch checkpoint", f->path);
    return SPIN_OK;
}

/* Returns the part of a member's name after TOP/, or NULL if the name does not begin with TOP/. */
static const char *below_top(const struct spin_torch_file *f, const char *name)
{
    return strncmp(name, f->top, f->n_top) == 0 ? name + f->n_top : NULL;
}

static const struct spin_zip_member *find_below(const struct spin_torch_file *f, const char *name)
{
    for (size_t i = f->zip.n; i-- > 0;) {
        const char *rest = below_top(f, f->zip.member[i].name);

        if (rest && strcmp(rest, name) == 0)
            return &f->zip.member[i];
    }
    return NULL;
}

/* Whether a small member exists and its CRC matches. */
static bool has_crc(const struct spin_torch_file *f, const char *name)
{
    const struct spin_zip_member *member = find_below(f, name);
    const unsigned char *data;
    SPIN_FREED void *owned = NULL;

    return member && spin_zip_read(&f->zip, member, true, PICKLE_LIMIT, &data, &owned) == SPIN_OK;
}

/* Read a member's bytes. A CRC mismatch is an error if the CRC of another member matches. Otherwise
 * it is only a warning, since torch can be told not to compute CRCs. */
static spin_status read_member(struct spin_torch_file *f, const struct spin_zip_member *member,
                               uint64_t limit, const unsigned char **data, void **owned)
{
    if (member->size < CRC_LIMIT &&
        spin_zip_read(&f->zip, member, true, limit, data, owned) == SPIN_OK)
        return SPIN_OK;
    SPIN_TRY(spin_zip_read(&f->zip, member, false, limit, data, owned));
    if (member->size < CRC_LIMIT && f->has_crcs)
        return spin_malformed("cannot read '%s': the checksum of '%s' does not match: the file is "
                              "damaged, copy it again",
                              f->path, member->name);
    if (member->size < CRC_LIMIT && !f->warned) {
        f->warned = true;
        spin_warn("'%s': the checksum of '%s' does not match; the file may be damaged", f->path,
                  member->name);
    }
    return SPIN_OK;
}

/* Read the first line of a small text member into `out`, which becomes "" if the member does not
 * exist. */
static spin_status read_word(struct spin_torch_file *f, const char *name, char out[32])
{
    const struct spin_zip_member *member = find_below(f, name);
    const unsigned char *data;
    SPIN_FREED void *owned = NULL;
    size_t n;

    out[0] = '\0';
    if (!member)
        return SPIN_OK;
    SPIN_TRY(read_member(f, member, 4096, &data, &owned));
    n = member->size < 31 ? (size_t)member->size : 31;
    memcpy(out, data, n);
    out[n] = '\0';
    out[strcspn(out, "\r\n")] = '\0';
    return SPIN_OK;
}

static spin_status check_container(struct spin_torch_file *f, bool *big_endian)
{
    char word[32], *end;
    long version;

    for (size_t i = 0; i < f->zip.n; i++) {
        const char *rest = below_top(f, f->zip.member[i].name);

        if (rest && (strcmp(rest, "constants.pkl") == 0 || strncmp(rest, "code/", 5) == 0))
            return spin_unsupported("cannot read '%s': it is a TorchScript program, not a "
                                    "checkpoint, since it contains member '%s'",
                                    f->path, f->zip.member[i].name);
    }
    SPIN_TRY(read_word(f, "version", word));
    version = strtol(word, &end, 10);
    if (word[0] && (end == word || *end || version < 1 || version > 10))
        return spin_unsupported("cannot read '%s': its format version is not between 1 and 10",
                                f->path);
    SPIN_TRY(read_word(f, "byteorder", word));
    *big_endian = strcmp(word, "big") == 0;
    if (word[0] && !*big_endian && strcmp(word, "little") != 0)
        return spin_unsupported("cannot read '%s': its byte order is neither little nor big",
                                f->path);
    return SPIN_OK;
}

struct finder {
    const char *key;
    const struct spin_zip_member *member;
};

static int by_key(const void *a, const void *b)
{
    return strcmp(((const struct finder *)a)->key, ((const struct finder *)b)->key);
}

static spin_status check_storage(const struct spin_torch_file *f, const struct spin_storage *s,
                                 const struct spin_zip_member *member)
{
    /* This product cannot overflow, see op_persistent_id() in pickle.c. */
    uint64_t bytes = s->count * (uint64_t)s->item_size;

    if (!member)
        return s->count == 0 ? SPIN_OK
                             : spin_malformed("cannot read '%s': storage 'data/%s' is missing",
                                              f->path, s->key);
    if (member->size < bytes)
        return spin_malformed("cannot read '%s': storage 'data/%s' has %llu bytes, expected %llu",
                              f->path, s->key, (unsigned long long)member->size,
                              (unsigned long long)bytes);
    if (member->size > bytes && member->method != 0)
        return spin_malformed(
            "cannot read '%s': storage 'data/%s' unpacks to %llu bytes, expected %llu", f->path,
            s->key, (unsigned long long)member->size, (unsigned long long)bytes);
    if (member->size > bytes)
        spin_warn("'%s': storage 'data/%s' has %llu bytes more than its elements need", f->path,
                  s->key, (unsigned long long)(member->size - bytes));
    return SPIN_OK;
}

/* Find the member of every storage, by merging two sorted lists. */
static spin_status find_storages(struct spin_torch_file *f, const struct spin_pickle *pickle)
{
    SPIN_FREED struct finder *list = NULL;
    size_t n = 0, at = 0;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_alloc(f->zip.n, sizeof *list, (void **)&list));
    for (size_t i = 0; i < f->zip.n; i++) {
        const char *rest = below_top(f, f->zip.member[i].name);

        if (rest && strncmp(rest, "data/", 5) == 0)
            list[n++] = (struct finder){rest + 5, &f->zip.member[i]};
    }
    qsort(list, n, sizeof *list, by_key);
    for (size_t i = 0; i < pickle->n_storages && status == SPIN_OK; i++) {
        while (at < n && strcmp(list[at].key, pickle->storage[i].key) < 0)
            at++;
        if (at < n && strcmp(list[at].key, pickle->storage[i].key) == 0)
            f->bound[i].member = list[at].member;
        status = check_storage(f, &pickle->storage[i], f->bound[i].member);
    }
    return status;
}

static spin_status open_zip(struct spin_torch_file *f, struct spin_pickle *pickle)
{
    const struct spin_zip_member *member;
    const unsigned char *data;
    SPIN_FREED void *owned = NULL;
    bool big_endian;

    SPIN_TRY(spin_zip_open(f->path, &f->zip));
    SPIN_TRY(find_pickle(f, &member));
    f->has_crcs = has_crc(f, "version") || has_crc(f, "data.pkl");
    SPIN_TRY(check_container(f, &big_endian));
    SPIN_TRY(read_member(f, member, PICKLE_LIMIT, &data, &owned));
    SPIN_TRY(spin_pickle_parse(f->path, data, (size_t)member->size, pickle));
    pickle->big_endian = big_endian;
    SPIN_TRY(spin_alloc(pickle->n_storages, sizeof *f->bound, (void **)&f->bound));
    return find_storages(f, pickle);
}

/* ---- Opening --------------------------------------------------------------------------------- */

spin_status spin_torch_open(const char *path, struct spin_torch *out)
{
    struct spin_torch_file *f;
    void *block = NULL;
    spin_status status;

    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_alloc(1, sizeof *f, &block));
    f = out->file = block;
    SPIN_TRY_OUT(spin_strdup(path, &f->path));
    SPIN_TRY_OUT(spin_map_open(path, &f->map));
    f->is_zip = spin_zip_detect(f->map.data, f->map.size);
    if (f->is_zip) {
        spin_map_close(&f->map); /* spin_zip_open() will map the file again */
        SPIN_TRY_OUT(open_zip(f, &out->pickle));
    } else if (spin_pickle_is_legacy(f->map.data, f->map.size)) {
        SPIN_TRY_OUT(spin_pickle_parse_legacy(path, f->map.data, f->map.size, &out->pickle));
    } else {
        SPIN_TRY_OUT(fail_foreign(path, &f->map));
    }
    out->root = out->pickle.root;
    return SPIN_OK;
out:
    spin_torch_close(out);
    return status;
}

void spin_torch_close(struct spin_torch *torch)
{
    struct spin_torch_file *f = torch->file;

    if (f) {
        for (size_t i = 0; f->bound && i < torch->pickle.n_storages; i++)
            free(f->bound[i].owned);
        free(f->bound);
        spin_zip_close(&f->zip);
        spin_map_close(&f->map);
        free(f->path);
        free(f);
    }
    spin_pickle_free(&torch->pickle);
    memset(torch, 0, sizeof *torch);
}

/* ---- Tensors --------------------------------------------------------------------------------- */

static spin_status bind_storage(struct spin_torch *torch, struct spin_array *t)
{
    const struct spin_storage *s = spin_pickle_storage(&torch->pickle, t->storage);
    struct spin_torch_file *f = torch->file;
    struct bound *b;

    if (!s) /* unreachable: every key comes from a storage in the pickle */
        return spin_malformed("storage '%s' is missing", t->storage);
    t->big_endian = torch->pickle.big_endian && t->item_size > 1;
    if (!f->is_zip || s->count == 0) {
        t->data = f->is_zip ? (const unsigned char *)"" : s->data;
        return SPIN_OK;
    }
    b = &f->bound[s - torch->pickle.storage];
    if (!b->data)
        SPIN_TRY(read_member(f, b->member, b->member->size, &b->data, &b->owned));
    t->data = b->data;
    return SPIN_OK;
}

void spin_torch_forget(const struct spin_torch *torch, const struct spin_array *t)
{
    size_t n = (size_t)t->storage_count * (size_t)t->item_size;

    spin_map_forget(&torch->file->zip.map, t->data, n);
    spin_map_forget(&torch->file->map, t->data, n);
}

spin_status spin_torch_tensor(struct spin_torch *torch, const struct spin_value *v,
                              const char *what, struct spin_array *out)
{
    const char *path = torch->file->path;

    if (!v)
        return spin_not_found("cannot read '%s': it contains no '%s'", path, what);
    if (v->kind != SPIN_VALUE_TENSOR)
        return spin_malformed("cannot read '%s': '%s' is not a tensor", path, what);
    *out = v->tensor;
    return out->storage ? bind_storage(torch, out) : SPIN_OK;
}

spin_status spin_torch_tensor_of(struct spin_torch *torch, const struct spin_value *v,
                                 const char *what, int n_dims, const int64_t *shape,
                                 struct spin_array *out)
{
    char got[160], wanted[160];

    SPIN_TRY(spin_torch_tensor(torch, v, what, out));
    if (spin_array_has_shape(out, n_dims, shape))
        return SPIN_OK;
    spin_array_shape_text(out->n_dims, out->shape, got, sizeof got);
    spin_array_shape_text(n_dims, (const uint64_t *)shape, wanted, sizeof wanted);
    return spin_malformed("cannot read '%s': tensor '%s' has shape %s, expected %s",
                          torch->file->path, what, got, wanted);
}

spin_status spin_torch_floats(struct spin_torch *torch, const struct spin_value *v,
                              const char *what, int n_dims, const int64_t *shape,
                              struct spin_array *info, float **out)
{
    struct spin_array local, *t = info ? info : &local;
    uint64_t bad = 0;
    size_t bytes;

    *out = NULL;
    SPIN_TRY(spin_torch_tensor_of(torch, v, what, n_dims, shape, t));
    if (t->kind != 'f' && t->kind != 'B')
        return spin_unsupported("cannot read '%s': tensor '%s' is not floating-point",
                                torch->file->path, what);
    if (!spin_mul_size((size_t)t->count, sizeof **out, &bytes) ||
        !(*out = malloc(bytes ? bytes : 1)))
        return spin_fail(SPIN_E_MEMORY,
                         "cannot read '%s': not enough memory for the %llu numbers of '%s'",
                         torch->file->path, (unsigned long long)t->count, what);
    spin_array_to_f32(t, 0, t->count, *out);
    for (uint64_t i = 0; i < t->count; i++)
        bad += !isfinite((*out)[i]);
    if (bad == 0)
        return SPIN_OK;
    free(*out);
    *out = NULL;
    return spin_malformed("cannot read '%s': tensor '%s' has %llu values that are not finite",
                          torch->file->path, what, (unsigned long long)bad);
}
