/* Dynamic 3D Gaussians (Luiten et al., 3DV 2024): a run is one params.npz.
 *
 * Positions, colours and rotations are stored per frame, opacities and scales once (forks store
 * them per frame too: the number of dimensions tells). Colours are plain RGB, not SH, and may leave
 * 0..1: they become degree-0 SH unclamped. */
#include <string.h>

#include "importers/lib/d3dgs_run.h"

static int probe(const struct spin_peek *peek)
{
    bool mask = spin_d3dgs_has_key(peek, "mask"); /* TC3DGS */
    int found = spin_d3dgs_count_keys(peek);

    if (peek->is_folder)
        return spin_peek_has(peek, "params.npz") && !mask ? 60 : 0;
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

static spin_status open_run(void *self, const char *path)
{
    /* What the run holds and splats do not. */
    static const struct {
        const char *key, *what;
    } lost[] = {
        {"mask", "array 'mask' (TC3DGS) is ignored: every Gaussian is present in every frame"},
        {"cam_m", "the per-camera colour corrections (cam_m, cam_c) are not imported"},
        {"seg_colors", "the flags of foreground and background (seg_colors) are not imported"},
    };
    struct d3dgs_run *run = self;
    struct spin_sequence_info *sequence = run->base.sequence;

    SPIN_TRY(spin_fail_reading(spin_d3dgs_load(path, run), run->base.path));
    snprintf(sequence->variant, sizeof sequence->variant, "Dynamic 3D Gaussians, %llu Gaussians",
             (unsigned long long)run->n);
    for (size_t i = 0; i < sizeof lost / sizeof *lost; i++) {
        if (spin_npz_has(&run->npz, lost[i].key))
            spin_note(sequence, "%s", lost[i].what);
    }
    return SPIN_OK;
}

SPIN_MODEL_OPEN(d3dgs_open, struct d3dgs_run, open_run)

static spin_status d3dgs_frame(void *self, int frame, double time, unsigned columns,
                               struct spin_splats *out)
{
    (void)time;
    return spin_d3dgs_read(self, frame, columns, out);
}

const struct spin_importer spin_importer_d3dgs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "d3dgs",
    .summary = "Dynamic 3D Gaussians: params.npz, or the folder it lies in",
    .upstream = "JonathonLuiten/Dynamic3DGaussians 7dbbd4d",
    .probe = probe,
    .open = d3dgs_open,
    .frame = d3dgs_frame,
    .close = spin_d3dgs_close,
};
