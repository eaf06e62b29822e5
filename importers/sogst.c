/* Reads .sogst files, each of which contains a clip, and the PLY files that encoders of .sogst
 * read; src/formats/sogst.h describes both formats. */
#include "formats/sogst.h"
#include "importers/lib/file_sequence.h"

/* Players do not draw splats with a lower opacity. */
#define LEAST_OPACITY (1 / 255.0)

static bool is_ply(const unsigned char *head, size_t n)
{
    return n >= 4 && memcmp(head, "ply", 3) == 0;
}

static int probe(const struct spin_peek *peek)
{
    if (peek->is_folder)
        return spin_file_named(peek, ".sogst");
    if (is_ply(peek->head, peek->n_head))
        return spin_peek_contains(peek, " t_center") && spin_peek_contains(peek, " t_sigma") ? 100
                                                                                             : 0;
    if (!spin_zip_detect(peek->head, peek->n_head) || !strstr(peek->tail_names, "meta.json"))
        return 0;
    return spin_file_has_suffix(peek->path, ".sogst") || spin_peek_contains(peek, "\"sogst\"") ? 100
                                                                                               : 0;
}

static spin_status read_file(struct spin_model *m, const char *path, struct spin_sogst *sogst,
                             bool *ply)
{
    SPIN_LEAVES(spin_map_close) struct spin_map map = {0};

    SPIN_TRY(spin_map_open(path, &map));
    *ply = is_ply(map.data, map.size);
    SPIN_TRY(*ply ? spin_sogst_read_ply(path, sogst, &m->splats_4d)
                  : spin_sogst_read(map.data, map.size, sogst, &m->splats_4d));
    SPIN_TRY(spin_model_sound(m, &sogst->sound.sound));
    m->splats_4d.least_opacity = LEAST_OPACITY;
    return spin_model_finish_4d(m);
}

static spin_status open_file(void *self, const char *path)
{
    struct spin_model *m = self;
    const struct spin_splats_4d *s = &m->splats_4d;
    struct spin_sequence_info *sequence = m->sequence;
    struct spin_sogst sogst = {0};
    spin_status status;
    bool ply;

    SPIN_TRY(spin_file_sequence_one(m, path, ".sogst", &m->path));
    path = m->path;
    status = read_file(m, path, &sogst, &ply);
    free(sogst.sound.owned);
    SPIN_TRY_IN(status, "cannot read '%s'", path);
    sequence->time_first = sogst.first;
    sequence->time_last = sogst.last;
    sequence->fps = sogst.fps;
    sequence->n_clip_frames = (int)((sogst.last - sogst.first) * sogst.fps + 1.5);
    snprintf(sequence->variant, sizeof sequence->variant,
             "%s, %zu splats on paths of degree %d, %zu segments",
             ply ? "PLY for .sogst" : ".sogst", s->n, s->degree, sogst.n_segments);
    if (*sogst.sound.note)
        spin_note(sequence, "%s", sogst.sound.note);
    if (s->cov2d[0] > 0 && (s->cov2d[0] != 1 || s->cov2d[1] != 1))
        spin_note(sequence,
                  "trained with screen covariances scaled by %g and %g (cov2d_scale), which frames "
                  "cannot represent",
                  s->cov2d[0], s->cov2d[1]);
    return SPIN_OK;
}

SPIN_MODEL_IMPORTER(sogst, struct spin_model, open_file, spin_model_close,
                    .summary = ".sogst: 4D splats of a clip, or the PLY that its encoders read",
                    .upstream = "solipsist-studios/cumuli 07d2d04 (revision 14)", .probe = probe,
                    .frame = spin_model_slice, .splats_4d = spin_model_splats_4d)
