/* A line chart as inline SVG. The page defines the colours: classes line-0, line-1, ... */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

struct spin_svg_chart_line {
    const char *name;    /* any text; escaped when written */
    const double *x, *y; /* [n]; a nonfinite y leaves a gap */
    size_t n;
    int style; /* number of the page's line class */
    bool dashed;
};

struct spin_svg_chart {
    const char *title, *x_name, *y_name;
    const struct spin_svg_chart_line *line;
    int n_lines;
    bool whole; /* x values are integers, and so are the ticks */
};

/* Writes nothing if there are no points or all have the same x. */
void spin_svg_chart_write(FILE *to, const struct spin_svg_chart *chart);

/* The same as a separate file with a legend above the chart, for at most SPIN_SVG_CHART_LINES
 * lines. */
enum { SPIN_SVG_CHART_LINES = 8 };
void spin_svg_chart_file(FILE *to, const struct spin_svg_chart *chart);

/* A step of 1, 2 or 5 times a power of ten that divides `span` into at most `most` intervals. */
double spin_svg_chart_step(double span, int most);
