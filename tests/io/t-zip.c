/* Zip archives: good ones, malformed ones, our own.  K: io zip hostile
 *
 * Malformed archives are assembled here byte by byte, independently of the writer under test. */
#include <unistd.h>

#include "tests/check.h"
#include "tests/tap.h"

static char path[512];

/* ---- An archive in the making -------------------------------------------------------------- */

struct build {
    unsigned char data[1 << 16];
    size_t n, directory, count;
};

/* One member; what is written into headers can differ from what is true. */
struct entry {
    const char *name;
    size_t n_name; /* 0: strlen */
    int method, flags;
    const void *data;
    size_t packed, size;
    uint32_t crc;
    bool no_crc; /* keep crc as given */
    const char *local_name;
    size_t offset;     /* set by add_local */
    const void *extra; /* of the directory entry */
    size_t n_extra;
};

static uint32_t crc_of(const void *data, size_t n)
{
    uint32_t crc = 0xffffffffu;

    for (size_t i = 0; i < n; i++) {
        crc ^= ((const unsigned char *)data)[i];
        for (int k = 0; k < 8; k++)
            crc = crc >> 1 ^ (crc & 1 ? 0xedb88320u : 0);
    }
    return ~crc;
}

static void put_integer(struct build *b, uint64_t value, int n)
{
    for (int i = 0; i < n; i++, value >>= 8)
        b->data[b->n++] = (unsigned char)value;
}

static void put_bytes(struct build *b, const void *data, size_t n)
{
    if (n > 0)
        memcpy(b->data + b->n, data, n);
    b->n += n;
}

static void add_local(struct build *b, struct entry *e)
{
    const char *name = e->local_name ? e->local_name : e->name;
    size_t n_name = e->local_name || !e->n_name ? strlen(name) : e->n_name;

    if (!e->no_crc)
        e->crc = crc_of(e->data, e->size);
    e->offset = b->n;
    put_integer(b, 0x04034b50, 4);
    put_integer(b, 20, 2);
    put_integer(b, (uint64_t)e->flags, 2);
    put_integer(b, (uint64_t)e->method, 2);
    put_integer(b, 0, 8); /* time, date, crc: nobody may rely on these */
    put_integer(b, 0xffffffff, 4);
    put_integer(b, 0xffffffff, 4);
    put_integer(b, n_name, 2);
    put_integer(b, 3, 2);
    put_bytes(b, name, n_name);
    put_bytes(b, "xyz", 3); /* not a proper extra field, and of no interest */
    put_bytes(b, e->data, e->packed);
}

static void add_central(struct build *b, const struct entry *e)
{
    size_t n_name = e->n_name ? e->n_name : strlen(e->name);

    if (b->count++ == 0)
        b->directory = b->n;
    put_integer(b, 0x02014b50, 4);
    put_integer(b, 20, 2);
    put_integer(b, 20, 2);
    put_integer(b, (uint64_t)e->flags, 2);
    put_integer(b, (uint64_t)e->method, 2);
    put_integer(b, 0, 4);
    put_integer(b, e->crc, 4);
    put_integer(b, e->packed, 4);
    put_integer(b, e->size, 4);
    put_integer(b, n_name, 2);
    put_integer(b, e->n_extra, 2);
    put_integer(b, 0, 10);
    put_integer(b, e->offset, 4);
    put_bytes(b, e->name, n_name);
    put_bytes(b, e->extra, e->n_extra);
}

static void add_end(struct build *b, const char *comment)
{
    size_t size = b->n - b->directory;

    put_integer(b, 0x06054b50, 4);
    put_integer(b, 0, 4);
    put_integer(b, b->count, 2);
    put_integer(b, b->count, 2);
    put_integer(b, size, 4);
    put_integer(b, b->directory, 4);
    put_integer(b, strlen(comment), 2);
    put_bytes(b, comment, strlen(comment));
}

static void save(const struct build *b, size_t n)
{
    FILE *file = fopen(path, "wb");

    if (file) {
        fwrite(b->data, 1, n, file);
        fclose(file);
    }
}

