/* spin_bundle_describe(): what meta.json and the names of the members say. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "scene/bundle.h"

static int integer_of(const spin_json *object, const char *key)
{
    int64_t value = 0;

    spin_json_integer(spin_json_get(object, key), &value);
    return (int)value;
}

static struct spin_quality quality_of(const spin_json *object, const char *key)
{
    const spin_json *measured = spin_json_get(object, key);
    struct spin_quality q = {.psnr = NAN, .ssim = NAN};

    q.valid = spin_json_number(spin_json_get(measured, "psnr"), &q.psnr);
    spin_json_number(spin_json_get(measured, "ssim"), &q.ssim);
    return q;
}

static void count(const struct spin_bundle *b, enum spin_splat_source from,
                  struct spin_bundle_splats *out)
{
    int n_frames = b->meta.n_frames;

    out->there = true;
    out->n_min = SIZE_MAX;
    for (int f = 0; f < n_frames; f++) {
        size_t n = spin_bundle_count(b, f, from);

        out->n_min = n < out->n_min ? n : out->n_min;
        out->n_max = n > out->n_max ? n : out->n_max;
        out->n_mean += (double)n / n_frames;
    }
}

/* What the stage that made them left in meta.json. */
static spin_status describe_stage(const spin_json *stage, struct spin_bundle_splats *out)
{
    const spin_json *options = spin_json_get(stage, "options");

    out->sh_degree = integer_of(stage, "sh_degree");
    spin_json_bool(spin_json_get(stage, "antialias"), &out->antialias);
    out->iterations = integer_of(options, "iterations");
    out->before = quality_of(stage, "before");
    out->test = quality_of(stage, "test");
    if (!options)
        return SPIN_OK;
    out->options = spin_json_text(options, false);
    return out->options ? SPIN_OK : spin_fail(SPIN_E_MEMORY, "no memory for the settings");
}

static spin_status describe_network(const struct spin_bundle *b, struct spin_bundle_report *r)
{
    const spin_json *network = spin_json_get(b->json, "network");
    const char *device = spin_json_string(spin_json_get(network, "device"));
    const spin_json *offset = spin_json_get(network, "offset");
    double rows = 0;

    if (!network)
        return SPIN_OK;
    count(b, SPIN_FROM_NETWORK, &r->network);
    r->network.columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    r->levels = integer_of(network, "levels");
    r->features = integer_of(network, "features");
    r->hidden = integer_of(network, "hidden");
    spin_json_number(spin_json_at(offset, (size_t)(r->levels > 0 ? r->levels : 0)), &rows);
    r->rows = (long long)rows;
    snprintf(r->device, sizeof r->device, "%s", device ? device : "");
    return describe_stage(network, &r->network);
}

static spin_status describe_refined(const struct spin_bundle *b, struct spin_bundle_report *r)
{
    if (!b->refined.columns)
        return SPIN_OK;
    count(b, SPIN_FROM_REFINED, &r->refined);
    SPIN_TRY(describe_stage(spin_json_get(b->json, "refined"), &r->refined));
    r->refined.columns = b->refined.columns;
    r->refined.sh_degree = b->refined.sh_degree;
    return SPIN_OK;
}

static spin_status describe(const struct spin_bundle *b, struct spin_bundle_report *r)
{
    const struct spin_bundle_meta *meta = &b->meta;
    const char *generator = spin_json_string(spin_json_get(b->json, "generator"));

    snprintf(r->generator, sizeof r->generator, "%s", generator ? generator : "");
    memcpy(r->from, meta->from, sizeof r->from);
    memcpy(r->upstream, meta->upstream, sizeof r->upstream);
    memcpy(r->variant, meta->variant, sizeof r->variant);
    memcpy(r->data_from, meta->data_from, sizeof r->data_from);
    SPIN_TRY(spin_bundle_data_path(b, &r->data));
    r->data_there = r->data && spin_path_exists(r->data);
    r->frames = meta->n_frames;
    r->source_frames = meta->n_source_frames;
    r->numbered = meta->numbered;
    r->number_first = meta->frame[0].number;
    r->number_last = meta->frame[meta->n_frames - 1].number;
    r->time_first = meta->frame[0].time;
    r->time_last = meta->frame[meta->n_frames - 1].time;
    count(b, SPIN_FROM_SOURCE, &r->source);
    r->source.columns = meta->columns;
    r->source.static_columns = meta->static_columns;
    r->source.sh_degree = meta->columns & SPIN_COL_SH ? meta->sh_degree : -1;
    r->source.antialias = meta->antialias;
    spin_bundle_weigh(b, &r->bytes);
    SPIN_TRY(describe_refined(b, r));
    return describe_network(b, r);
}

spin_status spin_bundle_describe(const char *path, struct spin_bundle_report *report)
{
    struct spin_bundle bundle;
    spin_status status;

    memset(report, 0, sizeof *report);
    if (!spin_bundle_looks_like(path))
        return spin_fail(SPIN_E_NOT_RECOGNISED, "'%s' is no bundle", path);
    SPIN_TRY(spin_bundle_open(path, &bundle));
    status = describe(&bundle, report);
    spin_bundle_close(&bundle);
    return status;
}

void spin_bundle_report_free(struct spin_bundle_report *report)
{
    free(report->data);
    free(report->refined.options);
    free(report->network.options);
    memset(report, 0, sizeof *report);
}
