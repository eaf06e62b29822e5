/* Draws line charts: axes with round numbers, lines, and points with tooltips. */
#include "eval/report/svg_chart.h"

#include <float.h>

#include "base/base.h"

enum { WIDTH = 720, HEIGHT = 260, LEFT = 56, RIGHT = 26, TOP = 10, BOTTOM = 42, MOST_POINTS = 160 };

struct frame {
    double x0, x1, y0, y1; /* range of the axes */
    double step;           /* distance of the ticks of y, of which y0 and y1 are multiples */
};

double spin_svg_chart_step(double span, int most)
{
    static const double round_numbers[] = {1, 2, 5, 10};
    double power = pow(10, floor(log10(span / most)));

    for (int i = 0; i < 4; i++)
        if (span / (power * round_numbers[i]) <= most)
            return power * round_numbers[i];
    return power * 10;
}

static double x_to_px(const struct frame *f, double x)
{
    return LEFT + (x - f->x0) / (f->x1 - f->x0) * (WIDTH - LEFT - RIGHT);
}

static double y_to_px(const struct frame *f, double y)
{
    return HEIGHT - BOTTOM - (y - f->y0) / (f->y1 - f->y0) * (HEIGHT - TOP - BOTTOM);
}

static bool measure_range(const struct spin_svg_chart *chart, struct frame *f)
{
    *f = (struct frame){DBL_MAX, -DBL_MAX, DBL_MAX, -DBL_MAX, 0};
    for (int k = 0; k < chart->n_lines; k++)
        for (size_t i = 0; i < chart->line[k].n; i++) {
            double x = chart->line[k].x[i], y = chart->line[k].y[i];

            if (!isfinite(x) || !isfinite(y))
                continue;
            f->x0 = fmin(f->x0, x);
            f->x1 = fmax(f->x1, x);
            f->y0 = fmin(f->y0, y);
            f->y1 = fmax(f->y1, y);
        }
    return f->x1 - f->x0 > 1e-9 * fmax(1, fabs(f->x1));
}

/* Extends the range of y to multiples of the tick distance; a single value gets a range of 1. */
static void round_frame(struct frame *f)
{
    if (f->y1 - f->y0 < 1e-9 * fmax(1, fabs(f->y1))) {
        f->y0 -= 0.5;
        f->y1 += 0.5;
    }
    f->step = spin_svg_chart_step(f->y1 - f->y0, 5);
    f->y0 = floor(f->y0 / f->step) * f->step;
    f->y1 = ceil(f->y1 / f->step) * f->step;
}

static void write_axes(FILE *to, const struct spin_svg_chart *chart, const struct frame *f)
{
    double step = f->step;

    for (double y = f->y0; y < f->y1 + step / 2; y += step)
        fprintf(to,
                "<line class=\"grid\" x1=\"%d\" x2=\"%d\" y1=\"%.1f\" y2=\"%.1f\"/><text "
                "x=\"%d\" y=\"%.1f\" text-anchor=\"end\">%.6g</text>\n",
                LEFT, WIDTH - RIGHT, y_to_px(f, y), y_to_px(f, y), LEFT - 8, y_to_px(f, y) + 4,
                fabs(y) < step / 1e6 ? 0 : y);
    step = spin_svg_chart_step(f->x1 - f->x0, 9);
    step = chart->whole ? fmax(step, 1) : step;
    for (double x = ceil(f->x0 / step) * step; x < f->x1 + step / 1e6; x += step)
        fprintf(to,
                "<line class=\"tick\" x1=\"%.1f\" x2=\"%.1f\" y1=\"%d\" y2=\"%d\"/><text "
                "x=\"%.1f\" y=\"%d\" text-anchor=\"middle\">%.7g</text>\n",
                x_to_px(f, x), x_to_px(f, x), HEIGHT - BOTTOM, HEIGHT - BOTTOM + 4, x_to_px(f, x),
                HEIGHT - BOTTOM + 18, fabs(x) < step / 1e6 ? 0 : x);
    fprintf(
        to,
        "<text x=\"%d\" y=\"%d\" text-anchor=\"middle\">%s</text><text class=\"upright\" x=\"14\" "
        "y=\"%d\" text-anchor=\"middle\" transform=\"rotate(-90 14 %d)\">%s</text>\n",
        (LEFT + WIDTH - RIGHT) / 2, HEIGHT - 6, chart->x_name, (TOP + HEIGHT - BOTTOM) / 2,
        (TOP + HEIGHT - BOTTOM) / 2, chart->y_name);
}

