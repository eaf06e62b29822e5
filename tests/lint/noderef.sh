#!/bin/sh
# The host does not dereference device memory: clang checks the pointers that device.h marks as
# SPIN_DEV, and reports code that dereferences one, passes it to memcpy() or drops the mark.
if ! command -v clang >/dev/null 2>&1; then
    echo "noderef: skipped, clang is not installed (make setup-lint installs it)"
    exit 0
fi
check="clang -Isrc -I. -D_GNU_SOURCE -std=gnu11 -fsyntax-only -Wnoderef -Werror=noderef"
failed=0
n=0

# The check itself detects a fault.
for misuse in 'return d->x_u[3];' 'memcpy(host, d->x_u, 4); return 0;' 'host = d->x_u; return *host;'; do
    if printf '#include <string.h>\n#include "model/field_eval.h"\nfloat f(struct spin_field_eval *d, float *host);\nfloat f(struct spin_field_eval *d, float *host) { (void)host; %s }\n' "$misuse" |
        $check -x c - 2>/dev/null; then
        echo "noderef: not noticed: $misuse"
        failed=1
    fi
done
for file in $(find src/model src/render src/train src/eval src/run -name '*.c' | sort); do
    n=$((n + 1))
    $check "$file" || failed=1
done
[ $failed = 0 ] && echo "noderef: $n files leave device memory alone"
exit $failed
