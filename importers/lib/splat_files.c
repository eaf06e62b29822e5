#include "importers/lib/splat_files.h"

#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "base/mem.h"
#include "importers/lib/model.h"

struct clip {
    const struct spin_splat_format *format;
    const double *turn; /* NULL: none */
    struct spin_file_sequence files;
    int n_frames, sh_degree;
    struct spin_frame_info *info; /* [n_frames] */
    int *numbers;                 /* [n_frames] */
    double *times;                /* [n_frames] */
    size_t *counts;               /* [n_frames] */

    /* The file at hand. */
    size_t file; /* SIZE_MAX: none */
    struct spin_map map;
    struct spin_splat_file opened;
    void *self;
    struct spin_splats raw; /* as the file has them */
};

int spin_splat_files_probe(const struct spin_splat_format *format, const struct spin_peek *peek)
{
    bool run = false;

    if (!peek->is_folder)
        return spin_file_has_suffix(peek->path, format->suffix) ? 70 : 0;
    for (size_t i = 0; peek->names && peek->names[i]; i++)
        run = run || strncmp(peek->names[i], "point_cloud", 11) == 0 ||
              strncmp(peek->names[i], "iteration_", 10) == 0;
    return spin_file_sequence_count(peek, format->suffix) == 0 ? 0 : run ? 20 : 70;
}

/* ---- Files ----------------------------------------------------------------------------------- */

static void close_file(struct clip *clip)
{
    if (clip->file == SIZE_MAX)
        return;
    clip->format->close(clip->self);
    memset(clip->self, 0, clip->format->self_bytes);
    spin_map_close(&clip->map);
    clip->file = SIZE_MAX;
}

static spin_status fail_file(const struct clip *clip, size_t file, spin_status status)
{
    return spin_fail_context(status, "cannot read '%s'", clip->files.frame[file].path);
}

/* Files of a clip are read one after the other: the last one stays open. */
static spin_status open_file(struct clip *clip, size_t file)
{
    spin_status status;

    if (clip->file == file)
        return SPIN_OK;
    close_file(clip);
    SPIN_TRY(spin_map_open(clip->files.frame[file].path, &clip->map));
    clip->file = file;
    clip->opened = (struct spin_splat_file){.path = clip->files.frame[file].path, .n_frames = 1};
    status = clip->format->open(clip->self, &clip->map, &clip->opened);
    if (status != SPIN_OK) {
        close_file(clip);
        return fail_file(clip, file, status);
    }
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status reserve_frames(struct clip *clip, size_t n)
{
    if (n > INT_MAX)
        return spin_fail(SPIN_E_UNSUPPORTED, "'%s': too many frames", clip->files.frame[0].path);
    clip->n_frames = (int)n;
    SPIN_TRY(spin_alloc(n, sizeof *clip->info, (void **)&clip->info));
    SPIN_TRY(spin_alloc(n, sizeof *clip->numbers, (void **)&clip->numbers));
    SPIN_TRY(spin_alloc(n, sizeof *clip->times, (void **)&clip->times));
    return spin_alloc(n, sizeof *clip->counts, (void **)&clip->counts);
}

/* Numbers and times of the frames of one file: its own where they tell all frames apart. */
static void describe_clip(const struct clip *clip, struct spin_sequence_info *sequence)
{
    bool numbered = true;

    for (int i = 0; i < clip->n_frames; i++) {
        clip->numbers[i] = clip->info[i].number;
        clip->times[i] = clip->info[i].time;
        numbered = numbered && clip->numbers[i] >= 0 &&
                   (i == 0 || clip->numbers[i] > clip->numbers[i - 1]);
    }
    sequence->numbers = numbered ? clip->numbers : NULL;
    sequence->times = clip->times;
    sequence->time_first = clip->times[0];
    sequence->time_last = clip->times[clip->n_frames - 1];
}

static void describe_files(const struct clip *clip, struct spin_sequence_info *sequence)
{
    for (int i = 0; i < clip->n_frames; i++)
        clip->numbers[i] = clip->files.frame[i].number;
    if (clip->n_frames == 1 && clip->numbers[0] < 0)
        clip->numbers[0] = clip->info[0].number;
    sequence->numbers = clip->numbers[0] >= 0 ? clip->numbers : NULL;
    sequence->time_last = clip->n_frames - 1;
}

/* What the first file says and what is only seen in another. */
static void note_file(struct clip *clip, size_t file, struct spin_sequence_info *sequence)
{
    const struct spin_splat_file *f = &clip->opened;

    if (file > 0 && f->sh_degree != clip->sh_degree && !strstr(sequence->notes, "padded"))
        spin_note(sequence, "the SH degree differs between frames: padded with zeros");
    for (size_t i = 0; i < sizeof f->note / sizeof *f->note; i++)
        if (f->note[i] && !strstr(sequence->notes, f->note[i]))
            spin_note(sequence, "%s", f->note[i]);
    if (f->antialias && !sequence->antialias)
        spin_note(sequence, "trained with an anti-aliasing rasteriser, and drawn so here");
    sequence->antialias = sequence->antialias || f->antialias;
    clip->sh_degree = f->sh_degree > clip->sh_degree ? f->sh_degree : clip->sh_degree;
}

static spin_status look_at_files(struct clip *clip, struct spin_sequence_info *sequence)
{
    size_t n_files = clip->files.n_frames;

    for (size_t i = 0; i < n_files; i++) {
        SPIN_TRY(open_file(clip, i));
        if (i == 0)
            SPIN_TRY(reserve_frames(clip, n_files > 1 ? n_files : clip->opened.n_frames));
        if (n_files > 1 && clip->opened.n_frames > 1)
            return spin_fail(SPIN_E_MALFORMED, "'%s' holds a clip of %zu frames: give it alone",
                             clip->files.frame[i].path, clip->opened.n_frames);
        for (size_t f = 0; f < clip->opened.n_frames; f++) {
            clip->format->info(clip->self, f, &clip->info[i + f]);
            clip->counts[i + f] = clip->info[i + f].n;
        }
        note_file(clip, i, sequence);
    }
    return SPIN_OK;
}

static spin_status describe(struct clip *clip, struct spin_sequence_info *sequence)
{
    size_t n_all = 0;

    for (int i = 0; i < clip->n_frames; i++)
        n_all += clip->counts[i];
    if (n_all == 0)
        return spin_fail(SPIN_E_MALFORMED, "'%s': 0 splats", clip->files.frame[0].path);
    if (clip->files.n_frames == 1 && clip->n_frames > 1)
        describe_clip(clip, sequence);
    else
        describe_files(clip, sequence);
    sequence->n_frames = clip->n_frames;
    sequence->counts = clip->counts;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->sh_degree = clip->sh_degree;
    snprintf(sequence->variant, sizeof sequence->variant, "%s %s%s",
             clip->files.n_frames == 1 ? "one" : "a sequence of", clip->format->name,
             clip->files.n_frames > 1 ? " files"
             : clip->n_frames > 1     ? " file with a clip"
                                      : " file");
    return SPIN_OK;
}

spin_status spin_splat_files_open(const struct spin_splat_format *format, const double *turn,
                                  const char *path, void **self,
                                  struct spin_sequence_info *sequence)
{
    struct clip *clip;

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof *clip, self));
    clip = *self;
    clip->format = format;
    clip->turn = turn;
    clip->file = SIZE_MAX;
    SPIN_TRY(spin_alloc(1, format->self_bytes, &clip->self));
    SPIN_TRY(spin_file_sequence_find(path, format->suffix, &clip->files));
    SPIN_TRY(spin_file_sequence_sort(&clip->files, sequence));
    SPIN_TRY(look_at_files(clip, sequence));
    return describe(clip, sequence);
}

