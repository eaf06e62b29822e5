/* The numbers in a list of names, as columns; used by numbered.c only. */
#pragma once

#include "spin.h"

/* A number with up to 36 digits before the decimal point. Its parts are compared in this order:
 * part[0], the digits above the last 18 before the point; part[1], these last 18 digits; part[2],
 * the first 18 digits after the point. */
struct spin_name_value {
    bool negative;
    uint64_t part[3];
};

/* A number in a name. */
struct spin_name_number {
    unsigned short at, n; /* position and length in the name, with a sign and decimals */
    unsigned short word;  /* index of the word of the name that contains the number */
    struct spin_name_value value;
};

/* A name, split into words at characters that are neither letters nor digits. */
struct spin_name_parts {
    const char *name;
    struct spin_name_number *number;
    size_t n_numbers;
    struct {
        unsigned short at, n;
    } * word;
    size_t n_words;
};

int spin_compare_values(const struct spin_name_value *a, const struct spin_name_value *b);
/* Splits a name. The arrays in *out are allocated. */
spin_status spin_name_split(const char *name, bool folder, struct spin_name_parts *out);
void spin_name_parts_free(struct spin_name_parts *parts);

/* The meaning of a number according to the words around it. NEVER: a score, a count of splats or an
 * iteration, which is never a frame number. OTHER: probably not a frame number, such as a version
 * or a camera. */
enum spin_name_rank {
    SPIN_RANK_NEVER,
    SPIN_RANK_OTHER,
    SPIN_RANK_PLAIN,
    SPIN_RANK_TIME,
    SPIN_RANK_FRAME
};
enum spin_name_rank spin_name_rank(const struct spin_name_parts *parts, size_t number);

/* Merges the numbers of a date, of a time or of both, which begin at number i in all n names, into
 * number i. Returns how many numbers were merged: 1 if there is no time stamp. */
size_t spin_name_merge_stamp(struct spin_name_parts *parts, size_t n, size_t i);
