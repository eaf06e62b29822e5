/* The centring and scale of nerfstudio: its data parsers move a scene before the training, and
 * write the transform to dataparser_transforms.json. A run then does not fit the cameras of its
 * data set. The functions of this header transform the splats back. */
#pragma once

#include "formats/gaussian.h"

#define SPIN_PARSER_FILE "dataparser_transforms.json"

/* Searches for SPIN_PARSER_FILE in the run at `input`, in the two folders above it and, if `data`
 * is not NULL, in the folder `data`. Sets *found to whether there is a transform other than the
 * identity, *path to its file, which the caller frees, and *out to the placement that undoes it.
 * `data_from` is the importer of the data set: the poses that "transforms" reads include
 * applied_transform, those of other importers do not. If spin-export wrote the frames of the run,
 * they are in the world of the data set already, and the file is ignored. */
spin_status spin_parser_find(const char *input, const char *data, const char *data_from,
                             struct spin_placement *out, char **path, bool *found);

/* Sets *out to a copy of the 4D splats that is moved by the placement. The caller frees *out, also
 * if the call fails. */
spin_status spin_splats_4d_place(const struct spin_splats_4d *from, const struct spin_placement *p,
                                 struct spin_splats_4d *out);