static void write_line(FILE *to, const struct spin_svg_chart_line *line, const struct frame *f)
{
    bool open = false;
    char name[512] = "";
    FILE *text = fmemopen(name, sizeof name, "w");

    if (text) {
        spin_text_html(text, line->name);
        fclose(text);
    }
    fprintf(to, "<path class=\"line line-%d%s\" d=\"", line->style, line->dashed ? " dashed" : "");
    for (size_t i = 0; i < line->n; i++) {
        bool good = isfinite(line->x[i]) && isfinite(line->y[i]);

        if (good)
            fprintf(to, "%c%.1f %.1f", open ? 'L' : 'M', x_to_px(f, line->x[i]),
                    y_to_px(f, line->y[i]));
        open = good;
    }
    fprintf(to, "\"/>\n");
    for (size_t i = 0; i < line->n && line->n <= MOST_POINTS; i++)
        if (isfinite(line->x[i]) && isfinite(line->y[i]))
            fprintf(
                to,
                "<circle class=\"dot line-%d\" cx=\"%.1f\" cy=\"%.1f\" r=\"3\"><title>%s: %.7g, "
                "%.5g</title></circle>\n",
                line->style, x_to_px(f, line->x[i]), y_to_px(f, line->y[i]), name, line->x[i],
                line->y[i]);
}

void spin_svg_chart_file(FILE *to, const struct spin_svg_chart *chart)
{
    static const char *const colours[SPIN_SVG_CHART_LINES] = {
        "#1f77c9", "#d2691e", "#2e9e5b", "#a347c4", "#c9a400", "#d33a5c", "#2aa7a7", "#8a94a3"};
    struct frame f;
    int names = 20 * ((chart->n_lines + 1) / 2) + 10; /* height of the legend, two names per row */

    if (measure_range(chart, &f))
        round_frame(&f);
    else
        f = (struct frame){0, 1, 0, 1, 0.2};
    fprintf(to,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 %d %d %d\" "
            "font-family=\"sans-serif\" font-size=\"12\">\n<style>.grid{stroke:#d8dde4}"
            ".tick{stroke:#5c6675}.line{fill:none;stroke-width:2;stroke-linejoin:round}"
            ".dot{stroke:none}",
            -names, WIDTH, HEIGHT + names);
    for (int k = 0; k < SPIN_SVG_CHART_LINES; k++)
        fprintf(to, ".line-%d{stroke:%s}.dot.line-%d{fill:%s}", k, colours[k], k, colours[k]);
    fprintf(to, "</style>\n<rect y=\"%d\" width=\"100%%\" height=\"100%%\" fill=\"#fff\"/>\n",
            -names);
    for (int k = 0; k < chart->n_lines; k++) {
        int x = LEFT + k % 2 * (WIDTH - LEFT - RIGHT) / 2, y = 20 - names + 20 * (k / 2);

        fprintf(to, "<path class=\"line line-%d\" d=\"M%d %dh24\"/><text x=\"%d\" y=\"%d\">",
                chart->line[k].style, x, y - 4, x + 30, y);
        spin_text_html(to, chart->line[k].name);
        fprintf(to, "</text>\n");
    }
    write_axes(to, chart, &f);
    for (int k = 0; k < chart->n_lines; k++)
        write_line(to, &chart->line[k], &f);
    fprintf(to, "</svg>\n");
}

void spin_svg_chart_write(FILE *to, const struct spin_svg_chart *chart)
{
    struct frame f;

    if (!measure_range(chart, &f))
        return;
    round_frame(&f);
    fprintf(to, "<figure><figcaption>%s</figcaption>\n", chart->title);
    if (chart->n_lines > 1) {
        fprintf(to, "<p class=\"legend\">");
        for (int k = 0; k < chart->n_lines; k++) {
            fprintf(to,
                    "<span><svg width=\"26\" height=\"10\"><path class=\"line line-%d%s\" d=\"M1 "
                    "5L25 5\"/></svg> ",
                    chart->line[k].style, chart->line[k].dashed ? " dashed" : "");
            spin_text_html(to, chart->line[k].name);
            fprintf(to, "</span> ");
        }
        fprintf(to, "</p>\n");
    }
    fprintf(to, "<svg class=\"chart\" viewBox=\"0 0 %d %d\" role=\"img\" aria-label=\"%s\">\n",
            WIDTH, HEIGHT, chart->title);
    write_axes(to, chart, &f);
    for (int k = 0; k < chart->n_lines; k++)
        write_line(to, &chart->line[k], &f);
    fprintf(to, "</svg></figure>\n");
}
