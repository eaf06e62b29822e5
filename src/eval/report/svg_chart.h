/* A line chart as inline SVG. Colours are the page's: classes line-0, line-1, ... */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

struct spin_svg_chart_line {
    const char *name;    /* any text */
    const double *x, *y; /* [n]; y that is not finite leaves a gap */
    size_t n;
    int style; /* which of the page's line classes */
    bool dashed;
};

struct spin_svg_chart {
    const char *title, *x_name, *y_name;
    const struct spin_svg_chart_line *line;
    int n_lines;
    bool whole; /* x are whole numbers: so are its ticks */
};

/* Nothing is written when there are no points, or all at one x. */
void spin_svg_chart_write(FILE *to, const struct spin_svg_chart *chart);

/* The same as a file of its own, for at most SPIN_SVG_CHART_LINES lines, which have names above the
 * data. */
enum { SPIN_SVG_CHART_LINES = 8 };
void spin_svg_chart_file(FILE *to, const struct spin_svg_chart *chart);

/* A step of 1, 2 or 5 times a power of ten that cuts `span` into `most` pieces or fewer. */
double spin_svg_chart_step(double span, int most);
