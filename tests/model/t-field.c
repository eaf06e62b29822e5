/* The network's layout, first values and meta.json; the order of points.
 * K: core */

#include "geometry/neighbours.h"
#include "model/field.h"
#include "tests/check.h"
#include "tests/tap.h"

static void check_plan(void)
{
    const int base[4] = {8, 8, 8, 8}, finest[4] = {2048, 2048, 2048, 150};
    const int bad[4] = {8, 8, 8, 4};
    struct spin_field m;

    ok(spin_field_plan(&m, 16, 4, 21, 64, 3, base, finest) == SPIN_OK, "plans the paper's network");
    ok(m.grid.offset[16] == 24223187 || fabs(m.grid.offset[16] - 24.2e6) < 0.1e6,
       "24.2 M rows at 2^21 with time 150 (got %u)", m.grid.offset[16]);
    ok(m.n_heads == 36920, "36,920 parameters in the heads (got %zu)", m.n_heads);
    ok(m.grid.res[15][0] == 2048 && m.grid.res[15][3] == 150,
       "the finest level is exactly as asked");
    ok(spin_field_plan(&m, 16, 4, 21, 64, 3, base, bad) == SPIN_E_USAGE,
       "finest below base: usage");
    ok(spin_field_plan(&m, 16, 3, 21, 64, 3, base, finest) == SPIN_E_USAGE, "3 features: usage");
    ok(spin_field_plan(&m, 33, 4, 21, 64, 3, base, finest) == SPIN_E_USAGE, "33 levels: usage");
    ok(spin_field_plan(&m, 16, 4, 40, 64, 3, base, finest) == SPIN_E_USAGE, "2^40 rows: usage");
}

static void check_first_values(void)
{
    const int base[4] = {4, 4, 4, 4}, finest[4] = {16, 16, 16, 4};
    struct spin_field m;
    float *table, *heads, *again, worst = 0;

    ok(spin_field_plan(&m, 4, 4, 10, 64, 3, base, finest) == SPIN_OK, "plans a small one");
    table = malloc(2 * m.n_table * sizeof *table);
    heads = malloc(2 * m.n_heads * sizeof *heads);
    again = heads + m.n_heads;
    spin_field_init(&m, 7, 1e-4, -5, table, heads);
    spin_field_init(&m, 7, 1e-4, -5, table + m.n_table, again);
    check_same_bits(table, table + m.n_table, m.n_table * sizeof *table, "the same seed, table");
    check_same_bits(heads, again, m.n_heads * sizeof *heads, "the same seed, heads");
    spin_field_init(&m, 8, 1e-4, -5, table + m.n_table, again);
    ok(memcmp(table, table + m.n_table, m.n_table * sizeof *table) != 0, "another seed differs");
    for (size_t i = 0; i < m.n_table; i++)
        worst = larger(worst, fabsf(table[i]));
    ok(worst <= 1e-4f && worst > 0.99e-4f, "the table fills +-1e-4");
    near(heads[m.heads.offset[1] - 1], -5, 0, "bias of the scale");
    near(heads[m.heads.offset[2] - 4], 1, 0, "bias of the rotation, w");
    near(heads[m.heads.offset[2] - 1], 0, 0, "bias of the rotation, z");
    near(heads[m.n_heads - 1], -2.1972246, 1e-6, "bias of the opacity");
    free(table);
    free(heads);
}

/* PyTorch's Linear: weights and biases within 1 / sqrt(inputs). */
static void check_bounds(void)
{
    const int base[4] = {2, 2, 2, 2};
    struct spin_field m;
    float *table, *heads, first = 0, second = 0;
    size_t n_first, n_second;

    ok(spin_field_plan(&m, 4, 4, 8, 64, 0, base, base) == SPIN_OK, "sixteen inputs, 64 wide");
    table = malloc(m.n_table * sizeof *table);
    heads = malloc(m.n_heads * sizeof *heads);
    spin_field_init(&m, 3, 1e-4, -5, table, heads);
    n_first = 64 * 17;
    n_second = 64 * 65;
    for (size_t i = 0; i < n_first; i++)
        first = larger(first, fabsf(heads[i]));
    for (size_t i = n_first; i < n_first + n_second; i++)
        second = larger(second, fabsf(heads[i]));
    ok(first <= 0.25f && first > 0.245f, "first layer: within 1 / sqrt(16)");
    ok(second <= 0.125f && second > 0.1225f, "second layer: within 1 / sqrt(64)");
    free(table);
    free(heads);
}

static void check_times(void)
{
    struct spin_field m = {.time_first = 10, .time_last = 30};

    near(spin_field_time(&m, 10), 0, 0, "the first time is 0");
    near(spin_field_time(&m, 15), 0.25, 1e-7, "a quarter of the way");
    near(spin_field_time(&m, 30), 1, 0, "the last is 1");
    ok(spin_field_time(&m, 5) == 0 && spin_field_time(&m, 99) == 1, "none lies outside");
    m.time_last = 10;
    near(spin_field_time(&m, 10), 0, 0, "a clip of one time is at 0");
}

