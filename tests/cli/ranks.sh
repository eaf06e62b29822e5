# shellcheck shell=sh
# Starts several processes for the tests of ranks, and skips those tests where MPI cannot run.
build=${SPIN_BUILD:-build/release}
if ! command -v mpirun >/dev/null 2>&1; then
    skip "ranks" "mpirun is not here: package openmpi-bin"
    done_testing
fi
if [ ! -f "$build/lib/spin-mpi.so" ]; then
    skip "ranks" "this build is without MPI: package libopenmpi-dev, then make"
    done_testing
fi
ASAN_OPTIONS=${ASAN_OPTIONS:-}:detect_leaks=0 # MPI's own
export ASAN_OPTIONS
mpirun='mpirun --oversubscribe --allow-run-as-root --bind-to none'

# ranks N COMMAND...
ranks() {
    n=$1
    shift
    run $mpirun -n "$n" "$@"
}
