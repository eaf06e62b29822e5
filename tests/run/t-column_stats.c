/* The ranges of attributes in reports: every series, values that are not finite, and samples.
 * K: stats ranges info */
#include "run/column_stats.h"

#include "tests/check.h"
#include "tests/tap.h"

static const unsigned columns = SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES |
                                SPIN_COL_LOGIT_OPACITIES | SPIN_COL_SH | SPIN_COL_RGB;

/* Compares the report with the expected text, in which ' stands for ". */
static void check_report_is(struct spin_column_stats *d, const char *want, const char *what)
{
    spin_json *report = spin_json_object();
    char quoted[2000], *text;
    size_t n = 0;

    for (; want[n] && n + 1 < sizeof quoted; n++)
        quoted[n] = want[n] == '\'' ? '"' : want[n];
    quoted[n] = '\0';
    spin_column_stats_ranges(d, report);
    text = spin_json_text(report, false);
    is_text(text, quoted, what);
    free(text);
    spin_json_free(report);
    spin_column_stats_close(d);
}

/* Two frames of two splats of SH degree 1. Value c of row i of column k is 100 k + 10 i + c. */
static void check_all(void)
{
    struct spin_column_stats d = {0};
    struct spin_splats s = {0};
    unsigned without = columns & ~(unsigned)SPIN_COL_RGB;

    if (spin_column_stats_open(&d, 2) != SPIN_OK ||
        spin_splats_reserve(&s, 2, columns, 1) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < 2; i++) {
        for (size_t c = 0; c < 3; c++) {
            s.means[3 * i + c] = (float)(10 * i + c);
            s.log_scales[3 * i + c] = (float)i;
        }
        for (size_t c = 0; c < 4; c++)
            s.quats[4 * i + c] = 100 + (float)(10 * i + c);
        for (size_t c = 0; c < 12; c++)
            s.sh[12 * i + c] = 300 + (float)(20 * i + c);
        s.logit_opacities[i] = i ? 1 : -1;
    }
    spin_column_stats_frame(&d, without, &s);
    s.means[0] = -5;
    s.means[4] = NAN;
    s.sh[12] = INFINITY;
    s.logit_opacities[1] = 0;
    spin_column_stats_frame(&d, without, &s);
    check_report_is(&d,
                    "{'ranges':{'means.x':{'min':-5,'median':10,'max':10,'not_finite':0},"
                    "'means.y':{'min':1,'median':1,'max':11,'not_finite':0.25},"
                    "'means.z':{'min':2,'median':12,'max':12,'not_finite':0},"
                    "'quats':{'min':100,'median':110,'max':113,'not_finite':0},"
                    "'log_scales':{'min':0,'median':1,'max':1,'not_finite':0,"
                    "'scales':[1,2.7182818284590451,2.7182818284590451]},"
                    "'logit_opacities':{'min':-1,'median':0,'max':1,'not_finite':0,"
                    "'opacities':[0.2689414213699951,0.5,0.7310585786300049]},"
                    "'sh.dc':{'min':300,'median':302,'max':322,'not_finite':0.083333333333333329},"
                    "'sh.rest':{'min':303,'median':323,'max':331,'not_finite':0}},'finite':false}",
                    "all series of two frames");
    spin_splats_free(&s);
}

/* More rows than a sample has: the median is that of all frames and of all components. */
static void check_sample(void)
{
    struct spin_column_stats d = {0};
    struct spin_splats s = {0};

    for (int n_frames = 1; n_frames <= 3; n_frames += 2) {
        size_t n = n_frames == 1 ? 50000 : 100000;

        if (spin_column_stats_open(&d, n_frames) != SPIN_OK ||
            spin_splats_reserve(&s, n, SPIN_COL_RGB, 0) != SPIN_OK)
            exit(1);
        for (int f = 0; f < n_frames; f++) {
            for (size_t i = 0; i < 3 * n; i++)
                s.rgb[i] = (float)(f + (i % 3 == 0 && n_frames == 1 ? 1000 : i % 3 == 1 ? 4 : 5));
            spin_column_stats_frame(&d, SPIN_COL_RGB, &s);
        }
        check_report_is(&d,
                        n_frames == 1 ? "{'ranges':{'rgb':{'min':4,'median':5,'max':1000,"
                                        "'not_finite':0}},'finite':true}"
                                      : "{'ranges':{'rgb':{'min':4,'median':6,'max':7,"
                                        "'not_finite':0}},'finite':true}",
                        n_frames == 1 ? "a sample of all components" : "a sample of all frames");
        spin_splats_free(&s);
    }
    if (spin_column_stats_open(&d, 0) != SPIN_OK ||
        spin_splats_reserve(&s, 1, SPIN_COL_RGB, 0) != SPIN_OK)
        exit(1);
    for (size_t c = 0; c < 3; c++)
        s.rgb[c] = NAN;
    spin_column_stats_frame(&d, SPIN_COL_RGB, &s);
    check_report_is(&d,
                    "{'ranges':{'rgb':{'min':null,'median':null,'max':null,'not_finite':1}},"
                    "'finite':false}",
                    "no finite value");
    spin_splats_free(&s);
}

TAP_MAIN
{
    check_all();
    check_sample();
}