static void check_json(void)
{
    const int base[4] = {8, 8, 8, 8}, finest[4] = {512, 512, 512, 16};
    struct spin_field m, back;
    spin_json *j, *net, *parsed = NULL;
    bool there;
    char *text;

    ok(spin_field_plan(&m, 8, 4, 14, 32, 2, base, finest) == SPIN_OK, "plans");
    m.transform.centre[1] = -1.3f;
    m.transform.inv_radius = 0.37f;
    m.time_last = 17;
    m.transform.raw = m.heads.relu = true;
    j = spin_field_to_json(&m, true);
    net = (spin_json *)spin_json_get(j, "field");
    text = spin_json_text(j, false);
    ok(spin_json_parse("trained", text, strlen(text), &parsed) == SPIN_OK, "its JSON parses");
    ok(spin_field_from_json(parsed, &back, &there) == SPIN_OK && there, "and reads back");
    check_same_bits(&m.grid, &back.grid, sizeof m.grid, "the same grid");
    check_same_bits(&m.transform, &back.transform, sizeof m.transform, "the same norm");
    ok(back.transform.raw && back.heads.relu, "what the ablations change");
    ok(back.n_heads == m.n_heads && back.n_table == m.n_table && back.sh_degree == 2,
       "the same sizes");
    spin_json_free(parsed);
    spin_json_set_integer(net, "hidden", 1 << 20);
    ok(spin_field_from_json(j, &back, &there) == SPIN_E_MALFORMED,
       "a huge hidden width is malformed");
    spin_json_set_integer(net, "hidden", 32);
    spin_json_set_string(net, "activation", "tanh");
    ok(spin_field_from_json(j, &back, &there) == SPIN_E_UNSUPPORTED, "another activation: %s",
       spin_last_error());
    spin_json_set_string(net, "activation", "gelu");
    spin_json_set(net, "offset", spin_json_array());
    ok(spin_field_from_json(j, &back, &there) == SPIN_E_MALFORMED, "no offsets is malformed");
    spin_json_free(j);
    m.antialias = true;
    j = spin_field_to_json(&m, false);
    ok(spin_json_is_null(spin_json_get(j, "field")) &&
           spin_field_from_json(j, &back, &there) == SPIN_OK && !there && back.sh_degree == 2 &&
           back.antialias && back.n_table == 0,
       "without a network: the degree of SH and how splats are drawn");
    spin_json_set_integer(j, "sh_degree", 4);
    ok(spin_field_from_json(j, &back, &there) == SPIN_E_MALFORMED, "SH of degree 4");
    spin_json_free(j);
    free(text);
}

/* One level of 4 x 4 x 4 x 3 vertices, with one of its members other than it should be. */
static spin_status level_with(const char *key, const char *value)
{
    const int base[4] = {4, 4, 4, 3};
    struct spin_field m, back;
    spin_json *j, *other = NULL;
    spin_status status;
    bool there;

    if (spin_field_plan(&m, 1, 4, 8, 4, 0, base, base) != SPIN_OK)
        return SPIN_OK;
    j = spin_field_to_json(&m, true);
    if (spin_json_parse(key, value, strlen(value), &other) == SPIN_OK)
        spin_json_set((spin_json *)spin_json_get(j, "field"), key, other);
    status = spin_field_from_json(j, &back, &there);
    spin_json_free(j);
    return status;
}

/* A level must be what its numbers say: rows beyond the table are not read, on any device. */
static void check_levels(void)
{
    static const char *const bad[][2] = {
        {"hashed", "[1]"}, /* though every vertex has its row */
        {"hashed", "[2]"},
        {"hashed", "[0.5]"},
        {"offset", "[0, 191]"}, /* a row too few for its vertices */
        {"offset", "[0, 192.5]"},
        {"offset", "[0, 0.5]"},
        {"offset", "[0, 4294967488]"}, /* 2^32 + 192 */
        {"offset", "[0, -192]"},
        {"offset", "[1, 193]"},
        {"res", "[[4, 4, 4, 4]]"},
        {"res", "[[4, 4, 4, 3.5]]"},
        {"res", "[[3, 4, 4, 3]]"},
        {"res", "[[65537, 65537, 65537, 65537]]"}, /* 2^64 and more vertices */
        {"res", "[[65536, 65536, 65536, 65536]]"}, /* 0 in 64 bits */
        {"scale", "[[3, 3, 3, 0.9]]"},
        {"scale", "[[3, 3, 3, 2.1]]"},
    };

    ok(level_with("hashed", "[0]") == SPIN_OK, "a dense level reads back");
    ok(level_with("offset", "[0.0, 192.0]") == SPIN_OK,
       "and with numbers as Python may write them");
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        ok(level_with(bad[i][0], bad[i][1]) == SPIN_E_MALFORMED, "%s %s: %s", bad[i][0], bad[i][1],
           spin_last_error());
}

static void check_morton(void)
{
    float points[4][3] = {{1, 1, 1}, {0, 0, 0}, {1, 0, 0}, {0, 0, 0}};
    uint32_t order[4];

    ok(spin_morton_order(4, points[0], order) == SPIN_OK, "orders four points");
    ok(order[0] == 1 && order[1] == 3 && order[2] == 2 && order[3] == 0,
       "origin first, ties by index, the far corner last");
    ok(spin_morton_order(0, points[0], order) == SPIN_OK, "no points is no trouble");
}

TAP_MAIN
{
    check_plan();
    check_first_values();
    check_bounds();
    check_times();
    check_json();
    check_levels();
    check_morton();
}
