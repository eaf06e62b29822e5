/* Any bytes as a bundle: open, read every frame, and the splats that its network makes of each.  K:
 * fuzz bundle */
#include "io/file.h"
#include "render/player.h"
#include "scene/dataset.h"
#include "tests/fuzz/input.h"

#include <stdlib.h>
#include <string.h>

enum { MOST = 1000 }; /* splats of a frame that the network is asked for */

static size_t number(const uint8_t *p, int bytes)
{
    size_t v = 0;

    for (int i = 0; i < bytes; i++)
        v |= (size_t)p[i] << 8 * i;
    return v;
}

/* Give stored members the checksum of what they hold: without it no changed byte of an array gets
 * through. */
static void mend_checksums(uint8_t *data, size_t n)
{
    for (size_t at = 0; at + 46 <= n; at++) {
        uint8_t *entry = data + at;
        size_t size, from, names;
        uint32_t crc;

        if (memcmp(entry, "PK\1\2", 4) != 0 || number(entry + 10, 2) != 0)
            continue;
        size = number(entry + 24, 4);
        from = number(entry + 42, 4);
        if (from + 30 > n)
            continue;
        names = number(data + from + 26, 2) + number(data + from + 28, 2);
        if (from + 30 + names + size > n)
            continue;
        crc = spin_crc32(0, data + from + 30 + names, size);
        for (int i = 0; i < 4; i++)
            entry[16 + i] = (uint8_t)(crc >> 8 * i);
    }
}

static void evaluate(struct spin_bundle *bundle)
{
    static struct spin_device device;
    struct spin_player renderer;
    struct spin_splats splats = {0};

    if (!device.op && spin_device_open("cpu", 1, &device) != SPIN_OK)
        abort();
    if (spin_player_open(&renderer, &device, bundle, SPIN_FROM_TRAINED) != SPIN_OK)
        return;
    for (int f = 0; f < bundle->meta.n_frames; f++) {
        size_t n = spin_bundle_count(bundle, f, SPIN_FROM_TRAINED);

        if (n <= MOST &&
            spin_player_splats(&renderer, f, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, &splats) ==
                SPIN_OK &&
            splats.n != n)
            abort();
    }
    spin_splats_free(&splats);
    spin_player_close(&renderer);
}

static void read_bundle(struct spin_bundle *bundle)
{
    struct spin_splats splats = {0};
    char *data_path = NULL;

    for (int f = 0; f < bundle->meta.n_frames; f++) {
        if (spin_bundle_frame(bundle, f, bundle->meta.columns, &splats) == SPIN_OK &&
            splats.n != bundle->meta.frame[f].n)
            abort();
        if (bundle->refined.columns &&
            spin_bundle_refined_frame(bundle, f, bundle->refined.columns, &splats) == SPIN_OK &&
            splats.n != bundle->refined.n[f])
            abort();
    }
    if (spin_bundle_is_trained(bundle))
        evaluate(bundle);
    (void)spin_bundle_data_path(bundle, &data_path);
    free(data_path);
    spin_splats_free(&splats);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    struct spin_bundle bundle;
    uint8_t *copy = malloc(n + 1);
    const char *path;

    if (!copy)
        return 0;
    memcpy(copy, data, n);
    mend_checksums(copy, n);
    path = input_path(copy, n);
    free(copy);
    if (!path || spin_bundle_open(path, &bundle) != SPIN_OK)
        return 0;
    read_bundle(&bundle);
    spin_bundle_close(&bundle);
    return 0;
}
