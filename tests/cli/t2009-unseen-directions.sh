#!/bin/sh
# K: retrain backdrop
# The backdrop extends surfaces into directions that no training view shows: a hole in a room is
# closed, and the open side of a scene stays open.
. tests/cli/lib.sh

if ! python3 -c 'import numpy' 2>/dev/null; then
    skip "unseen directions" "no python3 with numpy"
    done_testing
fi
cat >"$work/room.py" <<'EOF'
import json, struct, sys, zlib
import numpy as np

out, azimuths, spread = sys.argv[1], [float(a) for a in sys.argv[2].split(",")], float(sys.argv[3])
# Points of a sphere of radius 4, two frames of it, red below the horizon (y down) and green above.
rng = np.random.default_rng(1)
p = rng.normal(size=(6000, 3))
p *= 4 / np.linalg.norm(p, axis=1, keepdims=True)
for frame in range(2):
    with open("%s/frame_%d.ply" % (out, frame), "w") as f:
        f.write("ply\nformat ascii 1.0\nelement vertex %d\n" % len(p))
        f.write("".join("property float %s\n" % c for c in "xyz"))
        f.write("".join("property uchar %s\n" % c for c in ("red", "green", "blue")) + "end_header\n")
        for q in p:
            f.write("%.5f %.5f %.5f %d %d 0\n" % (*q, *((200, 0) if q[1] > 0 else (0, 200))))
# Cameras near the centre that look at the horizon, in OpenGL axes; 64x48 pixels, 77 x 60 degrees.
width, height, fx = 64, 48, 40.0
frames = []
for k, azimuth in enumerate(azimuths):
    a = np.radians(azimuth)
    forward, down = np.array([np.sin(a), 0, np.cos(a)]), np.array([0, 1.0, 0])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = np.cross(down, forward), -down, -forward
    pose[:3, 3] = spread * np.array([np.cos(2.4 * k), 0.2 * np.sin(k), np.sin(2.4 * k)])
    name = "cam%02d" % k
    rows = b"".join(b"\0" + bytes([100, 90, 80]) * width for _ in range(height))
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    with open("%s/%s.png" % (out, name), "wb") as f:
        f.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)) +
                chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))
    for t in (0.0, 1.0):
        frames.append({"file_path": name + ".png", "time": t, "transform_matrix": pose.tolist()})
for which in ("train", "test"):
    with open("%s/transforms_%s.json" % (out, which), "w") as f:
        json.dump({"w": width, "h": height, "fl_x": fx, "fl_y": fx, "cx": width / 2, "cy": height / 2,
                   "frames": frames if which == "train" else frames[:2]}, f)
EOF
# train NAME AZIMUTHS: trains one iteration, and exports a frame with the backdrop as text.
train() {
    mkdir -p "$work/$1"
    python3 "$work/room.py" "$work/$1" "$2" 0.3 || return
    run "$bin/spin-import" --from ply "$work/$1" --data "$work/$1" --pair order -o "$work/$1.spin"
    is "$code" 0 "$1: imports"
    run "$bin/spin-retrain" "$work/$1.spin" -o "$work/$1-new.spin" --device cpu --threads 1 \
        --iterations 1 --backdrop on --learn-exposure off
    is "$code" 0 "$1: trains"
    for backdrop in auto off; do
        run "$bin/spin-export" "$work/$1-new.spin" --to ply --backdrop "$backdrop" --range 0:1 -o "$work/$1-$backdrop"
        is "$code" 0 "$1: exports with --backdrop $backdrop"
    done
}
cat >"$work/read.py" <<'EOF'
import glob, sys
import numpy as np

def rows(folder):
    data = open(glob.glob(folder + "/*.ply")[0], "rb").read()
    head, body = data.split(b"end_header\n", 1)
    names = [l.split()[2].decode() for l in head.split(b"\n") if l.startswith(b"property")]
    values = np.frombuffer(body, "<f4").reshape(-1, len(names))
    return {n: values[:, i] for i, n in enumerate(names)}

all_of, without = rows(sys.argv[1] + "-auto"), rows(sys.argv[1] + "-off")
n = len(all_of["x"]) - len(without["x"])
added = {k: v[-n:].astype(float) for k, v in all_of.items()}
at = np.stack([added[c] for c in "xyz"], 1)
radius = np.linalg.norm(at, axis=1)
axis = at / radius[:, None]
dc = np.stack([added["f_dc_%d" % c] for c in range(3)], 1)
def angle_to(d):
    return np.degrees(np.arccos(np.clip(axis @ np.asarray(d, float), -1, 1)))
EOF
look() { # NAME CODE TEXT
    { cat "$work/read.py" && printf '%s\n' "$2"; } >"$work/check.py"
    run python3 "$work/check.py" "$work/$1"
    is "$code" 0 "$1: $3"
}

train room 0,45,90,135,180,225,270,315
look room 'assert n > 200 and min(angle_to([0, 1, 0])) < 6 and min(angle_to([0, -1, 0])) < 6, n' \
    "floor and ceiling, which no view shows, are closed"
look room 'assert 3.9 < radius.min() and radius.max() < 6, (radius.min(), radius.max())' \
    "behind the surfaces, and not far behind"
look room 'for sign, c in ((1, 0), (-1, 1)):
    cap = dc[angle_to([0, sign, 0]) < 40]
    assert len(cap) > 20 and (cap.argmax(1) == c).all(), cap' \
    "in the colour of the nearest surfaces"

# The step through the views has no common divisor with the number of cameras.
train pair 0,180
look pair 'assert angle_to([0, 0, 1]).min() < 8 and angle_to([0, 0, -1]).min() < 8' \
    "both of two cameras are used"

train corner 0,20,40
look corner 'turn = np.degrees(np.arctan2(axis[:, 0], axis[:, 2]))
assert n > 50 and len(turn[(turn < -75) | (turn > 115)]) == 0, sorted(turn)' \
    "the open side stays open"
look corner 'assert angle_to([0, 0.5, 0.866]).min() < 8' "a margin beyond the visible part is closed"
done_testing
