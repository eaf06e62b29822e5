"""stage.py OUT [points]: writes eight PLY frames of a wall, in front of which a ball of 125 splats
moves. With 'points', the frames are points, and their positions and order differ. Needs only the
standard library."""
import os, random, struct, sys

out, points = sys.argv[1], len(sys.argv) > 2
WORDS = 'x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'.split()
os.makedirs(out)
random.seed(1)


def splat(x, y, z, grey, size):
    if points:
        return tuple(c + random.uniform(-.01, .01) for c in (x, y, z)) + (int(255 * grey),) * 3
    return (x, y, z) + ((grey - 0.5) / 0.2821,) * 3 + (4.0,) + (size,) * 3 + (1.0, 0.0, 0.0, 0.0)


for f in range(8):
    rows = [splat(x / 10, y / 10, 2.0, 0.2 + 0.1 * (x % 2), -2.5) for x in range(-20, 21) for y in range(-10, 11)]
    rows += [splat(-1.0 + 0.25 * f + x / 20, y / 20, 1 + z / 20, 0.9, -2.8)
             for x in range(-2, 3) for y in range(-2, 3) for z in range(-2, 3)]
    head = 'ply\nformat binary_little_endian 1.0\nelement vertex %d\n' % len(rows)
    if points:
        random.shuffle(rows)
        head += 'property float x\nproperty float y\nproperty float z\n'
        head += 'property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n'
    else:
        head += ''.join('property float %s\n' % w for w in WORDS) + 'end_header\n'
    with open(os.path.join(out, 'frame_%05d.ply' % f), 'wb') as file:
        file.write(head.encode())
        for r in rows:
            file.write(struct.pack('<3f3B' if points else '<%df' % len(WORDS), *r))
