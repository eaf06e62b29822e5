/* File sequences: recognising, listing and sorting the files of a clip. */
#include "importers/lib/file_sequence.h"

#include <strings.h>

#include "io/numbered.h"

bool spin_file_has_suffix(const char *name, const char *suffix)
{
    return spin_text_ends_any_case(name, suffix);
}

/* Whether a file is a frame: its name ends with `suffix`, and it is not hidden. It is neither
 * "input.ply", the point cloud from which training started, nor "environment.sog", the sky of a
 * streamed SOG. */
static bool is_frame_name(const char *name, const char *suffix)
{
    return name[0] != '.' && spin_file_has_suffix(name, suffix) && strcmp(name, "input.ply") != 0 &&
           strcmp(name, "environment.sog") != 0;
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

void spin_file_sequence_add(struct spin_file_sequence *seq, const char *path, const char *name)
{
    seq->frame[seq->n_frames++] =
        (struct spin_file_frame){.path = path, .name = name, .number = -1};
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
        spin_file_sequence_add(seq, path, names[i]);
    }
    return SPIN_OK;
}

spin_status spin_file_sequence_find(struct spin_model *m, const char *path, const char *suffix,
                                    struct spin_file_sequence *seq)
{
    if (!spin_path_is_folder(path)) {
        SPIN_TRY(spin_model_text(m, &path, "%s", path));
        SPIN_TRY(spin_file_sequence_reserve(m, seq, 1));
        spin_file_sequence_add(seq, path, spin_path_name(path));
        return SPIN_OK;
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

/* Puts the frames into the order that `numbers` states, and stores their frame numbers. */
static spin_status reorder(struct spin_model *m, const struct spin_numbers *numbers,
                           struct spin_file_sequence *seq)
{
    struct spin_file_frame *frame;

    SPIN_TRY(spin_model_alloc(m, numbers->n_frames, sizeof *frame, (void **)&frame));
    for (size_t i = 0; i < numbers->n_frames; i++) {
        frame[i] = seq->frame[numbers->order[i]];
        frame[i].number = numbers->number[numbers->order[i]];
    }
    seq->frame = frame;
    seq->n_frames = numbers->n_frames;
    return SPIN_OK;
}

static void note_gaps(const struct spin_file_sequence *seq, struct spin_sequence_info *sequence)
{
    const struct spin_file_frame *f = seq->frame;
    long long missing =
        (long long)f[seq->n_frames - 1].number - f[0].number + 1 - (long long)seq->n_frames;

    for (size_t i = 1; missing > 0 && i < seq->n_frames; i++) {
        if (f[i].number > f[i - 1].number + 1) {
            spin_note(sequence,
                      "frame numbers have gaps: %lld numbers are missing, the first is %d", missing,
                      f[i - 1].number + 1);
            return;
        }
    }
}

/* Sets *out to the text of option `pattern` before the first slash, or to NULL if the option is not
 * given. */
static spin_status find_pattern(struct spin_model *m, const char **out)
{
    const char *pattern = spin_model_option(m, "pattern");

    *out = NULL;
    return pattern ? spin_model_text(m, out, "%.*s", (int)strcspn(pattern, "/"), pattern) : SPIN_OK;
}

spin_status spin_file_sequence_sort(struct spin_model *m, struct spin_file_sequence *seq,
                                    bool folders, struct spin_sequence_info *sequence)
{
    SPIN_LEAVES(spin_numbers_free) struct spin_numbers numbers = {0};
    struct spin_numbering names = {.n = seq->n_frames, .folders = folders};
    SPIN_FREED const char **name = NULL;

    if (seq->n_frames == 0)
        return SPIN_OK;
    SPIN_TRY(find_pattern(m, &names.pattern));
    SPIN_TRY(spin_alloc(seq->n_frames, sizeof *name, (void **)&name));
    for (size_t i = 0; i < seq->n_frames; i++)
        name[i] = seq->frame[i].name;
    names.name = name;
    SPIN_TRY_IN(spin_numbered_read(&names, &numbers), "'%s'", seq->frame[0].path);
    SPIN_TRY(reorder(m, &numbers, seq));
    if (seq->frame[0].number >= 0)
        note_gaps(seq, sequence);
    else if (seq->n_frames > 1)
        spin_note(sequence, "%s",
                  numbers.numbered
                      ? "the numbers in the file names are fractions, negative or too large for "
                        "frame numbers: they only determine the order of the frames"
                      : "file names have no numbers: frames are in the order of the "
                        "names");
    return SPIN_OK;
}
