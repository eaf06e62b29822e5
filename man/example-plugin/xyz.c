/* An exporter of splat positions as text, one per line, to OUT/frame_00000.xyz and so on. --colour
 * adds red, green and blue, 0 to 255.
 *
 * See spin-plugin(7); everything that is called here is declared in spin.h. */
#include <spin.h>
#include <stdlib.h>

struct export
{
    char folder[4000];
    bool force, sync, colour;
};

static spin_status xyz_begin(const struct spin_export_job *job, void **self)
{
    struct export *x = calloc(1, sizeof *x);

    if (!x)
        return spin_fail(SPIN_E_MEMORY, "no memory");
    snprintf(x->folder, sizeof x->folder, "%s", job->output);
    x->force = job->force;
    x->sync = job->sync;
    x->colour = spin_plugin_value(job->values, "colour", NULL) != NULL;
    *self = x;
    return SPIN_OK;
}

/* 0 to 255, from SH of degree 0 */
static int byte_of(float sh)
{
    float v = (0.5f + 0.28209479f * sh) * 255;

    return v > 255 ? 255 : v > 0 ? (int)(v + 0.5f) : 0;
}

/* Only spin_out_commit() gives the file its final name, once it is complete. */
static spin_status xyz_frame(void *self, int frame, const struct spin_frame_info *info,
                             const struct spin_splats *splats)
{
    struct export *x = self;
    size_t n_sh = (size_t)(splats->sh_degree + 1) * (size_t)(splats->sh_degree + 1);
    struct spin_out out;
    char path[4096];

    (void)frame;
    SPIN_TRY(spin_folder_make(x->folder));
    snprintf(path, sizeof path, "%s/frame_%05d.xyz", x->folder, info->number);
    SPIN_TRY(spin_out_open(path, x->force, &out));
    out.sync = x->sync;
    for (size_t i = 0; i < splats->n; i++) {
        const float *p = splats->means + 3 * i, *sh = splats->sh + 3 * n_sh * i;

        fprintf(out.file, "%.9g %.9g %.9g", (double)p[0], (double)p[1], (double)p[2]);
        if (x->colour)
            fprintf(out.file, " %d %d %d", byte_of(sh[0]), byte_of(sh[1]), byte_of(sh[2]));
        fputc('\n', out.file);
    }
    return spin_out_commit(&out);
}

static spin_status xyz_end(void *self)
{
    free(self);
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    {"colour", NULL, "add red, green and blue, 0 to 255", NULL},
    {0},
};

static const struct spin_exporter xyz = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "xyz",
    .summary = "places as text, one .xyz per frame",
    .options = options,
    .wants = SPIN_COL_MEANS | SPIN_COL_SH,
    .begin = xyz_begin,
    .frame = xyz_frame,
    .end = xyz_end,
    .abort = free,
};

/* The symbol that spin4d looks up. */
const struct spin_plugin spin_plugin = {
    .abi = SPIN_PLUGIN_ABI,
    .exporters = (const struct spin_exporter *const[]){&xyz, NULL},
};