/* An archive of one member. */
static void save_one(struct entry e)
{
    static struct build b;

    memset(&b, 0, sizeof b);
    add_local(&b, &e);
    add_central(&b, &e);
    add_end(&b, "");
    save(&b, b.n);
}

/* Opening, or else reading the first member with limit, must fail with this code and words. */
static void fails(spin_status want, const char *words, uint64_t limit, const char *what)
{
    struct spin_zip zip;
    const unsigned char *data;
    void *owned = NULL;
    spin_status status = spin_zip_open(path, &zip);

    if (status == SPIN_OK) {
        status = zip.n ? spin_zip_read(&zip, &zip.member[0], true, limit, &data, &owned) : SPIN_OK;
        ok(!owned || status == SPIN_OK, "%s: nothing is left to free", what);
        free(owned);
        spin_zip_close(&zip);
    }
    if (!ok(status == want && strstr(spin_last_error(), words) && strstr(spin_last_error(), path),
            "%s", what))
        printf("#   status %d, '%s', wanted '%s'\n", status, status ? spin_last_error() : "",
               words);
}

static int reads(const char *name, const void *want, size_t n, uint64_t limit)
{
    struct spin_zip zip;
    const struct spin_zip_member *m;
    const unsigned char *data;
    void *owned = NULL;
    int good = 0;

    if (spin_zip_open(path, &zip) != SPIN_OK) {
        printf("#   %s\n", spin_last_error());
        return 0;
    }
    m = spin_zip_find(&zip, name);
    if (m && spin_zip_read(&zip, m, true, limit, &data, &owned) == SPIN_OK)
        good = m->size == n && memcmp(data, want, n) == 0;
    else
        printf("#   %s\n", m ? spin_last_error() : "not found");
    free(owned);
    spin_zip_close(&zip);
    return good;
}

/* ---- Tests --------------------------------------------------------------------------------- */

static const char hello[] = "hello, splats";
enum { HELLO = sizeof hello - 1 };

/* Deflate's stored block: final, length, its complement, bytes. */
static const unsigned char hello_deflated[] = "\x01\x0d\x00\xf2\xffhello, splats";
enum { HELLO_DEFLATED = sizeof hello_deflated - 1 };

static struct entry stored(void)
{
    return (struct entry){.name = "a.npy", .data = hello, .packed = HELLO, .size = HELLO};
}

static struct entry deflated(void)
{
    return (struct entry){.name = "a.npy",
                          .method = 8,
                          .data = hello_deflated,
                          .packed = HELLO_DEFLATED,
                          .size = HELLO,
                          .no_crc = true,
                          .crc = crc_of(hello, HELLO)};
}

static void good_ones(void)
{
    static struct build b;
    struct entry e = stored(), f = deflated();
    struct spin_zip zip;

    save_one(stored());
    ok(reads("a.npy", hello, HELLO, 0), "reads a stored member; its local sizes are not trusted");
    save_one(deflated());
    ok(reads("a.npy", hello, HELLO, HELLO), "reads a deflated member");
    e.flags = 8;
    save_one(e);
    ok(reads("a.npy", hello, HELLO, 0), "a data descriptor does not matter");

    memset(&b, 0, sizeof b);
    e = stored();
    add_local(&b, &e);
    add_local(&b, &f);
    add_central(&b, &e);
    add_central(&b, &f);
    add_end(&b, "a comment with PK\5\6 in it, and PK\5\6 again, long enough to be an end record");
    save(&b, b.n);
    ok(reads("a.npy", hello, HELLO, 100),
       "of two members of one name, the last; comments are skipped");
    ok(spin_zip_open(path, &zip) == SPIN_OK && zip.n == 2 &&
           spin_zip_find(&zip, "a.npy") == &zip.member[1],
       "in the order of the directory");
    spin_zip_close(&zip);

    memset(&b, 0, sizeof b);
    add_end(&b, "");
    save(&b, b.n);
    ok(!reads("a.npy", hello, HELLO, 100), "an empty archive opens and has no members");
    ok(spin_zip_detect(b.data, 4), "and looks like one");
}

