/* Pairs the frames of synchronised videos by time. */
#include "importers/lib/views_rig.h"

#include "io/video.h"

/* Sets the frame rate of a video to the inverse of the mean interval between its frames. Intervals
 * longer than 1.5 times the median are ignored, since frames were dropped there. A mean is needed
 * because time stamps may be rounded, for instance to milliseconds. */
static spin_status measure_rate(struct spin_rig_video *f)
{
    SPIN_FREED double *gap = NULL;
    double sum = 0, limit;
    size_t n = 0;

    f->regular = true;
    if (f->n < 2)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(f->n, sizeof *gap, (void **)&gap));
    for (size_t i = 1; i < f->n; i++)
        gap[i - 1] = f->time[i] - f->time[i - 1];
    qsort(gap, f->n - 1, sizeof *gap, spin_by_double);
    limit = 1.5 * gap[(f->n - 1) / 2];
    while (n < f->n - 1 && gap[n] <= limit)
        sum += gap[n++];
    if (!(sum > 0))
        return spin_malformed("the time stamps of video '%s' do not increase", f->file);
    f->rate = (double)n / sum;
    for (size_t i = 0; i < f->n; i++)
        f->regular = f->regular && fabs(f->time[i] * f->rate - (double)i) < 0.5;
    return SPIN_OK;
}

static spin_status open_film(struct spin_model *m, struct spin_rig_video *f,
                             struct spin_offsets *offsets)
{
    const struct spin_offset *offset = spin_offsets_of(offsets, f->camera);
    SPIN_FREED double *times = NULL;
    int64_t n = 0;

    SPIN_TRY(spin_video_times(f->file, &times, &n));
    if (n < 1 || n > INT_MAX)
        return spin_malformed("video '%s' has %lld frames, expected 1 to %d", f->file, (long long)n,
                              INT_MAX);
    f->n = (size_t)n;
    SPIN_TRY(spin_model_alloc(m, f->n, sizeof *f->time, (void **)&f->time));
    memcpy(f->time, times, f->n * sizeof *times);
    SPIN_TRY(measure_rate(f));
    if (offset)
        f->offset = offset->in_seconds || f->rate == 0 ? offset->value : offset->value / f->rate;
    return SPIN_OK;
}

/* Returns whether frames can be paired by their index: the rates of all videos are so similar that
 * the videos drift apart by less than half a frame, and all offsets are whole numbers of frames. */
static bool are_alike(const struct spin_rig_video *film, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        double drift = fabs(film[i].rate / film[0].rate - 1) * (double)film[i].n;
        double whole = film[i].offset * film[i].rate;

        if (film[i].rate > 0 && film[0].rate > 0 && !(drift < 0.5))
            return false;
        if (!film[i].regular || fabs(whole - round(whole)) > 0.01)
            return false;
    }
    return true;
}

/* Returns the index of the frame that is nearest to a time in seconds. */
static size_t nearest(const struct spin_rig_video *f, double time)
{
    size_t low = 0, high = f->n - 1;

    while (low < high) {
        size_t middle = low + (high - low) / 2;

        if (f->time[middle] < time)
            low = middle + 1;
        else
            high = middle;
    }
    return low > 0 && time - f->time[low - 1] <= f->time[low] - time ? low - 1 : low;
}

static void add_frame(struct spin_file_sequence *frames, const char *path, int number)
{
    spin_file_sequence_add(frames, path, path);
    frames->frame[frames->n_frames - 1].number = number;
}

/* Lists, for each frame number of a clip with this rate, the frame of the video that is nearest in
 * time. Frame numbers without a frame within half a frame interval are left out. */
static spin_status list_frames(struct spin_model *m, struct spin_rig_video *f, double rate)
{
    double first = f->offset * rate, last = (f->offset + f->time[f->n - 1]) * rate;
    int from = first > 0 ? (int)ceil(first - 0.5) : 0, to = (int)floor(last + 0.5);
    const char *path;

    SPIN_TRY(spin_file_sequence_reserve(m, &f->frames, to >= from ? (size_t)(to - from) + 1 : 1));
    for (int row = from; row <= to; row++) {
        double time = (double)row / rate - f->offset;
        size_t k = nearest(f, time);

        if (fabs(f->time[k] - time) * rate > 0.499)
            continue;
        SPIN_TRY(spin_model_text(m, &path, "%s#%zu", f->file, k));
        add_frame(&f->frames, path, row);
    }
    return SPIN_OK;
}

/* Lists all frames of a video; the number of each frame is its index plus the offset. */
static spin_status list_all(struct spin_model *m, struct spin_rig_video *f)
{
    int offset = (int)round(f->offset * f->rate);
    const char *path;

    SPIN_TRY(spin_file_sequence_reserve(m, &f->frames, f->n));
    for (size_t k = 0; k < f->n; k++) {
        if ((int)k + offset < 0)
            continue;
        SPIN_TRY(spin_model_text(m, &path, "%s#%zu", f->file, k));
        add_frame(&f->frames, path, (int)k + offset);
    }
    return SPIN_OK;
}

static void warn_rates(const struct spin_rig_video *film, size_t n, size_t low, size_t high)
{
    const struct spin_rig_video *a = &film[low], *b = &film[high];

    if (b->rate > 1.001 * a->rate)
        spin_warn("'%s' has %.6g frames per second and '%s' has %.6g: the frames of all videos are "
                  "paired by time, at %.6g frames per second",
                  a->file, a->rate, b->file, b->rate, a->rate);
    for (size_t i = 0; i < n; i++) {
        if (film[i].regular)
            continue;
        spin_warn("'%s' has a variable frame rate: the frames of all videos are paired by their "
                  "time stamps, at %.6g frames per second",
                  film[i].file, a->rate);
        return;
    }
}

spin_status spin_video_rows(struct spin_model *m, struct spin_rig_video *film, size_t n,
                            struct spin_offsets *offsets)
{
    size_t low = 0, high = 0;
    bool alike;

    for (size_t i = 0; i < n; i++) {
        SPIN_TRY(open_film(m, &film[i], offsets));
        if (film[i].rate > 0 && (film[low].rate == 0 || film[i].rate < film[low].rate))
            low = i;
        high = film[i].rate > film[high].rate ? i : high;
    }
    alike = are_alike(film, n) || film[low].rate == 0;
    if (!alike)
        warn_rates(film, n, low, high);
    for (size_t i = 0; i < n; i++)
        SPIN_TRY(alike ? list_all(m, &film[i]) : list_frames(m, &film[i], film[low].rate));
    return SPIN_OK;
}
