#include "io/archive.h"

#include <zlib.h>

#include "base/base.h"

/* Prepares the inflater for the next gzip member; a file may consist of several members. */
static spin_status begin_member(struct spin_stream *s)
{
    z_stream *z;

    SPIN_TRY(spin_alloc(1, sizeof *z, &s->inflater));
    z = s->inflater;
    memset(z, 0, sizeof *z);
    if (inflateInit2(z, MAX_WBITS + 16) == Z_OK)
        return SPIN_OK;
    free(s->inflater);
    s->inflater = NULL;
    return spin_fail(SPIN_E_MEMORY, "not enough memory to decompress data");
}

static void end_member(struct spin_stream *s)
{
    if (s->inflater)
        inflateEnd(s->inflater);
    free(s->inflater);
    s->inflater = NULL;
}

static bool begins_gzip(const struct spin_stream *s)
{
    return s->map.size - s->at >= 2 && s->map.data[s->at] == 0x1f && s->map.data[s->at + 1] == 0x8b;
}

spin_status spin_stream_open(const char *path, uint64_t limit, struct spin_stream *out)
{
    *out = (struct spin_stream){.path = path, .limit = limit};
    SPIN_TRY(spin_map_open(path, &out->map));
    out->is_gzip = begins_gzip(out);
    return SPIN_OK;
}

void spin_stream_close(struct spin_stream *s)
{
    end_member(s);
    spin_map_close(&s->map);
}

/* Decompresses up to n bytes of the current gzip member. */
static spin_status inflate_some(struct spin_stream *s, unsigned char *out, size_t n, size_t *got)
{
    z_stream *z = s->inflater;
    size_t left = s->map.size - s->at;
    int result;

    z->next_in = (unsigned char *)(uintptr_t)(s->map.data + s->at);
    z->avail_in = (uInt)(left < UINT32_MAX / 2 ? left : UINT32_MAX / 2);
    z->next_out = out;
    z->avail_out = (uInt)(n < UINT32_MAX / 2 ? n : UINT32_MAX / 2);
    result = inflate(z, Z_NO_FLUSH);
    *got = (size_t)(z->next_out - out);
    s->at = (size_t)(z->next_in - s->map.data);
    if (result == Z_MEM_ERROR)
        return spin_fail(SPIN_E_MEMORY, "not enough memory to decompress data");
    if (result == Z_STREAM_END)
        end_member(s);
    else if (result != Z_OK || (*got == 0 && s->at == s->map.size))
        return spin_malformed("'%s' is damaged or cut short after %llu decompressed bytes", s->path,
                              (unsigned long long)(s->n_out + *got));
    return SPIN_OK;
}

static spin_status read_gzip(struct spin_stream *s, unsigned char *out, size_t n, size_t *got)
{
    while (*got < n && (s->inflater || begins_gzip(s))) {
        size_t some = 0;

        if (!s->inflater)
            SPIN_TRY(begin_member(s));
        SPIN_TRY(inflate_some(s, out + *got, n - *got, &some));
        *got += some;
    }
    return SPIN_OK;
}

spin_status spin_stream_read(struct spin_stream *s, void *out, size_t n, size_t *got)
{
    size_t left = s->map.size - s->at;

    *got = 0;
    if (s->is_gzip) {
        SPIN_TRY(read_gzip(s, out, n, got));
    } else {
        *got = n < left ? n : left;
        memcpy(out, s->map.data + s->at, *got);
        s->at += *got;
    }
    s->n_out += *got;
    if (s->n_out > s->limit)
        return spin_malformed(
            "cannot unpack '%s': it contains more than %llu bytes, far more than its "
            "own size suggests; if you trust it, unpack it yourself",
            s->path, (unsigned long long)s->limit);
    return SPIN_OK;
}
