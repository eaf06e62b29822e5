#!/bin/sh
# K: cut input
# An input that is truncated while a command has it open gives one line that names it, exit code 1
# and no half-written output. A training keeps its progress.
. tests/cli/lib.sh
CC=${CC:-gcc}

# A plug-in that truncates $CUT: its data set when it is opened, its exporter before the values of
# the first frame are read.
cat >"$work/cutter.c" <<'C'
#include <spin.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static spin_status views(const char *path, const struct spin_plugin_values *values,
                         struct spin_views *out)
{
    (void)values;
    for (int i = 0; i < 6; i++) {
        char image[4096];
        struct spin_view view = {
            .camera = {160, 90, 120, 120, 80, 45, {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4}},
            .dataset_frame = i, .number = i, .time = i, .test = true, .path = image};

        snprintf(image, sizeof image, "%s/ims/0/%06d.jpg", path, i + 8);
        SPIN_TRY(spin_views_add(out, &view));
    }
    return truncate(getenv("CUT"), 0) == 0 ? SPIN_OK : spin_fail(SPIN_E_IO, "not cut");
}

static struct spin_out out;

static spin_status begin_export(const struct spin_export_job *job, void **self)
{
    *self = &out;
    return spin_out_open(job->output, false, &out);
}

static spin_status frame(void *self, int frame, const struct spin_frame_info *info,
                         const struct spin_splats *splats)
{
    (void)frame;
    (void)info;
    if (!getenv("WHOLE") && truncate(getenv("CUT"), 0) != 0)
        return spin_fail(SPIN_E_IO, "not cut");
    for (size_t i = 0; i < splats->n; i++)
        SPIN_TRY(spin_out_write(self, splats->means[3 * i] > 0 ? "+" : "-", 1));
    return SPIN_OK;
}

static spin_status end(void *self) { return spin_out_commit(self); }
static void abandon(void *self) { spin_out_abandon(self); }

static const struct spin_importer importer = {
    .abi = SPIN_PLUGIN_ABI, .name = "cutting", .summary = "cuts $CUT", .views = views};
static const struct spin_exporter exporter = {
    .abi = SPIN_PLUGIN_ABI, .name = "cut", .summary = "cuts $CUT", .wants = SPIN_COL_MEANS,
    .begin = begin_export, .frame = frame, .end = end, .abort = abandon};
const struct spin_plugin spin_plugin = {
    .abi = SPIN_PLUGIN_ABI,
    .importers = (const struct spin_importer *const[]){&importer, NULL},
    .exporters = (const struct spin_exporter *const[]){&exporter, NULL}};
C
$CC -std=gnu11 -Isrc -fPIC -shared -w -o "$work/cutter.so" "$work/cutter.c"
ok $? "a plug-in that cuts files"
run "$bin/spin-import" "$clip" --data "$clip" -o "$work/clip.spin"
is "$code" 0 "a bundle"
CUT=$work/cut.spin
export CUT SPIN_PLUGIN_PATH="$work/cutter.so"

# named COMMAND FILE NAME: the single line names the truncated file.
named() {
    fails 1 "$1" "$3"
    err_has "'$2': it was cut short while it was in use" "$3: the file is named"
}
left() { # NAME
    is "$(find "$work" -name '*.tmp.*' | wc -l)" 0 "$1: nothing half-written is left"
}

cp "$work/clip.spin" "$CUT"
WHOLE=1 run "$bin/spin-export" "$CUT" --to cut -o "$work/export"
is "$code" 0 "an export of a whole bundle"
rm -f "$work/export"
run "$bin/spin-export" "$CUT" --to cut -o "$work/export"
named spin-export "$CUT" "a bundle cut while it is exported"
nothing_at "$work/export" "nothing was exported"
left "an export"

cp "$work/clip.spin" "$CUT"
run "$bin/spin-eval" "$CUT" --source --data "$clip" --data-from cutting
named spin-eval "$CUT" "a bundle cut while it is measured"

cp "$clip/params.npz" "$work/params.npz"
CUT=$work/params.npz
run "$bin/spin-import" "$work/params.npz" --data "$clip" --data-from cutting -o "$work/import.spin"
named spin-import "$work/params.npz" "a run cut while it is imported"
nothing_at "$work/import" "nothing was imported"
left "an import"
unset SPIN_PLUGIN_PATH

# A training: the input is truncated between two iterations, long before the source's columns are
# written beside the network.
settings="--preset paper --iterations 300 --batch 1 --levels 2 --hash-log2 8 --hidden 16 --scale 0.5
    --device cpu --save-every 40"
CUT=$work/cut.spin
cp "$work/clip.spin" "$CUT"
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$CUT" -o "$work/whole.net" $settings
is "$code" 0 "a training that nobody disturbs"
rm -f "$work/log"
# shellcheck disable=SC2086
"$bin/spin-retrain" "$CUT" -o "$work/half.net" -q --log "$work/log" $settings >"$work/out" 2>"$work/err" &
pid=$!
for _ in $(seq 300); do
    [ -f "$work/log" ] && [ "$(wc -l <"$work/log")" -ge 5 ] && break
    sleep 0.02
done
: >"$CUT"
steps=$(wc -l <"$work/log")
wait $pid
code=$?
[ "$steps" -ge 5 ] && [ "$steps" -lt 300 ]
ok $? "it was cut after step $steps of 300"
[ "$(wc -l <"$work/log")" -ge 300 ]
ok $? "all steps were done"
sed -i '/^warning: the result is worse than the source/d' "$work/err" # 300 small steps
named spin-retrain "$CUT" "a bundle cut while it is trained on"
[ ! -e "$work/half.net" ]
ok $? "no output"
left "a training"
[ -s "$work/half.net.part" ]
ok $? "the state is kept"
cp "$work/clip.spin" "$CUT"
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$CUT" -o "$work/half.net" $settings --resume
is "$code" 0 "with the input as it was, --resume goes on"
cmp -s "$work/whole.net" "$work/half.net"
ok $? "to the very result of the other training"
done_testing
