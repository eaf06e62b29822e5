/* Writes the page of --watch. Every few seconds the page loads now.js as a script, which works
 * without a web server. */
#include "run/watch_run.h"

#include "base/base.h"
#include "eval/report/report.h"
#include "eval/report/svg_chart.h"
#include "run/run.h"

enum { LOSS_POINTS = 300 };

extern const char spin_watch_html[]; /* watch.html */

spin_status spin_watch_open(struct spin_watch *w, const char *folder)
{
    SPIN_TRY(spin_path_join(folder, "index.html", &w->page));
    SPIN_TRY(spin_path_join(folder, "now.js", &w->now));
    SPIN_TRY(spin_path_join(folder, "log.jsonl", &w->log));
    SPIN_TRY(spin_path_join(folder, "pictures", &w->pictures));
    SPIN_TRY(spin_path_join(folder, "state.spin", &w->state));
    return spin_path_join(folder, "clip.html", &w->clip);
}

void spin_watch_close(struct spin_watch *w)
{
    free(w->page);
    free(w->now);
    free(w->log);
    free(w->pictures);
    free(w->state);
    free(w->clip);
    *w = (struct spin_watch){0};
}

static spin_status write_text(const char *path, const char *before, const char *text,
                              const char *after)
{
    struct spin_out out;

    SPIN_TRY(spin_out_open(path, true, &out));
    fprintf(out.file, "%s%s%s", before, text, after);
    return spin_out_commit(&out);
}

spin_status spin_watch_begin(const struct spin_watch *w)
{
    SPIN_TRY(write_text(w->page, "", spin_watch_html, ""));
    return write_text(w->now, "show(", "{}", ")\n");
}

static void draw_curves(const struct spin_train_log *h, FILE *to)
{
    struct spin_svg_chart_line loss = {"loss", h->step, h->loss, h->n_steps, 2, false},
                               psnr = {"test PSNR", h->test, h->psnr, h->n_tests, 0, false};
    struct spin_svg_chart chart = {.title = "PSNR of the test views",
                                   .x_name = "iteration",
                                   .y_name = "PSNR, dB",
                                   .line = &psnr,
                                   .n_lines = 1,
                                   .whole = true};

    spin_svg_chart_write(to, &chart);
    chart.title = "Loss, averaged over intervals of iterations";
    chart.y_name = "loss";
    chart.line = &loss;
    spin_svg_chart_write(to, &chart);
}

static spin_status add_curves(const char *log, spin_json *now)
{
    SPIN_LEAVES(spin_train_log_free) struct spin_train_log history = {0};
    SPIN_FREED char *text = NULL;
    size_t n;
    FILE *to = NULL;

    SPIN_TRY(spin_train_log_read(log, LOSS_POINTS, &history));
    to = spin_text_open(&text, &n);
    if (!to)
        return spin_fail(SPIN_E_MEMORY, "out of memory for the curves of the page");
    draw_curves(&history, to);
    if (fclose(to) != 0)
        return spin_fail(SPIN_E_MEMORY, "out of memory for the curves of the page");
    spin_json_set_string(now, "curves", text);
    spin_json_set_number(now, "seconds", history.total_seconds);
    return SPIN_OK;
}

/* Adds the names of the newest previews: the files whose names end in this iteration's number. */
static spin_status add_pictures(const struct spin_output *output, spin_json *now)
{
    const char *folder = output->plan->o->preview;
    char ending[48], **names = NULL;
    spin_json *list = spin_json_array();
    size_t n = 0;

    spin_json_set(now, "pictures", list);
    snprintf(ending, sizeof ending, "iteration_%07lld.png", (long long)output->trainer->iteration);
    SPIN_TRY(spin_folder_list(folder, &names, &n));
    for (size_t i = 0; i < n; i++)
        if (strstr(names[i], ending))
            spin_json_push_string(list, names[i]);
    spin_folder_list_free(names);
    return SPIN_OK;
}

/* Writes the current splats as a bundle, and exports this bundle as a web page that plays the clip.
 */
static spin_status write_clip(const struct spin_watch *w, const struct spin_output *output)
{
    struct spin_retrain_options o = *output->plan->o;
    struct spin_plan plan = *output->plan;
    struct spin_output state = *output;
    struct spin_export_options export = {.input = w->state,
                                         .output = w->clip,
                                         .to = "html",
                                         .device = "cpu",
                                         .n_threads = o.n_threads,
                                         .force = true};
    struct spin_export_report report;
    int level = spin_log_level();
    spin_status status;

    o.output = w->state;
    o.force = true;
    plan.o = &o;
    state.plan = &plan;
    SPIN_TRY(spin_output_write(&state));
    spin_log_set_level(level > 0 ? level : -1);
    status = spin_export_clip(&export, &report);
    spin_log_set_level(level);
    return status;
}

spin_status spin_watch_update(const struct spin_watch *w, const struct spin_output *output,
                              const char *log, bool done)
{
    const struct spin_plan *plan = output->plan;
    spin_json *now = spin_json_object();
    SPIN_FREED char *text = NULL;
    spin_status status;

    SPIN_TRY_OUT(write_clip(w, output));
    SPIN_TRY_OUT(add_curves(log, now));
    SPIN_TRY_OUT(add_pictures(output, now));
    spin_json_set_string(now, "output", plan->o->output);
    spin_json_set_integer(now, "iteration", output->trainer->iteration);
    spin_json_set_integer(now, "iterations", plan->o->iterations);
    spin_json_set_number(now, "psnr", plan->report->test.valid ? plan->report->test.psnr : 0);
    spin_json_set_bool(now, "source", spin_plan_has_source(plan));
    spin_json_set_bool(now, "done", done);
    text = spin_json_text(now, false);
    status = text ? write_text(w->now, "show(", text, ")\n")
                  : spin_fail(SPIN_E_MEMORY, "out of memory for the page");
out:
    spin_json_free(now);
    return spin_fail_context(status, "--watch");
}
