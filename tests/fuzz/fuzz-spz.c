/* Any bytes as an SPZ, all that is read is finite. What begins as versions 2 and 3 do when they are
 * unpacked is packed first: no fuzzer finds its way through a gzip. */
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

#include "formats/spz.h"

#define ALL (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES)

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void read_spz(const uint8_t *data, size_t size)
{
    static const char *const what[5] = {"", "", "", "", ""};
    struct spin_splats s = {0};
    double q[4];
    struct spin_spz_header header;

    if (spin_spz_peek(data, size, &header) == SPIN_OK)
        (void)spin_spz_axes(header.axes, q);
    if (spin_spz_read(data, size, ALL, &s) == SPIN_OK &&
        spin_check_columns(what, ALL, 0, s.n, &s) != SPIN_OK)
        abort();
    spin_splats_free(&s);
}

/* In blocks that are only stored. */
static void read_packed(const uint8_t *data, size_t size)
{
    z_stream z = {0};
    unsigned char *packed;
    size_t room;

    if (deflateInit2(&z, 0, Z_DEFLATED, MAX_WBITS + 16, 8, Z_DEFAULT_STRATEGY) != Z_OK)
        abort();
    room = deflateBound(&z, size);
    packed = malloc(room);
    z.next_in = (unsigned char *)(uintptr_t)data;
    z.avail_in = (uInt)size;
    z.next_out = packed;
    z.avail_out = (uInt)room;
    if (!packed || deflate(&z, Z_FINISH) != Z_STREAM_END)
        abort();
    read_spz(packed, room - z.avail_out);
    deflateEnd(&z);
    free(packed);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size >= 16 && memcmp(data, "NGSP", 4) == 0 && data[4] < 4)
        read_packed(data, size);
    else
        read_spz(data, size);
    return 0;
}
