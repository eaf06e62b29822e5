/* K: export quantisation */
#include "exporters/lib/quant_error.h"
#include "tests/tap.h"

/* The largest error of SH stays when later rows have smaller ones. */
static void test_sh(void)
{
    static const float first[] = {0.125f, -0.5f, 0.25f}, second[] = {0.25f, 0, 0};
    struct spin_quant_error q = {0};

    spin_quant_error_add_sh(&q, first, 3);
    spin_quant_error_add_sh(&q, second, 3);
    ok(q.part[SPIN_QUANT_SH].largest == 0.5, "the largest error of SH, of either sign");
    ok(q.part[SPIN_QUANT_SH].squares == 0.390625 && q.part[SPIN_QUANT_SH].n == 6,
       "squares and number of errors");
}

TAP_MAIN { test_sh(); }
