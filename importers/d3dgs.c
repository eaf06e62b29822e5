/* Dynamic 3D Gaussians (Luiten et al., 3DV 2024): a run is one params.npz.
 *
 * Positions, colours and rotations are stored per frame, opacities and scales once (forks store
 * them per frame too: the number of dimensions tells). Colours are plain RGB, not SH, and may leave
 * 0..1: they become degree-0 SH unclamped. */
#include "base/err.h"
#include "importers/lib/d3dgs_run.h"
#include "base/mem.h"
#include "importers/lib/finite.h"
#include <stdlib.h>

static int probe(const struct spin_peek *peek)
{
    bool mask = spin_d3dgs_has_key(peek, "mask"); /* TC3DGS */
    int found = spin_d3dgs_count_keys(peek);

    if (peek->is_folder)
        return spin_d3dgs_has_file(peek, "params.npz") && !mask ? 60 : 0;
    if (mask || !spin_zip_looks_like(peek->head, peek->n_head))
        return 0;
    if (peek->tail_names[0] == '\0') /* cut short: open() can say so if the first member is ours */
        return memmem(peek->head, peek->n_head, "means3D.npy", 11) ? 30 : 0;
    if (spin_d3dgs_has_key(peek, "cam_unnorm_rots")) /* SplaTAM: open() says so */
        return found >= 3 ? 30 : 0;
    if (spin_d3dgs_has_key(peek, "means3D") && spin_d3dgs_has_key(peek, "unnorm_rotations"))
        return 90;
    return found >= 3 ? 60 : 0;
}

/* What the run holds and splats do not. */
static void note_lost(const struct d3dgs_run *run, struct spin_sequence_info *sequence)
{
    static const struct {
        const char *key, *what;
    } lost[] = {
        {"mask", "array 'mask' (TC3DGS) is ignored: every Gaussian is present in every frame"},
        {"cam_m", "the per-camera colour corrections (cam_m, cam_c) are not imported"},
        {"seg_colors", "the flags of foreground and background (seg_colors) are not imported"},
    };
    size_t used = 0;

    for (size_t i = 0; i < sizeof lost / sizeof *lost; i++) {
        if (spin_npz_has(&run->npz, lost[i].key))
            used += (size_t)snprintf(sequence->notes + used, sizeof sequence->notes - used, "%s\n",
                                     lost[i].what);
    }
}

static spin_status open_run(const char *path, struct d3dgs_run *run,
                            struct spin_sequence_info *sequence)
{
    SPIN_TRY(spin_d3dgs_load(path, run));
    SPIN_TRY(spin_d3dgs_describe(run, sequence));
    snprintf(sequence->variant, sizeof sequence->variant, "Dynamic 3D Gaussians, %llu Gaussians",
             (unsigned long long)run->n);
    note_lost(run, sequence);
    return SPIN_OK;
}

static spin_status d3dgs_open(const char *path, const struct spin_plugin_values *values,
                              void **self, struct spin_sequence_info *sequence)
{
    struct d3dgs_run *run;
    spin_status status;

    (void)values;
    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof *run, self));
    run = *self;
    status = open_run(path, run, sequence);
    return spin_fail_reading(status, run->path ? run->path : path);
}

static spin_status d3dgs_frame(void *self, int frame, double time, unsigned columns,
                               struct spin_splats *out)
{
    (void)time;
    return spin_d3dgs_read(self, frame, columns, out);
}

static void d3dgs_close(void *self)
{
    if (self)
        spin_d3dgs_release(self);
    free(self);
}

const struct spin_importer spin_importer_d3dgs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "d3dgs",
    .summary = "Dynamic 3D Gaussians: params.npz, or the folder it lies in",
    .upstream = "JonathonLuiten/Dynamic3DGaussians 7dbbd4d",
    .probe = probe,
    .open = d3dgs_open,
    .frame = d3dgs_frame,
    .close = d3dgs_close,
};
