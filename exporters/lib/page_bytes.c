#include "exporters/lib/page_bytes.h"

#include "base/base.h"

enum { PLANES = 7, FROM_OTHER = 16, FROM_COLUMN = 32 };

void spin_page_bytes_free(struct spin_page_bytes *b)
{
    free(b->data);
    *b = (struct spin_page_bytes){0};
}

static spin_status room_for(struct spin_page_bytes *b, size_t more)
{
    size_t room = b->n + more;

    if (room <= b->room)
        return SPIN_OK;
    room += room / 2;
    SPIN_TRY(spin_grow(room, 1, (void **)&b->data));
    b->room = room;
    return SPIN_OK;
}

static inline uint32_t folded(int32_t d)
{
    return d < 0 ? 2 * (uint32_t)(-(int64_t)d) - 1 : 2 * (uint32_t)d;
}

static inline int32_t unfolded(uint32_t u)
{
    return u & 1 ? (int32_t)(-(int64_t)(u >> 1) - 1) : (int32_t)(u >> 1);
}

/* Returns an estimate of the number of bits that the zigzag code u needs after compression: its bit
 * length plus 2, or 0 if u is zero. */
static inline unsigned cost_of(uint32_t u) { return u ? 34 - (unsigned)__builtin_clz(u) : 0; }

static int planes_of(uint32_t all)
{
    return all >> 24 ? 4 : all >> 16 ? 3 : all >> 8 ? 2 : all != 0;
}

/* ---- Keys ------------------------------------------------------------------------------------ */

spin_status spin_page_encode_whole(struct spin_page_bytes *b, const int32_t *x, size_t n)
{
    uint64_t plain = 0, step = 0;
    uint32_t all[2] = {0, 0};
    int by_step, planes;

    for (size_t i = 0; i < n; i++) {
        uint32_t u = folded(x[i]), d = folded(x[i] - (i ? x[i - 1] : 0));

        plain += cost_of(u);
        step += cost_of(d);
        all[0] |= u;
        all[1] |= d;
    }
    by_step = step < plain;
    planes = planes_of(all[by_step]);
    SPIN_TRY(room_for(b, 1 + (size_t)planes * n));
    b->data[b->n++] = (uint8_t)(planes | (by_step ? FROM_OTHER : 0));
    for (size_t i = 0; i < n; i++) {
        uint32_t u = folded(x[i] - (by_step && i ? x[i - 1] : 0));

        for (int p = 0; p < planes; p++)
            b->data[b->n + (size_t)p * n + i] = (uint8_t)(u >> 8 * p);
    }
    b->n += (size_t)planes * n;
    return SPIN_OK;
}

static spin_status too_short(void) { return spin_malformed("a block of the page is truncated"); }

/* Reads the first byte of a column: sets *planes to the number of byte planes, and *from to the
 * flags of the predictor. allowed: the flags that this kind of column may have. */
static spin_status get_head(const uint8_t *data, size_t size, size_t *at, int allowed, int *planes,
                            int *from)
{
    if (*at >= size)
        return too_short();
    *planes = data[*at] & PLANES;
    *from = data[*at] & allowed;
    if (*planes > 4 || data[(*at)++] & ~(PLANES | allowed))
        return spin_malformed("a block of the page has a column of an unknown kind");
    return SPIN_OK;
}

static inline uint32_t number_at(const uint8_t *data, size_t n, size_t i, int planes)
{
    uint32_t u = 0;

    for (int p = 0; p < planes; p++)
        u |= (uint32_t)data[(size_t)p * n + i] << 8 * p;
    return u;
}

static spin_status get_column(const uint8_t *data, size_t size, size_t *at, int allowed, int32_t *x,
                              const int32_t *other, size_t n)
{
    int planes = 0, from = 0;

    SPIN_TRY(get_head(data, size, at, allowed, &planes, &from));
    if (planes && (size - *at) / (size_t)planes < n)
        return too_short();
    for (size_t i = 0; i < n; i++)
        x[i] = (int32_t)((uint32_t)unfolded(number_at(data + *at, n, i, planes)) +
                         (from & FROM_OTHER && i ? (uint32_t)x[i - 1] : 0));
    for (size_t i = 0; i < n && from & FROM_COLUMN; i++)
        x[i] = (int32_t)((uint32_t)x[i] + (uint32_t)other[i]);
    *at += (size_t)planes * n;
    return SPIN_OK;
}

spin_status spin_page_decode_whole(const uint8_t *data, size_t size, size_t *at, int32_t *x,
                                   size_t n)
{
    return get_column(data, size, at, FROM_OTHER, x, NULL, n);
}

spin_status spin_page_decode_column(const uint8_t *data, size_t size, size_t *at, int32_t *x,
                                    const int32_t *other, size_t n)
{
    return get_column(data, size, at, FROM_OTHER | (other ? FROM_COLUMN : 0), x, other, n);
}

/* ---- Columns of rows ------------------------------------------------------------------------- */

/* Returns the zigzag code of x[i] minus its prediction. With FROM_COLUMN, x is replaced by the
 * difference x - other. With FROM_OTHER, the prediction is the number in row i - 1 (of x or, with
 * both flags, of the difference); otherwise it is 0. */
static inline uint32_t column_number(const int32_t *x, const int32_t *other, int from, size_t i)
{
    uint32_t now = (uint32_t)x[i] - (from & FROM_COLUMN ? (uint32_t)other[i] : 0), last = 0;

    if (from & FROM_OTHER && i)
        last = (uint32_t)x[i - 1] - (from & FROM_COLUMN ? (uint32_t)other[i - 1] : 0);
    return folded((int32_t)(now - last));
}

