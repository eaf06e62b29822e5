#!/bin/sh
# Checks what nvcc compiled, if it is installed and `make` has used it: on each listed GPU the
# registers, shared memory, stack and spills of a kernel stay within tests/lint/kernels.budget,
# which lists every kernel. The PTX of the hash grid and of the contraction fuses no products and
# sums, the table's gradients are added by atomic operations, and the heads use tensor cores from
# sm_80 on. `sh tests/lint/kernels.sh print` prints the current values in the form of the budget.
# .ci/run compiles for one GPU only.
# B: the build folder (build/release).
build=${B:-build/release}
budget=tests/lint/kernels.budget
nvcc=${NVCC:-$(command -v nvcc)}
failed=0

# "file kernel registers shared stack spills GPUs" of all kernels, with the maximum over the GPUs
made() {
    for log in "$build"/src/device/cuda/*.cu.o.log; do
        [ -f "$log" ] || continue
        file=$(basename "$log" .cu.o.log)
        [ "$file" = gpu ] && continue # CUB's kernels
        awk -v file="$file" '
            /Compiling entry function/ {
                name = $0
                sub(/.*function .__*Z*/, "", name)
                match(name, /^[0-9]+/)
                n = substr(name, 1, RLENGTH)
                rest = substr(name, RLENGTH + 1 + n)
                name = substr(name, RLENGTH + 1, n)
                if (match(rest, /^ILi[0-9]+E/))
                    name = name "<" substr(rest, 4, RLENGTH - 4) ">"
                cards[name]++
            }
            / bytes stack frame/ {
                if ($1 > stack[name]) stack[name] = $1
                if ($5 + $9 > spill[name]) spill[name] = $5 + $9
            }
            /Used [0-9]+ registers/ {
                match($0, /Used [0-9]+/)
                r = substr($0, RSTART + 5, RLENGTH - 5) + 0
                if (r > registers[name]) registers[name] = r
                s = match($0, /[0-9]+ bytes smem/) ? substr($0, RSTART, RLENGTH) + 0 : 0
                if (s > shared[name]) shared[name] = s
            }
            END {
                for (k in cards)
                    print file, k, registers[k], shared[k] + 0, stack[k] + 0, spill[k] + 0, cards[k]
            }' "$log"
    done | LC_ALL=C sort
}

if [ -z "$nvcc" ] || [ ! -f "$build/lib/spin-cuda.so" ]; then
    echo "kernels: nvcc is not here, or was not asked: registers and spills are not looked at"
    exit 0
fi
if [ "$1" = print ]; then
    made | awk '{ print $1, $2, int(($3 + 7) / 8) * 8, $4, $5, $6 }'
    exit
fi
cards=$(made | awk '$7 > most { most = $7 } END { print most + 0 }')
out=$(made | awk -v cards="$cards" -v budget=$budget '
    BEGIN { while ((getline line < budget) > 0) if (line !~ /^#/) { split(line, b, " "); most[b[1] " " b[2]] = line } }
    {
        n++
        key = $1 " " $2
        if (!(key in most)) { print "kernels: " key " is not in " budget; next }
        split(most[key], b, " ")
        delete most[key]
        for (i = 3; i <= 6; i++)
            if ($i + 0 > b[i] + 0)
                print "kernels: " key " has " $i " " substr("registers shared    stack     spills    ", (i - 3) * 10 + 1, 10) " over its budget of " b[i]
        if ($7 != cards) print "kernels: " key " was made for " $7 " cards, not " cards
    }
    END { for (k in most) print "kernels: " k " is in " budget " and nowhere else"; print "n " n }')
echo "$out" | grep -v '^n '
[ "$(echo "$out" | grep -vc '^n ')" = 0 ] || failed=1

ptx=$(mktemp) || exit 1
trap 'rm -f "$ptx"' EXIT
for file in grid contract; do
    "$nvcc" -Isrc -I. -D_GNU_SOURCE -std=c++14 -O3 -fmad=false -arch=compute_75 -ptx -o "$ptx" \
        src/device/cuda/$file.cu || failed=1
    if grep -q 'fma\.rn\.f32' "$ptx"; then
        echo "kernels: the PTX of $file.cu fuses products and sums"
        failed=1
    fi
    if [ $file = grid ] && ! grep -Eq '(red|atom)\.global\.add\.f32' "$ptx"; then
        echo "kernels: the PTX of grid.cu does not add to the table by atomic operations"
        failed=1
    fi
done
"$nvcc" -Isrc -I. -D_GNU_SOURCE -std=c++14 -O3 -fmad=false -arch=compute_90 -ptx -o "$ptx" src/device/cuda/grid.cu ||
    failed=1
if ! grep -Eq 'ld\.global(\.nc)?\.v4\.f32' "$ptx"; then
    echo "kernels: the PTX of grid.cu does not load rows of the table by 16 bytes"
    failed=1
fi
if ! grep -Eq '(red|atom)\.global\.add\.v4\.f32' "$ptx"; then
    echo "kernels: the PTX of grid.cu for sm_90 does not add 16 bytes at once"
    failed=1
fi
"$nvcc" -Isrc -I. -D_GNU_SOURCE -std=c++14 -O3 -arch=compute_80 -ptx -o "$ptx" src/device/cuda/mlp.cu || failed=1
if ! grep -q 'mma\.sync.*\.tf32\.tf32\.f32' "$ptx" || grep -q '\.local' "$ptx"; then
    echo "kernels: the PTX of mlp.cu for sm_80 does not use tensor cores, or keeps their registers in memory"
    failed=1
fi
"$nvcc" -Isrc -I. -D_GNU_SOURCE -std=c++14 -O3 -arch=compute_80 -ptx -o "$ptx" src/device/cuda/heads_tensor.cu ||
    failed=1
if ! grep -q 'mma\.sync.*\.tf32\.tf32\.f32' "$ptx"; then
    echo "kernels: the PTX of heads_tensor.cu for sm_80 does not use tensor cores"
    failed=1
fi
[ $failed = 0 ] && echo "kernels: $(echo "$out" | sed -n 's/^n //p') for $cards cards within their budget"
exit $failed
