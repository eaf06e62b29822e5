/* Clips of splat files: a folder with a file for each frame, or one file with one frame or many. What
 * importers of such formats have in common; a format says how one file is read. */
#ifndef SPIN_IMPORTERS_LIB_SPLAT_FILES_H
#define SPIN_IMPORTERS_LIB_SPLAT_FILES_H

#include "formats/gaussian.h"
#include "io/file.h"
#include "importers/lib/file_sequence.h"

/* What a file holds. */
struct spin_splat_file {
    const char *path; /* given; of what else open() needs */
    size_t n_frames;  /* 1 but in a clip */
    int sh_degree;    /* that read() gives at most */
    bool antialias;   /* trained to be drawn antialiased */
    bool has_axes;    /* the file says which it has: */
    double axes[4];   /* the turn w x y z from them to the run's */
    const char *
        note[4]; /* what is guessed or lost; of all files alike, each is said once. NULL: nothing */
};

struct spin_splat_format {
    const char *suffix; /* ".spz" */
    const char *name;   /* "SPZ", for messages */
    size_t self_bytes;  /* of what stands for an open file; zero at first */
    /* A file in memory, borrowed until close(), which also follows a failure. Errors do not name it. */
    spin_status (*open)(void *self, const struct spin_map *map, struct spin_splat_file *out);
    /* Of a frame: how many splats; of a clip also number (or -1) and time. */
    void (*info)(const void *self, size_t frame, struct spin_frame_info *out);
    spin_status (*read)(void *self, size_t frame, unsigned columns, struct spin_splats *out);
    void (*close)(void *self);
};

/* How sure, by names alone: a file that ends so, or a folder with such files. In the folder of a run, which has
 * clouds of its own, they were laid beside it. */
int spin_splat_files_probe(const struct spin_splat_format *format, const struct spin_peek *peek);
/* As an importer's open(), frame() and close(). turn: w x y z, from the axes of files that do not say theirs
 * to the run's; NULL: none. */
spin_status spin_splat_files_open(const struct spin_splat_format *format, const double *turn,
                                  const char *path, void **self,
                                  struct spin_sequence_info *sequence);
spin_status spin_splat_files_frame(void *self, int frame, double time, unsigned columns,
                                   struct spin_splats *out);
void spin_splat_files_close(void *self);

#endif
