/* Draws a line chart as SVG. A chart within a page has no colours of its own: the page defines them
 * for the classes line-0, line-1, ... */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

struct spin_svg_chart_line {
    const char *name;    /* plain text */
    const double *x, *y; /* [n]; values that are not finite leave a gap */
    size_t n;
    int style; /* k: class line-k */
    bool dashed;
};

struct spin_svg_chart {
    const char *title, *x_name, *y_name;
    const struct spin_svg_chart_line *line;
    int n_lines;
    bool whole; /* x is an integer: put ticks at integers only */
};

/* Writes a chart to be included in a page. Writes nothing if there are fewer than two different
 * values of x. */
void spin_svg_chart_write(FILE *to, const struct spin_svg_chart *chart);

/* Writes a chart as a file of its own, with colours and a legend. At most SPIN_SVG_CHART_LINES
 * lines. */
enum { SPIN_SVG_CHART_LINES = 8 };
void spin_svg_chart_file(FILE *to, const struct spin_svg_chart *chart);

/* The smallest step of 1, 2 or 5 times a power of ten that divides `span` into at most `most`
 * intervals. */
double spin_svg_chart_step(double span, int most);
