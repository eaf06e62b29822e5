/* Any bytes as a TSOG; what begins with a brace as the meta.json of one.
 * K: fuzz tsog */
#include "formats/tsog.h"
#include "tests/fuzz/sog_4d.h"

static void read_tsog(const void *data, size_t size)
{
    struct spin_splats_4d splats = {0};
    struct spin_tsog clip;

    if (spin_tsog_read(data, size, &clip, &splats) == SPIN_OK)
        look_at_splats(&splats, 0, clip.time == SPIN_TSOG_CONTINUOUS ? 1 : clip.n_frames - 1);
    spin_splats_4d_free(&splats);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size > 0 && data[0] == '{' && size < FUZZ_ROOM / 2) {
        const struct fuzz_zip *zip = zip_around(data, size);

        read_tsog(zip->data, zip->n);
    } else {
        read_tsog(data, size);
    }
    return 0;
}