/* Returns the size in bits that an ideal entropy coder would give the byte planes. Sets *all to the
 * bitwise OR of all zigzag codes. */
static double entropy_of(const int32_t *x, const int32_t *other, int from, size_t n, uint32_t *all)
{
    size_t count[4][256] = {{0}};
    double bits = 0;

    *all = 0;
    for (size_t i = 0; i < n; i++) {
        uint32_t u = column_number(x, other, from, i);

        *all |= u;
        for (int p = 0; p < 4; p++)
            count[p][u >> 8 * p & 255]++;
    }
    for (int p = 0; p < 4; p++)
        for (int k = 0; k < 256; k++)
            if (count[p][k])
                bits -= (double)count[p][k] * log2((double)count[p][k] / (double)n);
    return bits;
}

spin_status spin_page_encode_column(struct spin_page_bytes *b, const int32_t *x,
                                    const int32_t *other, size_t n)
{
    static const int ways[] = {0, FROM_OTHER, FROM_COLUMN, FROM_COLUMN | FROM_OTHER};
    double least = HUGE_VAL;
    uint32_t all = 0, now;
    int from = 0, planes;

    for (int k = 0; k < (other ? 4 : 2); k++) {
        double bits = entropy_of(x, other, ways[k], n, &now);

        if (bits < least) {
            least = bits;
            all = now;
            from = ways[k];
        }
    }
    planes = planes_of(all);
    SPIN_TRY(room_for(b, 1 + (size_t)planes * n));
    b->data[b->n++] = (uint8_t)(planes | from);
    for (size_t i = 0; i < n; i++) {
        uint32_t u = column_number(x, other, from, i);

        for (int p = 0; p < planes; p++)
            b->data[b->n + (size_t)p * n + i] = (uint8_t)(u >> 8 * p);
    }
    b->n += (size_t)planes * n;
    return SPIN_OK;
}

/* ---- Differences ----------------------------------------------------------------------------- */

/* Returns the prediction of number i: its value in the previous frame or, if by_mean is true, its
 * moving average, which is s->mean[i] / 16. */
static inline int32_t predicted(const struct spin_page_state *s, size_t i, bool by_mean)
{
    return by_mean ? (s->mean[i] + 8) >> 4 : s->last[i];
}

static inline void update_state(struct spin_page_state *s, size_t i, int32_t x)
{
    s->last[i] = x;
    s->mean[i] += (int32_t)((uint32_t)x * 16 - (uint32_t)s->mean[i]) >> 1;
}

spin_status spin_page_encode_changes(struct spin_page_bytes *b, const int32_t *x, size_t n,
                                     struct spin_page_state *state)
{
    uint64_t cost[2] = {0, 0};
    size_t n_other[2] = {0, 0}, k = 0, listed;
    uint32_t all[2] = {0, 0};
    uint8_t *mask, *list;
    int by, planes;

    for (size_t i = 0; i < n; i++)
        for (by = 0; by < 2; by++) {
            uint32_t u = folded(x[i] - predicted(state, i, by));

            cost[by] += cost_of(u);
            n_other[by] += u != 0;
            all[by] |= u;
        }
    by = cost[1] < cost[0];
    listed = n_other[by];
    planes = planes_of(all[by]);
    SPIN_TRY(room_for(b, 1 + (n + 7) / 8 + (size_t)planes * listed));
    b->data[b->n++] = (uint8_t)(planes | (by ? FROM_OTHER : 0));
    mask = b->data + b->n;
    list = mask + (n + 7) / 8;
    if (planes)
        memset(mask, 0, (n + 7) / 8);
    for (size_t i = 0; i < n; i++) {
        uint32_t u = folded(x[i] - predicted(state, i, by));

        update_state(state, i, x[i]);
        if (u == 0)
            continue;
        mask[i / 8] |= (uint8_t)(1 << i % 8);
        for (int p = 0; p < planes; p++)
            list[(size_t)p * listed + k] = (uint8_t)((u - 1) >> 8 * p);
        k++;
    }
    if (planes)
        b->n += (n + 7) / 8 + (size_t)planes * listed;
    return SPIN_OK;
}

spin_status spin_page_decode_changes(const uint8_t *data, size_t size, size_t *at, size_t n,
                                     struct spin_page_state *state)
{
    const uint8_t *mask = data + *at + 1;
    size_t n_mask = (n + 7) / 8, listed = 0, k = 0;
    int planes = 0, by = 0;

    SPIN_TRY(get_head(data, size, at, FROM_OTHER, &planes, &by));
    if (planes) {
        if (size - *at < n_mask)
            return too_short();
        for (size_t i = 0; i < n_mask; i++)
            listed += (size_t)__builtin_popcount(mask[i]);
        *at += n_mask;
        if (listed > n || size - *at < (size_t)planes * listed)
            return too_short();
    }
    for (size_t i = 0; i < n; i++) {
        int32_t x = predicted(state, i, by);

        if (planes && mask[i / 8] >> i % 8 & 1)
            x = (int32_t)((uint32_t)x +
                          (uint32_t)unfolded(number_at(data + *at, listed, k++, planes) + 1));
        update_state(state, i, x);
    }
    *at += (size_t)planes * listed;
    return SPIN_OK;
}
