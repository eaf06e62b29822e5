#!/bin/sh
# K: long retrain steady memory
# In steady state an iteration of spin-retrain makes no allocation and no system call; the seconds
# of its ops add up; memory equals the estimate of --dry-run.
. tests/cli/lib.sh

if [ ! -d "$clip" ]; then
    skip "steady" "no fixture at $clip"
    done_testing
fi
in=$work/in.spin
run "$bin/spin-import" "$clip/params.npz" --data "$clip" -o "$in"
is "$code" 0 "imports the clip"
small='--preset paper --device cpu --threads 1 --levels 4 --hash-log2 12 --finest-resolution 64 --hidden 16 --force'
small="$small --learn-exposure on --views-per-frame 2 --warmup 2"

# The same run twice, the second one 300 iterations longer: the difference is the cost of these
# iterations. By then all images have been read and the tile lists have reached their size. The
# image library and the writing of the output differ by some fifty calls between runs, so the bound
# is one call in two iterations.
few=100
many=400

case ${SPIN_BUILD:-} in
*asan* | *tsan* | *ubsan*) skip "no allocation in a step" "sanitisers have an allocator of their own" ;;
*)
    if ${CC:-cc} -O1 -shared -fPIC -o "$work/count.so" tests/tools/count-calls.c 2>"$work/err"; then
        for try in 1 2 3; do # now and then a run differs by some hundred calls
            for n in $few $many; do
                COUNT_CALLS=$work/calls.$n LD_PRELOAD=$work/count.so "$bin/spin-retrain" "$in" \
                    -o "$work/out.spin" $small --scale 0.5 --iterations $n -q >/dev/null 2>"$work/err"
                is $? 0 "counts the allocations of $n steps, try $try"
            done
            more=$(($(cat "$work/calls.$many") - $(cat "$work/calls.$few")))
            [ "$more" -lt 150 ] && break
        done
        [ "$more" -lt 150 ]
        ok $? "$((many - few)) steps more, no allocation a step more ($more)"
    else
        skip "no allocation in a step" "no compiler, or not this C library"
    fi
    ;;
esac

# The total of system calls that strace counted.
calls() { awk '$NF == "total" {print $4}' "$1"; }
if strace -f -c -o "$work/strace.$few" true 2>/dev/null; then
    for n in $few $many; do
        traced -f -c -o "$work/strace.$n" "$bin/spin-retrain" "$in" -o "$work/out.spin" $small \
            --scale 0.5 --iterations $n -q >/dev/null 2>"$work/err"
        is $? 0 "counts the system calls of $n steps"
    done
    more=$(($(calls "$work/strace.$many") - $(calls "$work/strace.$few")))
    [ "$more" -lt 150 ]
    ok $? "$((many - few)) steps more, no system call a step more ($more)"
else
    skip "no system call in a step" "no strace"
fi

# The log's seconds: the ops against the iterations.
run "$bin/spin-retrain" "$in" -o "$work/out.spin" $small --iterations $few --log "$work/log.jsonl" -v
is "$code" 0 "retrains with a log"
share=$(awk '/"ops_s"/ {
        match($0, /"step_s": [0-9.]+/)
        wall += substr($0, RSTART + 10, RLENGTH - 10)
        ops = $0
        sub(/.*"ops_s": \{/, "", ops)
        n = split(ops, part, /[:,}]/)
        for (i = 2; i <= n; i += 2) named += part[i]
    }
    END { printf "%.0f", 100 * named / wall }' "$work/log.jsonl")
[ "$share" -ge 95 ] && [ "$share" -le 105 ]
ok $? "the seconds of the ops are those of the steps within 5 % ($share)"
err_has "together" "-v says where the time went"

# A hash table that takes most of the memory, as in real runs.
large='--preset paper --device cpu --hash-log2 18 --iterations 3 --force --json'
run "$bin/spin-retrain" "$in" --dry-run $large
needed=$(member bytes_needed)
run "$bin/spin-retrain" "$in" -o "$work/out.spin" $large
peak=$(member bytes_peak)
case ${SPIN_BUILD:-} in
*asan* | *tsan* | *ubsan*) skip "memory as planned" "sanitisers need more" ;;
*)
    [ "$((peak * 10))" -le "$((needed * 11))" ] && [ "$((peak * 11))" -ge "$((needed * 10))" ]
    ok $? "the memory is what --dry-run said within 10 % ($needed, $peak)"
    ;;
esac
done_testing
