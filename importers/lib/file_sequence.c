/* File sequences: recognising, listing and sorting the files of a clip. */
#include "importers/lib/file_sequence.h"

#include <strings.h>

bool spin_file_has_suffix(const char *name, const char *suffix)
{
    return spin_text_ends_any_case(name, suffix);
}

/* Whether a file is a frame: its name ends with `suffix`, and it is neither hidden nor "input.ply",
 * the point cloud from which training started. */
static bool is_frame_name(const char *name, const char *suffix)
{
    return name[0] != '.' && spin_file_has_suffix(name, suffix) && strcmp(name, "input.ply") != 0;
}

int spin_file_sequence_count(const struct spin_peek *peek, const char *suffix)
{
    int n = 0;

    for (size_t i = 0; peek->names && peek->names[i]; i++)
        n += is_frame_name(peek->names[i], suffix);
    return n;
}

int spin_file_named(const struct spin_peek *peek, const char *suffix)
{
    return (peek->is_folder ? spin_file_sequence_count(peek, suffix) > 0
                            : spin_file_has_suffix(peek->path, suffix))
               ? 70
               : 0;
}

bool spin_file_begins(const struct spin_peek *peek, const char *magic)
{
    return !peek->is_folder && peek->n_head >= strlen(magic) &&
           memcmp(peek->head, magic, strlen(magic)) == 0;
}

spin_status spin_file_sequence_reserve(struct spin_model *m, struct spin_file_sequence *seq,
                                       size_t n)
{
    *seq = (struct spin_file_sequence){0};
    return spin_model_alloc(m, n, sizeof *seq->frame, (void **)&seq->frame);
}

spin_status spin_file_sequence_add(struct spin_file_sequence *seq, const char *path,
                                   long long number)
{
    if (number > INT_MAX)
        return spin_unsupported("'%s': frame number %lld is too large", path, number);
    seq->frame[seq->n_frames++] = (struct spin_file_frame){.path = path, .number = (int)number};
    return SPIN_OK;
}

spin_status spin_file_sequence_list(struct spin_model *m, const char *folder, const char *suffix,
                                    struct spin_file_sequence *seq)
{
    char **names;
    size_t n;

    SPIN_TRY(spin_model_names(m, folder, &names, &n));
    SPIN_TRY(spin_file_sequence_reserve(m, seq, n));
    for (size_t i = 0; i < n; i++) {
        const char *path;

        if (!is_frame_name(names[i], suffix))
            continue;
        SPIN_TRY(spin_model_join(m, &path, folder, "%s", names[i]));
        SPIN_TRY(spin_file_sequence_add(seq, path, spin_path_number(names[i])));
    }
    return SPIN_OK;
}

spin_status spin_file_sequence_find(struct spin_model *m, const char *path, const char *suffix,
                                    struct spin_file_sequence *seq)
{
    if (!spin_path_is_folder(path)) {
        SPIN_TRY(spin_model_text(m, &path, "%s", path));
        SPIN_TRY(spin_file_sequence_reserve(m, seq, 1));
        return spin_file_sequence_add(seq, path, spin_path_number(path));
    }
    SPIN_TRY(spin_file_sequence_list(m, path, suffix, seq));
    if (seq->n_frames == 0)
        return spin_not_found("'%s' contains no %s files", path, suffix);
    return SPIN_OK;
}

spin_status spin_file_sequence_one(struct spin_model *m, const char *path, const char *suffix,
                                   const char **out)
{
    struct spin_file_sequence files = {0};

    SPIN_TRY(spin_file_sequence_find(m, path, suffix, &files));
    if (files.n_frames > 1)
        return spin_unsupported("'%s' contains %zu clips: give one of the files", path,
                                files.n_frames);
    *out = files.frame[0].path;
    return SPIN_OK;
}

static int by_number(const void *a, const void *b)
{
    const struct spin_file_frame *x = a, *y = b;

    if (x->number != y->number)
        return x->number < y->number ? -1 : 1;
    return strcmp(x->path, y->path);
}

spin_status spin_file_sequence_sort(struct spin_file_sequence *seq,
                                    struct spin_sequence_info *sequence)
{
    const struct spin_file_frame *f;
    size_t n_numbered = 0;
    long long missing;

    qsort(seq->frame, seq->n_frames, sizeof *seq->frame, by_number);
    f = seq->frame;
    for (size_t i = 0; i < seq->n_frames; i++)
        n_numbered += f[i].number >= 0;
    if (n_numbered == 0) {
        if (seq->n_frames > 1)
            spin_note(sequence, "file names have no numbers: frames are in the order of the names");
        return SPIN_OK;
    }
    if (n_numbered < seq->n_frames)
        return spin_malformed("'%s' has no frame number in its name, but '%s' has: a folder must "
                              "contain the frames of one clip only",
                              f[0].path, spin_path_name(f[seq->n_frames - 1].path));
    for (size_t i = 1; i < seq->n_frames; i++) {
        if (f[i].number == f[i - 1].number)
            return spin_malformed("'%s' and '%s' are both frame %d", f[i - 1].path, f[i].path,
                                  f[i].number);
    }
    missing = (long long)f[seq->n_frames - 1].number - f[0].number + 1 - (long long)seq->n_frames;
    for (size_t i = 1; missing > 0 && i < seq->n_frames; i++) {
        if (f[i].number > f[i - 1].number + 1) {
            spin_note(sequence, "frame numbers have gaps: %lld are missing, the first is %d",
                      missing, f[i - 1].number + 1);
            break;
        }
    }
    return SPIN_OK;
}