static void zip64(void)
{
    static struct build b;
    static const unsigned char extra[] = "\x99\x99\x02\x00zz\x01\x00\x18\x00"
                                         "\x0d\0\0\0\0\0\0\0\x0d\0\0\0\0\0\0\0\0\0\0\0\0\0\0";
    static const unsigned char one_size[] = "\x01\x00\x08\x00\0\0\0\0\0\0\0\0"
                                            "\x99\x99\x07\x00\0\0\0\0\0\0";
    struct entry e = stored();
    size_t end64;

    memset(&b, 0, sizeof b);
    add_local(&b, &e);
    e.size = e.packed = e.offset = 0xffffffff;
    e.extra = extra;
    e.n_extra = sizeof extra;
    add_central(&b, &e);
    end64 = b.n;
    put_integer(&b, 0x06064b50, 4);
    put_integer(&b, 44, 8);
    put_integer(&b, 45 | 45 << 16, 4);
    put_integer(&b, 0, 8);
    put_integer(&b, 1, 8);
    put_integer(&b, 1, 8);
    put_integer(&b, end64 - b.directory, 8);
    put_integer(&b, b.directory, 8);
    put_integer(&b, 0x07064b50, 4);
    put_integer(&b, 0, 4);
    put_integer(&b, end64, 8);
    put_integer(&b, 1, 4);
    put_integer(&b, 0x06054b50, 4);
    put_integer(&b, 0, 4);
    put_integer(&b, 0xffffffff, 4);
    put_integer(&b, 0xffffffffffffffffu, 8);
    put_integer(&b, 0, 2);
    save(&b, b.n);
    ok(reads("a.npy", hello, HELLO, 0), "reads zip64 records");

    b.data[end64 + 48] ^= 0x80;
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "outside the file", 0, "zip64: a directory outside the file");
    b.data[end64 + 48] ^= 0x80;
    b.data[end64 + 56 + 8 + 6] = 1;
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "zip64 end record", 0, "zip64: an end record outside the file");
    b.data[end64 + 56 + 8 + 6] = 0;
    b.data[end64 + 56 + 8] ^= 1;
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "zip64 end record", 0, "zip64: no end record where it should be");
    b.data[end64 + 56 + 8] ^= 1;
    b.data[end64 + 32 + 7] = b.data[end64 + 24 + 7] = 0x7f;
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "is too small for", 0, "zip64: 2^62 members in a few bytes");

    e = stored();
    e.size = e.packed = 0xffffffff;
    e.data = "";
    e.no_crc = true;
    memset(&b, 0, sizeof b);
    e.packed = 0;
    add_local(&b, &e);
    e.packed = 0xffffffff;
    add_central(&b, &e);
    add_end(&b, "");
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "'a.npy' lacks its zip64 sizes", 0, "zip64: the record is missing");
    e.packed = 0;
    memset(&b, 0, sizeof b);
    add_local(&b, &e);
    e.packed = 0xffffffff;
    e.extra = one_size;
    e.n_extra = sizeof one_size;
    add_central(&b, &e);
    add_end(&b, "");
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "'a.npy' lacks its zip64 sizes", 0,
          "zip64: the record is short, the other size is not taken from the next one");
}

