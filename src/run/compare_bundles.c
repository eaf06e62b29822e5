/* spin_compare(): measures several bundles on the same views. */
#include "base/base.h"
#include "io/output.h"
#include "io/ranks.h"
#include "eval/report/report.h"
#include "run/run.h"
#include "scene/dataset.h"

/* Names a run after its file, or by its whole path if another input has the same file name. */
static spin_status set_name(spin_json *run, const char *const *input, int n, int i)
{
    const char *name = spin_path_name(input[i]);
    SPIN_FREED char *copy = NULL;

    for (int k = 0; k < n; k++)
        if (k != i && strcmp(spin_path_name(input[k]), name) == 0)
            name = input[i];
    SPIN_TRY(spin_strdup(name, &copy));
    if (spin_text_ends(copy, ".spin"))
        copy[strlen(copy) - strlen(".spin")] = '\0';
    spin_json_set_string(run, "name", copy);
    spin_json_set_string(run, "input", input[i]);
    return SPIN_OK;
}

/* Refuses runs with different views, since only scores on the same views are comparable. */
static spin_status check_views(const spin_json *first, const spin_json *run)
{
    const spin_json *a = spin_json_get(first, "views"), *b = spin_json_get(run, "views");
    bool same = spin_json_length(a) == spin_json_length(b);

    for (size_t i = 0; i < spin_json_length(a) && same; i++)
        same = json_equal(spin_json_get(spin_json_at(a, i), "frame"),
                          spin_json_get(spin_json_at(b, i), "frame")) &&
               json_equal(spin_json_get(spin_json_at(a, i), "camera"),
                          spin_json_get(spin_json_at(b, i), "camera"));
    return same ? SPIN_OK
                : spin_misuse("'%s' and '%s' have different views: choose common ones with "
                              "--range, --split or --test-cams",
                              spin_json_string(spin_json_get(first, "input")),
                              spin_json_string(spin_json_get(run, "input")));
}

static spin_status measure_run(const struct spin_eval_options *all, const char *const *input, int n,
                               int i, struct spin_compare *c)
{
    struct spin_eval_options o = *all;
    struct spin_eval_report report;
    bool shown = o.report || o.images;
    spin_json *run;

    o.input = input[i];
    o.report = o.log = o.images = NULL;
    SPIN_TRY(spin_evaluate_for(&o, shown ? c : NULL, &report));
    run = spin_eval_json(&report, o.split);
    spin_eval_report_free(&report);
    spin_json_push(c->runs, run);
    SPIN_TRY(set_name(run, input, n, i));
    return check_views(spin_json_at(c->runs, 0), run);
}

/* Warns if the bundles were made for different data sets. This is not an error, since the data sets
 * may be copies of each other. A bundle that cannot be opened is reported later, when it is
 * measured. */
static void warn_data(const char *const *input, int n)
{
    SPIN_FREED char *first = NULL;

    for (int i = 0; i < n; i++) {
        SPIN_LEAVES(spin_bundle_close) struct spin_bundle bundle = {0};
        SPIN_FREED char *path = NULL;

        if (spin_bundle_open(input[i], &bundle) == SPIN_OK &&
            spin_bundle_data_path(&bundle, i == 0 ? &first : &path) == SPIN_OK && path && first &&
            strcmp(path, first) != 0)
            spin_warn("'%s' is measured against '%s', but '%s' against '%s': use --data to choose "
                      "one data set for all",
                      input[0], first, input[i], path);
    }
}

static spin_status check_outputs(const struct spin_eval_options *o, const char *figures,
                                 const char *const *input, int n)
{
    if (spin_rank() > 0)
        return SPIN_OK;
    for (int i = 0; i < n; i++)
        SPIN_TRY(spin_inputs_add_path(input[i]));
    SPIN_TRY(spin_output_check_distinct((const char *[]){o->report, figures}, 2));
    if (o->report)
        SPIN_TRY(spin_report_check_name(o->report));
    if (o->report)
        SPIN_TRY(spin_output_check_file(o->report, o->force));
    return figures ? spin_output_check_empty_folder(figures, o->force) : SPIN_OK;
}

spin_status spin_compare(const struct spin_eval_options *o, const char *const *input, int n,
                         const char *figures, char **report)
{
    SPIN_LEAVES(spin_inputs_end) int inputs = spin_inputs_begin();
    struct spin_eval_options all = *o;
    SPIN_LEAVES(spin_compare_free) struct spin_compare c = {.runs = spin_json_array()};

    (void)inputs;
    *report = NULL;
    all.images = figures;
    SPIN_TRY(spin_ranks_agree(check_outputs(o, figures, input, n)));
    if (spin_rank() == 0 && !o->data)
        warn_data(input, n);
    for (int i = 0; i < n; i++)
        SPIN_TRY(measure_run(&all, input, n, i, &c));
    if (spin_rank() == 0 && o->report)
        SPIN_TRY(spin_compare_page(&c, o->report, o->force));
    if (spin_rank() == 0 && figures)
        SPIN_TRY(spin_compare_figures(&c, figures, o->force));
    return spin_json_finish(json_pack("{s:O}", "runs", c.runs), report);
}
