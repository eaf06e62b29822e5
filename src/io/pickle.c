/* The machine put together. */
#include "io/pickle.h"

#include <string.h>

#include "io/pickle_legacy.h"
#include "io/pickle_run.h"

static spin_status parse(const char *what, const unsigned char *bytes, size_t n, bool legacy,
                         struct spin_pickle *out)
{
    struct spin_pickle_machine m = {.what = what,
                                    .start = bytes,
                                    .p = bytes,
                                    .op = bytes,
                                    .end = bytes + n,
                                    .arena = &out->arena,
                                    .load_from_bytes = spin_pickle_load_from_bytes};
    spin_status status;

    memset(out, 0, sizeof *out);
    if (legacy) {
        m.budget = BUDGET; /* the rest is storages, which are not copied */
        SPIN_TRY_OUT(spin_pickle_run_legacy(&m, out));
    } else {
        m.budget = n < SIZE_MAX - BUDGET ? BUDGET + n : BUDGET;
        SPIN_TRY_OUT(spin_pickle_run(&m, &out->root));
        SPIN_TRY_OUT(spin_pickle_keep_storages(&m, out));
    }
    out->used = (size_t)(m.p - bytes);
out:
    spin_pickle_release(&m);
    if (status != SPIN_OK)
        spin_pickle_free(out);
    return status;
}

spin_status spin_pickle_parse(const char *what, const unsigned char *bytes, size_t n,
                              struct spin_pickle *out)
{
    return parse(what, bytes, n, false, out);
}

spin_status spin_pickle_parse_legacy(const char *what, const unsigned char *bytes, size_t n,
                                     struct spin_pickle *out)
{
    return parse(what, bytes, n, true, out);
}
