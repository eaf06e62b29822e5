/* The network of Deformable 3D Gaussians, which methods derived from it also use. It consists of
 * layers linear.* with one skip connection; its input is the encoding of a position followed by the
 * encoding of a time. */
#pragma once

#include "importers/lib/model.h"

struct deform_net {
    struct mlp_net linear; /* one layer has a skip connection from the input */
    int n_in, width;
    struct mlp_net time; /* the time network; time.n is 0 if there is none */
    int n_position;      /* number of inputs of `linear` that encode the position */
    int n_time;          /* number of further inputs of `linear`, which depend on time */
    float *inputs;   /* [n_time] the inputs that depend on time, for the current frame; followed by
                        scratch memory */
    int frequencies; /* number of frequencies in the encoding of time */
};

/* Loads the tensors of m->tensors whose names are m->prefix followed by linear.* or timenet.*. */
spin_status spin_deform_net_load(struct spin_model *m, struct deform_net *net);
/* Computes the inputs that depend on time, for all following blocks. */
void spin_deform_net_time(struct deform_net *net, float time);
/* Writes the inputs of the network for a block of points at the positions `at` to `in`, which has
 * space for the output of one layer after the inputs. */
void spin_deform_net_encode(const struct deform_net *net, const float *const at[MLP_BLOCK],
                            float *in);