static void lies(void)
{
    static struct build b;
    struct entry e, f;

    e = stored();
    e.no_crc = true;
    e.crc = 1;
    save_one(e);
    fails(SPIN_E_MALFORMED, "member 'a.npy' is damaged (its CRC differs)", 0, "a wrong CRC");
    e = stored();
    e.flags = 1;
    save_one(e);
    fails(SPIN_E_UNSUPPORTED, "'a.npy' is encrypted", 0, "an encrypted member");
    e = stored();
    e.method = 12;
    save_one(e);
    fails(SPIN_E_UNSUPPORTED, "unsupported method 12", 0, "an unknown method");
    e = stored();
    e.local_name = "b.npy";
    save_one(e);
    fails(SPIN_E_MALFORMED, "'a.npy' has a different name in its own header", 0,
          "another name in the local header");
    e = stored();
    e.name = "a\0.npy";
    e.n_name = 6;
    save_one(e);
    fails(SPIN_E_MALFORMED, "bad name", 0, "a zero byte in a name");
    e = stored();
    e.size--;
    save_one(e);
    fails(SPIN_E_MALFORMED, "its compressed and uncompressed sizes differ", 0,
          "stored with two sizes");

    memset(&b, 0, sizeof b);
    e = stored();
    add_local(&b, &e);
    e.packed = e.size = HELLO + 4;
    add_central(&b, &e);
    add_end(&b, "");
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "should have 17 bytes", 0, "a size beyond the directory");
    memset(&b, 0, sizeof b);
    e = stored();
    add_local(&b, &e);
    e.packed = e.size = HELLO + 2; /* the local extra hides it from the directory's arithmetic */
    e.offset = 0;
    add_central(&b, &e);
    add_end(&b, "");
    b.data[28] = 0xff;
    b.data[29] = 0xff;
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "'a.npy' is cut short", 0, "a local extra field beyond the file");
    e.offset = 1 << 20;
    memset(&b, 0, sizeof b);
    put_bytes(&b, "PK\3\4", 4);
    add_central(&b, &e);
    add_end(&b, "");
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "'a.npy' lies outside the file", 0, "a header outside the file");
    memset(&b, 0, sizeof b);
    put_integer(&b, 0, 64);
    e = stored();
    e.offset = 3;
    add_central(&b, &e);
    add_end(&b, "");
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "no header at the offset", 0, "no local header");

    memset(&b, 0, sizeof b);
    e = f = stored();
    add_local(&b, &e);
    f.name = "b.npy";
    f.offset = e.offset;
    f.crc = e.crc;
    add_central(&b, &e);
    add_central(&b, &f);
    add_end(&b, "");
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "overlap", 0, "two members on the same bytes");

    memset(&b, 0, sizeof b);
    e = stored();
    add_local(&b, &e);
    add_central(&b, &e);
    b.count = 2;
    add_end(&b, "");
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "is too small for 2 members", 0,
          "more members than the directory can hold");
    b.n -= 22;
    b.count = 0;
    add_end(&b, "");
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "are unused", 0, "fewer members than the directory holds");
    b.n -= 22;
    b.count = 1;
    b.data[b.directory + 28] = 200;
    add_end(&b, "");
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "directory is damaged", 0, "a name longer than its entry");
    memset(&b, 0, sizeof b);
    b.directory = 1000;
    b.n = 1000;
    add_end(&b, "");
    b.data[1000 + 12] = 1;
    save(&b, b.n);
    fails(SPIN_E_MALFORMED, "outside the file", 0, "a directory that runs into its end record");
}

static void bombs(void)
{
    struct entry e = deflated();

    e.size = HELLO - 1;
    save_one(e);
    fails(SPIN_E_MALFORMED, "cannot be decompressed", 100, "deflated data yields more than stated");
    e.size = HELLO + 1;
    save_one(e);
    fails(SPIN_E_MALFORMED, "cannot be decompressed", 100, "deflated data yields less than stated");
    e.size = 0xfffffff0;
    save_one(e);
    fails(SPIN_E_MALFORMED, "18 compressed bytes of member 'a.npy' cannot expand to 4294967280",
          UINT64_MAX, "a claim that deflate cannot keep is refused before memory is reserved");
    e.size = HELLO;
    save_one(e);
    fails(SPIN_E_UNSUPPORTED, "more than the 12 allowed", HELLO - 1, "more than the caller allows");
    e.packed--;
    save_one(e);
    fails(SPIN_E_MALFORMED, "cannot be decompressed", 100, "deflated data cut short");
    e = deflated();
    e.packed = HELLO_DEFLATED + 1; /* the NUL behind it */
    save_one(e);
    fails(SPIN_E_MALFORMED, "cannot be decompressed", 100,
          "bytes left after the end of deflated data");
    e = deflated();
    e.data = "\x07 no such block type";
    save_one(e);
    fails(SPIN_E_MALFORMED, "cannot be decompressed", 100, "deflated data that is none");
}

