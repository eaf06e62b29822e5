/* --check: what was written is read back and held to the bundle - counts, the box around the places,
 * how far each value is off, and a picture of one frame. */
#ifndef SPIN_EXPORTERS_LIB_ROUNDTRIP_CHECK_H
#define SPIN_EXPORTERS_LIB_ROUNDTRIP_CHECK_H

#include "exporters/lib/quant_error.h"
#include "exporters/lib/splat_filter.h"

struct spin_roundtrip_check {
    struct spin_quant_error quant;
    double bounds; /* the most that a side of a frame's box is off by */
    double reach;  /* the farthest coordinate */
    uint64_t n_splats;
    int n_frames, rendered; /* number of the frame that was rendered */
    double psnr;            /* 0: none was */
};

/* `back`: a frame as a reader of the file understands it, in its axes and order. `rows` has chosen
 * those of the bundle's frame; row[j] is the one that the file's row j came from, NULL: those kept, in
 * the source's order. An error names the file. */
spin_status spin_roundtrip_check_frame(struct spin_roundtrip_check *check,
                                       const struct spin_splat_filter *rows, const char *path,
                                       const struct spin_splats *back, const uint32_t *row);
/* Render `back`, turned to the source's axes, and the bundle's own frame. `back` is changed. */
spin_status spin_roundtrip_check_render(struct spin_roundtrip_check *check,
                                        const struct spin_splat_filter *rows,
                                        const struct spin_export_job *job, int frame, int number,
                                        struct spin_splats *back);
/* After all frames: whether the files hold what was written into them, with the errors that rounding was seen to make
 * then (`written`: none of a format that rounds nothing). SPIN_E_IO. */
spin_status spin_roundtrip_check_judge(const struct spin_roundtrip_check *check,
                                       const struct spin_quant_error *written, const char *output);
void spin_roundtrip_check_report(const struct spin_roundtrip_check *check,
                                 struct spin_export_report *report);

#endif
