/* Any bytes as a .sogst; what begins with a brace as the meta.json of one, what begins with "ply"
 * as its PLY. K: fuzz sogst */
#include "formats/sogst.h"
#include "tests/fuzz/input.h"
#include "tests/fuzz/sog_4d.h"

static void read_sogst(const uint8_t *data, size_t size, bool ply)
{
    struct spin_splats_4d splats = {0};
    struct spin_sogst clip;
    const char *path = ply ? input_path(data, size) : NULL;

    if ((path  ? spin_sogst_read_ply(path, &clip, &splats)
         : ply ? SPIN_E_IO
               : spin_sogst_read(data, size, &clip, &splats)) == SPIN_OK)
        look_at_splats(&splats, clip.first, clip.last);
    spin_splats_4d_free(&splats);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size > 0 && data[0] == '{' && size < FUZZ_ROOM / 2) {
        const struct fuzz_zip *zip = zip_around(data, size);

        read_sogst(zip->data, zip->n, false);
    } else {
        read_sogst(data, size, size > 3 && memcmp(data, "ply", 3) == 0);
    }
    return 0;
}
