/* Keeps a list of SIMD paths, in which each path occurs once. */
#include "train/simd_paths.h"

#include <string.h>

void spin_simd_paths_begin(struct spin_simd_paths *paths, const char *now)
{
    paths->now = now;
    snprintf(paths->all, sizeof paths->all, "%s", now);
}

void spin_simd_paths_add(struct spin_simd_paths *paths, const char *before)
{
    bool other = false;

    for (const char *at = before ? before : ""; *at;) {
        size_t n = strcspn(at, "+"), used = strlen(paths->all);
        char one[sizeof paths->all];

        snprintf(one, sizeof one, "%.*s", (int)n, at);
        at += n + (at[n] == '+');
        if (one[strspn(one, "abcdefghijklmnopqrstuvwxyz0123456789")] || strstr(paths->all, one) ||
            used + strlen(one) + 2 > sizeof paths->all)
            continue;
        snprintf(paths->all + used, sizeof paths->all - used, "%s%s", used ? "+" : "", one);
        other = true;
    }
    if (other)
        spin_warn("the SIMD path of this run is %s, but the work used more than one (%s): the "
                  "output will differ from that of an uninterrupted run in the last bits",
                  paths->now, paths->all);
}
