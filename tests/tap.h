/* The whole test framework: TAP out, non-zero exit when any line is "not ok".
 *
 *     TAP_MAIN { ok(1 + 1 == 2, "adds"); near(x, 0.5, 1e-6, "halves"); }
 *
 * A test's keys for `make test K=word` stand in a comment near its top: "K: golden d3dgs". */
#ifndef TAP_H
#define TAP_H

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* One pair for the whole program: check.c counts too. */
__attribute__((weak)) int tap_count, tap_failed;

__attribute__((unused, format(printf, 2, 3))) static int ok(int good, const char *fmt, ...)
{
    va_list args;
    printf("%s %d - ", good ? "ok" : "not ok", ++tap_count);
    va_start(args, fmt);
    vprintf(fmt, args);
    va_end(args);
    printf("\n");
    fflush(stdout);
    if (!good)
        tap_failed++;
    return good;
}

/* The larger one; NaN where one is, which fmax() leaves out, so that the worst of many errors shows
 * it. */
__attribute__((unused)) static double larger(double a, double b)
{
    return a >= b ? a : b > a ? b : (double)NAN;
}

/* A line for a test that cannot run here, with the reason. */
__attribute__((unused)) static void skip(const char *what, const char *why)
{
    printf("ok %d - %s # SKIP %s\n", ++tap_count, what, why);
    fflush(stdout);
}

__attribute__((unused)) static int near(double got, double want, double tolerance, const char *what)
{
    int good = fabs(got - want) <= tolerance;
    ok(good, "%s", what);
    if (!good)
        printf("#   got %.9g, want %.9g, tolerance %.3g\n", got, want, tolerance);
    return good;
}

__attribute__((unused)) static int is_text(const char *got, const char *want, const char *what)
{
    int good = got && want && strcmp(got, want) == 0;
    ok(good, "%s", what);
    if (!good)
        printf("#   got  '%s'\n#   want '%s'\n", got ? got : "(null)", want ? want : "(null)");
    return good;
}

/* One part of a long test. $TAP_PART=name runs that part alone. */
#define PART(part, ...)                                                                            \
    do {                                                                                           \
        if (!getenv("TAP_PART") || strcmp(getenv("TAP_PART"), #part) == 0)                         \
            part(__VA_ARGS__);                                                                     \
    } while (0)

__attribute__((unused)) static int tap_done(void)
{
    printf("1..%d\n", tap_count);
    return tap_failed ? 1 : 0;
}

#define TAP_MAIN                                                                                   \
    static void tap_body(void);                                                                    \
    int main(void)                                                                                 \
    {                                                                                              \
        tap_body();                                                                                \
        return tap_done();                                                                         \
    }                                                                                              \
    static void tap_body(void)

#endif
