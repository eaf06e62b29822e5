/* Draws a line chart as SVG. A chart within a page does not define colours: the page defines them
 * for the CSS classes line-0, line-1, ... */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

struct spin_svg_chart_line {
    const char *name;    /* plain text, which is escaped for SVG */
    const double *x, *y; /* [n] points; those that are not finite leave a gap in the line */
    size_t n;
    int style; /* number k of the CSS class line-k */
    bool dashed;
};

struct spin_svg_chart {
    const char *title, *x_name, *y_name;
    const struct spin_svg_chart_line *line;
    int n_lines;
    bool whole; /* true if x is an integer: ticks are at integers only */
};

/* Writes a chart as an element of an HTML page. Writes nothing if all points have the same x. */
void spin_svg_chart_write(FILE *to, const struct spin_svg_chart *chart);

/* Writes a chart as a complete SVG file, with colours and a legend. The chart has at most
 * SPIN_SVG_CHART_LINES lines. */
enum { SPIN_SVG_CHART_LINES = 8 };
void spin_svg_chart_file(FILE *to, const struct spin_svg_chart *chart);

/* Returns the distance of ticks: the smallest number of the form 1, 2 or 5 times a power of ten
 * that divides `span` into at most `most` intervals. */
double spin_svg_chart_step(double span, int most);