static void truncations(void)
{
    static struct build b;
    struct entry e = stored(), f = deflated();
    struct spin_zip zip;
    int refused = 0;

    memset(&b, 0, sizeof b);
    f.name = "b.npy";
    add_local(&b, &e);
    add_local(&b, &f);
    add_central(&b, &e);
    add_central(&b, &f);
    add_end(&b, "");
    for (size_t n = 0; n < b.n; n++) {
        save(&b, n);
        refused += spin_zip_open(path, &zip) == SPIN_E_MALFORMED && strstr(spin_last_error(), path);
    }
    ok(refused == (int)b.n, "each of %zu truncations is refused", b.n);
    save(&b, 0);
    fails(SPIN_E_MALFORMED, "the file is empty", 0, "an empty file");
}

/* Every byte changed in turn: opening and reading must return, and the CRC must guard the data. */
static void changes(void)
{
    static struct build b;
    struct entry e = stored(), f = deflated();
    int wrong = 0;

    memset(&b, 0, sizeof b);
    f.name = "b.npy";
    add_local(&b, &e);
    add_local(&b, &f);
    add_central(&b, &e);
    add_central(&b, &f);
    add_end(&b, "");
    for (size_t i = 0; i < b.n; i++) {
        for (int k = 0; k < 2; k++) {
            unsigned char old = b.data[i];
            struct spin_zip zip;

            b.data[i] = k ? (unsigned char)~old : old ^ 1;
            save(&b, b.n);
            b.data[i] = old;
            if (spin_zip_open(path, &zip) != SPIN_OK)
                continue;
            for (size_t m = 0; m < zip.n; m++) {
                const unsigned char *data;
                void *owned;

                if (spin_zip_read(&zip, &zip.member[m], true, 1 << 20, &data, &owned) == SPIN_OK)
                    wrong += zip.member[m].size != HELLO || memcmp(data, hello, HELLO) != 0;
                free(owned);
            }
            spin_zip_close(&zip);
        }
    }
    ok(wrong == 0, "a changed byte never yields other data");
}

/* ---- Our writer ---------------------------------------------------------------------------- */

static void write_all(bool odd)
{
    static const size_t size[] = {0, 1, 13, 64, 1000, 70000};
    static unsigned char data[70000];
    struct spin_zip_writer w;
    char name[80];

    for (size_t i = 0; i < sizeof data; i++)
        data[i] = (unsigned char)(i * 7 + i / 251);
    if (spin_zip_writer_open(path, true, &w) != SPIN_OK)
        return;
    for (size_t i = 0; i < sizeof size / sizeof size[0]; i++) {
        memset(name, 'n', sizeof name);
        snprintf(name + i * 9, 20, "/%zu.npy", i);
        spin_zip_member_begin(&w, name, size[i]);
        for (size_t at = 0; at < size[i];) {
            size_t piece = odd ? size[i] - at : size[i] - at < 999 ? size[i] - at : 999;

            spin_zip_member_write(&w, data + at, piece);
            at += piece;
        }
        if (spin_zip_member_end(&w) != SPIN_OK)
            printf("#   %s\n", spin_last_error());
    }
    if (spin_zip_writer_commit(&w) != SPIN_OK)
        printf("#   %s\n", spin_last_error());
}

