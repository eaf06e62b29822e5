/* A frame as the page of html.c takes it: columns of few bits, packed one after the other.
 *
 *     16 bits  place x y z     u / (1 + |u|) of (place - centre) / size, -1..1 in 65535 steps
 *              colour r g b    -0.5..1.5 in 1024 steps, of the degree 0 term
 *              rotation        the three smaller of w x y z, -sqrt(1/2)..sqrt(1/2) in 4095 steps
 *      8 bits  scale x y z     log(scale / size), -12..2
 *              opacity         0..1
 *              rotation        which of w x y z is the largest
 *              sh              u / (1 + |u|), coefficient by coefficient, r g b within
 *
 * Nothing is out of range, so the steps are the same in every frame, and what stands still keeps its
 * numbers: against a frame before it (the key frame) it packs to almost nothing. Column by column the
 * differences are taken where they are smaller than the values' spread. */
#ifndef SPIN_EXPORTERS_LIB_HTML_PACK_H
#define SPIN_EXPORTERS_LIB_HTML_PACK_H

#include "formats/gaussian.h"

enum { SPIN_HTML_WIDE = 9, SPIN_HTML_NARROW = 5 };

/* The space that places and scales are written in. */
struct spin_html_space {
    double centre[3], size;
};

struct spin_html_frame {
    size_t n, room;
    uint16_t *wide;  /* [SPIN_HTML_WIDE][n] */
    uint8_t *narrow; /* [SPIN_HTML_NARROW + n_sh][n] */
};

spin_status spin_html_reserve(struct spin_html_frame *f, size_t n, int n_sh);

void spin_html_free(struct spin_html_frame *f);

/* Row i of the frame to write is this one. */
void spin_html_take(const struct spin_html_space *space, const struct spin_gaussian *row,
                    const float *sh, int n_sh, struct spin_html_frame *f, size_t i);

size_t spin_html_packed_size(size_t n, int n_sh);

/* The block's bytes before gzip. key: a frame of as many rows, or NULL. */
void spin_html_pack(const struct spin_html_frame *f, const struct spin_html_frame *key, int n_sh,
                    uint8_t *out);

#endif
