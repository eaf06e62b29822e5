#include "run/share_splats.h"

#include "io/ranks.h"
#include "scene/columns.h"

struct head {
    uint64_t n;
    int32_t sh_degree, antialias;
};

spin_status spin_share_splats(struct spin_splats *splats, unsigned columns, int from)
{
    bool receives = spin_rank() == 0;
    struct head head = {splats->n, splats->sh_degree, splats->antialias};
    struct spin_message m[8];
    size_t n = 0;

    if (from == 0 || (!receives && spin_rank() != from))
        return SPIN_OK;
    m[0] = (struct spin_message){receives ? from : 0, receives, &head, sizeof head};
    SPIN_TRY(spin_ranks_exchange(m, 1));
    if (receives) {
        SPIN_TRY(spin_splats_reserve(splats, head.n, columns, head.sh_degree));
        splats->antialias = head.antialias != 0;
    }
    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1)
        if (columns & column)
            m[n++] = (struct spin_message){m[0].peer, receives, *spin_column_of(splats, column),
                                           head.n * spin_column_width(column, head.sh_degree) *
                                               sizeof(float)};
    return spin_ranks_exchange(m, n);
}