static void writing(void)
{
    struct spin_zip zip;
    struct spin_map first, second;
    const unsigned char *data;
    void *owned;
    int aligned = 1, good = 1;
    char keep[600];

    write_all(false);
    if (!ok(spin_zip_open(path, &zip) == SPIN_OK && zip.n == 6, "reads what it wrote"))
        return;
    for (size_t i = 0; i < zip.n; i++) {
        good = good && spin_zip_read(&zip, &zip.member[i], true, 0, &data, &owned) == SPIN_OK &&
               !owned;
        if (!good)
            break;
        aligned = aligned && (size_t)(data - zip.map.data) % 64 == 0;
        for (size_t k = 0; k < zip.member[i].size; k++)
            good = good && data[k] == (unsigned char)(k * 7 + k / 251);
    }
    ok(good, "members come back, in place");
    ok(aligned, "64-byte aligned, whatever their names");
    spin_zip_close(&zip);

    snprintf(keep, sizeof keep, "%s.first", path);
    rename(path, keep);
    write_all(true);
    if (spin_map_open(keep, &first) == SPIN_OK && spin_map_open(path, &second) == SPIN_OK) {
        ok(first.size == second.size && memcmp(first.data, second.data, first.size) == 0,
           "equal content gives equal bytes");
        spin_map_close(&first);
        spin_map_close(&second);
    }
}

static void many_members(void)
{
    enum { N = 65540 };
    struct spin_zip_writer w;
    struct spin_zip zip;
    char name[16];
    int good = spin_zip_writer_open(path, true, &w) == SPIN_OK;

    for (int i = 0; good && i < N; i++) {
        snprintf(name, sizeof name, "%d", i);
        good = spin_zip_member_begin(&w, name, 0) == SPIN_OK && spin_zip_member_end(&w) == SPIN_OK;
    }
    good = good && spin_zip_writer_commit(&w) == SPIN_OK;
    ok(good, "writes %d members", N);
    good = spin_zip_open(path, &zip) == SPIN_OK;
    ok(good && zip.n == N && strcmp(zip.member[N - 1].name, "65539") == 0 &&
           spin_zip_find(&zip, "40000") == &zip.member[40000],
       "and finds them again (zip64)");
    spin_zip_close(&zip);
}

/* A deflated member of noise and zeros by turns: whole again, the noise as it was, the rest nearly
 * nothing; larger than any buffer on the way. */
static void runs(void)
{
    enum { PIECE = 40000, PIECES = 8 };
    static unsigned char bytes[PIECES * PIECE];
    struct spin_zip_writer w;
    struct spin_zip zip;
    const unsigned char *data = NULL;
    void *owned = NULL;
    uint32_t state = 1;
    int good;

    for (size_t i = 0; i < sizeof bytes; i++) {
        state = state * 1664525u + 1013904223u;
        bytes[i] = i / PIECE % 2 ? 0 : (unsigned char)(state >> 24);
    }
    good = spin_zip_writer_open(path, true, &w) == SPIN_OK &&
           spin_zip_member_begin_deflated(&w, "a", sizeof bytes) == SPIN_OK;
    if (good)
        spin_zip_member_runs(&w);
    for (size_t at = 0; good && at < sizeof bytes; at += PIECE / 2)
        good = spin_zip_member_write(&w, bytes + at, PIECE / 2) == SPIN_OK;
    good = good && spin_zip_member_end(&w) == SPIN_OK && spin_zip_writer_commit(&w) == SPIN_OK;
    ok(good && spin_zip_open(path, &zip) == SPIN_OK &&
           spin_zip_read(&zip, &zip.member[0], true, sizeof bytes, &data, &owned) == SPIN_OK &&
           memcmp(data, bytes, sizeof bytes) == 0,
       "noise and zeros by turns come back");
    ok(zip.member[0].packed_size < PIECES / 2 * (PIECE + 400),
       "of which the zeros take next to nothing: %llu",
       (unsigned long long)zip.member[0].packed_size);
    free(owned);
    spin_zip_close(&zip);
}

/* A member of several parts and many blocks, by one thread and by three: the same bytes, and whole
 * again. Its numbers repeat over the ends of parts, so that what lies before them matters. */