void spin_splat_files_close(void *self)
{
    struct clip *clip = self;

    if (!clip)
        return;
    close_file(clip);
    spin_file_sequence_free(&clip->files);
    spin_splats_free(&clip->raw);
    free(clip->info);
    free(clip->numbers);
    free(clip->times);
    free(clip->counts);
    free(clip->self);
    free(clip);
}

/* ---- One frame ------------------------------------------------------------------------------- */

spin_status spin_splat_files_frame(void *self, int frame, double time, unsigned columns,
                                   struct spin_splats *out)
{
    struct clip *clip = self;
    struct spin_placement placement = {.q = {1}, .scale = 1};
    size_t file = clip->files.n_frames > 1 ? (size_t)frame : 0, within = (size_t)frame - file;
    spin_status status;

    (void)time;
    if (frame < 0 || frame >= clip->n_frames)
        return spin_fail(SPIN_E_NOT_FOUND, "there is no frame %d", frame);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(open_file(clip, file));
    status = within < clip->opened.n_frames
                 ? clip->format->read(clip->self, within, columns, &clip->raw)
                 : spin_fail(SPIN_E_IO, "it changed");
    if (status != SPIN_OK)
        return fail_file(clip, file, status);
    if (clip->raw.n != clip->counts[frame] || clip->raw.sh_degree > clip->sh_degree)
        return spin_fail(SPIN_E_IO, "'%s' changed while it was being read",
                         clip->files.frame[file].path);
    SPIN_TRY(spin_splats_reserve(out, clip->raw.n, columns, clip->sh_degree));
    if (clip->opened.has_axes)
        memcpy(placement.q, clip->opened.axes, sizeof placement.q);
    else if (clip->turn)
        memcpy(placement.q, clip->turn, sizeof placement.q);
    spin_splats_place(&clip->raw, columns, &placement, 0, out);
    out->antialias = clip->opened.antialias;
    return SPIN_OK;
}
