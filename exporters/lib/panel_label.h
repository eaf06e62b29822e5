/* The name of a panel, written into its picture. */
#ifndef SPIN_EXPORTERS_LIB_PANEL_LABEL_H
#define SPIN_EXPORTERS_LIB_PANEL_LABEL_H

/* word ("truth", "before" or "after") into the upper left corner of image [3][height][width], white on black; not
 * into a picture that is too small for it. */
void spin_panel_label(const char *word, int width, int height, float *image);

#endif
