/* A pickle machine that builds data and never runs code.
 *
 * Protocols 2 to 5. Globals are names, not things: the few that stand for plain data (OrderedDict,
 * torch's tensor rebuilders, numpy's array rebuilders, argparse.Namespace, ...) are known by a whitelist
 * and become values; any other is an error that names it, even when it is never called. Depth, memo,
 * lengths and the sum of all values are bounded by the size of the input. */
#ifndef SPIN_IO_PICKLE_H
#define SPIN_IO_PICKLE_H

#include "io/pickle_value.h"

/* `what` names it in messages. Storages stay unbound. To be freed with spin_pickle_free(). */
spin_status spin_pickle_parse(const char *what, const unsigned char *bytes, size_t n,
                              struct spin_pickle *out);
/* The raw stream that torch.save wrote before 1.6 (spin_pickle_is_legacy()): five pickles, then the
 * storages, whose data point into `bytes`. */
spin_status spin_pickle_parse_legacy(const char *what, const unsigned char *bytes, size_t n,
                                     struct spin_pickle *out);

#endif
