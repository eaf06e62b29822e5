#!/bin/sh
# import.sh [FOLDER [FRAMES [SPLATS]]]: speed of imports, compared with what the machine does with
# the same bytes. Makes a Dynamic 3D Gaussians run as np.savez writes it (150 frames of 100,000: 606
# MB) in FOLDER (a new one below $TMPDIR or /tmp, removed afterwards), then times, five times each,
# in turns:
#
#   cat        reading the run
#   cp         copying the run
#   import     importing the run to a bundle
#   cp, sync   copying the run and waiting for the disk
#   --sync     importing it to a bundle that reaches the disk before it gets its name
#
# and prints medians, rates and the import's peak memory. Then opens a checkpoint of 450 MB of which
# two thirds are optimiser moments, and the same without them. SPIN_BIN: the folder of the commands.
# Needs python3 and GNU time.
bin=${SPIN_BIN:-build/release/bin}
folder=${1:-}
frames=${2:-150}
splats=${3:-100000}
if [ -z "$folder" ]; then
    folder=$(mktemp -d) || exit 1
    trap 'rm -rf "$folder"' EXIT
    trap 'exit 130' INT TERM
fi
run=$folder/params.npz
command -v python3 >/dev/null || { echo "import.sh needs python3" >&2; exit 1; }
[ -x /usr/bin/time ] || { echo "import.sh needs GNU time at /usr/bin/time" >&2; exit 1; }

# Writes the outputs of the methods, with numbers that differ from each other but not from frame to
# frame.
[ -f "$run" ] || python3 - "$run" "$frames" "$splats" <<'PYTHON' || exit 1
import array, random, sys, zipfile

path, frames, splats = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
random.seed(0)

def rows(width, low, high):
    return array.array('f', (random.uniform(low, high) for _ in range(splats * width))).tobytes()

def put(archive, name, shape, data, times):
    head = "{'descr': '<f4', 'fortran_order': False, 'shape': %s, }" % (shape,)
    head += ' ' * (-(10 + len(head) + 1) % 64) + '\n'
    with archive.open(name + '.npy', 'w', force_zip64=True) as out:
        out.write(b'\x93NUMPY\x01\x00' + len(head).to_bytes(2, 'little') + head.encode())
        for _ in range(times):
            out.write(data)

with zipfile.ZipFile(path, 'w', zipfile.ZIP_STORED, allowZip64=True) as z:
    put(z, 'means3D', (frames, splats, 3), rows(3, -3, 3), frames)
    put(z, 'rgb_colors', (frames, splats, 3), rows(3, 0, 1), frames)
    put(z, 'seg_colors', (splats, 3), rows(3, 0, 1), 1)
    put(z, 'unnorm_rotations', (frames, splats, 4), rows(4, -1, 1), frames)
    put(z, 'logit_opacities', (splats, 1), rows(1, -4, 4), 1)
    put(z, 'log_scales', (splats, 3), rows(3, -7, -2), 1)
    put(z, 'cam_m', (50, 3), bytes(600), 1)
    put(z, 'cam_c', (50, 3), bytes(600), 1)
PYTHON
bytes=$(stat -c %s "$run")
cat "$run" >/dev/null # into the page cache

# seconds NAME COMMAND...: appends wall, user, system seconds and peak KiB to FOLDER/NAME.times.
seconds() {
    name=$1
    shift
    /usr/bin/time -o "$folder/time" -f '%e %U %S %M' "$@" >/dev/null || exit 1
    cat "$folder/time" >>"$folder/$name.times"
}

# row NAME LABEL
row() {
    sort -g "$folder/$1.times" | awk -v label="$2" -v bytes="$bytes" '
        { wall[NR] = $1; cpu[NR] = $2 + $3; if ($4 > peak) peak = $4 }
        END { m = wall[int((NR + 1) / 2)]; c = cpu[int((NR + 1) / 2)]
              printf "%-10s %7.2f s  %7.0f MB/s  %6.2f s of processor  %5.0f MiB at the peak\n",
                     label, m, bytes / 1e6 / (m > 0 ? m : 0.01), c, peak / 1024 }'
}

# Removes the output of the last step, and waits until the disk is idle.
clear() {
    rm -f "$folder/copy" "$folder/out.spin"
    sync -f "$folder"
}

# In turns, since the speed at which the system finds memory for a file changes by the minute.
rm -f "$folder"/*.times
for _ in 1 2 3 4 5; do
    seconds cat cat "$run"
    clear
    seconds cp cp "$run" "$folder/copy"
    clear
    seconds import "$bin/spin-import" -q "$run" -o "$folder/out.spin"
    clear
    seconds sync sh -c "cp '$run' '$folder/copy' && sync '$folder/copy'"
    clear
    seconds wait "$bin/spin-import" -q "$run" --sync -o "$folder/out.spin"
done
echo "$frames frames of $splats splats, $bytes bytes; medians of 5"
row cat cat
row cp cp
row import import
row sync "cp, sync"
row wait "--sync"
clear

# A checkpoint as Realtime-4DGS saves it, with two optimiser moments for every value: twice as many
# bytes that a reader does not need. Importing one frame from it should take as long as without
# them.
checkpoint=$folder/chkpnt30000.pth
plain=$folder/plain.pth
[ -f "$checkpoint" ] || python3 tests/bench/make-checkpoint.py "$checkpoint" 230000 || exit 1
[ -f "$plain" ] || python3 tests/bench/make-checkpoint.py "$plain" 230000 plain || exit 1
bytes=$(stat -c %s "$checkpoint")
cat "$checkpoint" "$plain" >/dev/null
one_frame() { # NAME CHECKPOINT
    seconds "$1" "$bin/spin-import" -q --from realtime4dgs "$2" --frames 1 --force \
        -o "$folder/out.spin"
}
for _ in 1 2 3 4 5; do
    seconds readall cat "$checkpoint"
    one_frame with "$checkpoint"
    one_frame without "$plain"
done
echo "one frame of a checkpoint of $bytes bytes, $(stat -c %s "$plain") without moments; medians of 5"
row readall cat
row with moments
row without "without"
rm -f "$folder/out.spin" "$folder"/*.times "$folder/time"