static void many_parts(void)
{
    enum { LONG = 17 << 20, PERIOD = 30001 };
    unsigned char *bytes = malloc(LONG);
    const unsigned char *data = NULL;
    struct spin_zip_writer w;
    struct spin_zip zip;
    void *owned[2] = {NULL, NULL};
    struct spin_digest file[2] = {{0, 1}, {0, 2}};
    struct spin_map map;
    uint32_t state = 1;
    bool good = bytes != NULL;

    for (size_t i = 0; good && i < LONG; i++) {
        state = state * 1664525u + 1013904223u;
        bytes[i] = i < PERIOD ? (unsigned char)(state >> 24) : bytes[i - PERIOD];
    }
    for (int k = 0; good && k < 2; k++) {
        good = spin_zip_writer_open(path, true, &w) == SPIN_OK;
        w.n_threads = k == 0 ? 1 : 3;
        good = good && spin_zip_member_begin_deflated(&w, "a", LONG) == SPIN_OK &&
               spin_zip_member_write(&w, bytes, LONG / 2 + 1) == SPIN_OK &&
               spin_zip_member_write(&w, bytes + LONG / 2 + 1, LONG - LONG / 2 - 1) == SPIN_OK &&
               spin_zip_member_end(&w) == SPIN_OK && spin_zip_writer_commit(&w) == SPIN_OK &&
               spin_map_open(path, &map) == SPIN_OK && spin_zip_open(path, &zip) == SPIN_OK;
        if (!good)
            break;
        file[k] = spin_map_digest(&map);
        spin_map_close(&map);
        ok(spin_zip_read(&zip, &zip.member[0], true, LONG, &data, &owned[k]) == SPIN_OK &&
               memcmp(data, bytes, LONG) == 0,
           "a member of %d MiB comes back, deflated by %d threads", LONG >> 20, 1 + 2 * k);
        ok(zip.member[0].packed_size < LONG / 100, "which repeats: %llu bytes are left",
           (unsigned long long)zip.member[0].packed_size);
        spin_zip_close(&zip);
    }
    ok(good && file[0].size == file[1].size && file[0].crc == file[1].crc,
       "and both archives are the same bytes");
    free(owned[0]);
    free(owned[1]);
    free(bytes);
}

static void misuse(void)
{
    struct spin_zip_writer w;

    spin_zip_writer_open(path, true, &w);
    spin_zip_member_begin(&w, "a", 4);
    ok(spin_zip_member_write(&w, "12345", 5) == SPIN_E_USAGE, "a member longer than announced");
    spin_zip_member_write(&w, "123", 3);
    ok(spin_zip_member_end(&w) == SPIN_E_USAGE, "a member shorter than announced");
    ok(spin_zip_member_begin(&w, "", 4) == SPIN_E_USAGE, "a member without a name");
    spin_zip_writer_abandon(&w);
    spin_zip_writer_open(path, true, &w);
    spin_zip_member_begin(&w, "a", 4);
    ok(spin_zip_writer_commit(&w) == SPIN_E_USAGE, "a commit inside a member");
    ok(spin_zip_writer_open("/none/x.zip", true, &w) == SPIN_E_NOT_FOUND,
       "no folder to write into");
}

static void large_header(void)
{
    struct spin_zip_writer w;
    unsigned char head[64] = {0};

    /* Only the header: its sizes must be saturated and the true ones in the zip64 record. */
    spin_zip_writer_open(path, true, &w);
    ok(spin_zip_member_begin(&w, "large", 0x123456789aULL) == SPIN_OK, "begins a member of 78 GB");
    fflush(w.out.file);
    ok(pread(fileno(w.out.file), head, 64, 0) == 64 &&
           memcmp(head + 18, "\xff\xff\xff\xff\xff\xff\xff\xff", 8) == 0 &&
           memcmp(head + 35, "\x01\0\x10\0\x9a\x78\x56\x34\x12\0\0\0\x9a\x78\x56\x34\x12\0\0\0",
                  20) == 0,
       "with zip64 sizes");
    ok(w.out.bytes % 64 == 0, "and aligned data");
    spin_zip_writer_abandon(&w);
}

TAP_MAIN
{
    snprintf(path, sizeof path, "%s/t.zip", check_folder());
    good_ones();
    zip64();
    lies();
    bombs();
    truncations();
    changes();
    writing();
    many_members();
    runs();
    many_parts();
    misuse();
    large_header();
}
