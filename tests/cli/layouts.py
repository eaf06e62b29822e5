"""layouts.py make FOLDER: writes a small data set in each layout, with splats of three frames and
the expected views, computed here. layouts.py compare EXPECTED VIEWS: compares the expected views
with the list that spin-import --info --views --json prints. Needs only the standard library."""
import json, math, os, random, struct, sys, zlib

W, H, FRAMES, CAMERAS = 16, 8, 3, 3


def png(path, width=W, height=H):
    def chunk(kind, data):
        return struct.pack('>I', len(data)) + kind + data + struct.pack('>I', zlib.crc32(kind + data))
    rows = b''.join(b'\0' + bytes(3 * width) for _ in range(height))
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, 'wb') as f:
        f.write(b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', struct.pack('>IIBBBBB', width, height, 8, 2, 0, 0, 0))
                + chunk(b'IDAT', zlib.compress(rows)) + chunk(b'IEND', b''))


def text(path, content):
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, 'w') as f:
        f.write(content)


class Camera:
    """A pinhole camera with a random pose: quaternion and translation of w2c."""

    def __init__(self, seed):
        r = random.Random(seed)
        q = [r.uniform(-1, 1) for _ in range(4)]
        n = math.sqrt(sum(v * v for v in q))
        self.q = w, x, y, z = [v / n for v in q]
        self.t = [r.uniform(-2, 2) for _ in range(3)]
        self.f, self.cx, self.cy = 10 + seed, 7.5, 4.25
        self.R = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                  [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                  [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]

    def w2c(self):
        return [v for row, t in zip(self.R, self.t) for v in row + [t]]

    def c2w(self):
        """c2w in OpenGL's axes, as in transforms.json."""
        centre = [-sum(self.R[k][i] * self.t[k] for k in range(3)) for i in range(3)]
        return [[self.R[0][i], -self.R[1][i], -self.R[2][i], centre[i]] for i in range(3)] + [[0, 0, 0, 1]]


def model_text(folder, cameras, names, points=True):
    text(folder + '/cameras.txt', '# cameras\n' + ''.join(
        '%d PINHOLE %d %d %r %r %r %r\n' % (i + 1, W, H, c.f, c.f, c.cx, c.cy)
        for i, c in enumerate(cameras)))
    line = '%d %s %s %d %s\n' + ('1.5 2.5 -1\n' if points else '')
    text(folder + '/images.txt', '# images\n' + ''.join(
        line % (i + 1, ' '.join(map(repr, c.q)), ' '.join(map(repr, c.t)), i + 1, name)
        for i, (c, name) in enumerate(zip(cameras, names))))
    text(folder + '/points3D.txt', '# points\n1 0.5 1 2 255 0 51 0.1\n2 1 2 3 0 255 0 0.1 1 1\n')


def model_binary(folder, cameras, names):
    os.makedirs(folder, exist_ok=True)
    with open(folder + '/cameras.bin', 'wb') as f:
        f.write(struct.pack('<Q', len(cameras)))
        for i, c in enumerate(cameras):
            f.write(struct.pack('<iiQQ4d', i + 1, 1, W, H, c.f, c.f, c.cx, c.cy))
    with open(folder + '/images.bin', 'wb') as f:
        f.write(struct.pack('<Q', len(cameras)))
        for i, (c, name) in enumerate(zip(cameras, names)):
            f.write(struct.pack('<i7di', i + 1, *c.q, *c.t, i + 1) + name.encode() + b'\0')
            f.write(struct.pack('<Q', 0))
    with open(folder + '/points3D.bin', 'wb') as f:
        f.write(struct.pack('<Q', 2))
        for i in range(2):
            f.write(struct.pack('<Q3d3BdQ', i + 1, i, 1, 2, 255, 0, 51, 0.1, 1) + struct.pack('<ii', 1, 1))


def splats(folder, n):
    names = 'x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'.split()
    for f in range(n):
        text('%s/frame_%04d.ply' % (folder, f),
             'ply\nformat ascii 1.0\nelement vertex 4\n' + ''.join('property float %s\n' % p for p in names)
             + 'end_header\n' + ''.join('%d 0 3 0 0 0 1 -3 -3 -3 1 0 0 0\n' % i for i in range(4)))


rig = [Camera(s) for s in range(CAMERAS)]
expected = {}


def expect(name, image, test, ids=range(CAMERAS), frames=range(FRAMES), first=0, cameras=rig):
    """image(frame, camera) is the path of an image below the data set, or None if it is missing."""
    expected[name] = [dict(frame=f - frames[0], number=f + first, camera=ids[c], test=test(c), image=image(f, c),
                           w2c=cameras[c].w2c(), fx=cameras[c].f, fy=cameras[c].f, cx=cameras[c].cx,
                           cy=cameras[c].cy, width=W, height=H)
                      for f in frames for c in range(len(cameras)) if image(f, c)]


def images(root, image, frames=range(FRAMES)):
    for f in frames:
        for c in range(CAMERAS):
            if image(f, c):
                png('%s/%s' % (root, image(f, c)))


def make_rig(root, name, model, names, image, test=lambda c: c == 0, ids=range(CAMERAS), first=0, **more):
    images(root + '/' + name, image)
    model_text('%s/%s%s' % (root, name, model), rig, names, **more)
    expect(name, image, test, ids, first=first)


def make(root):
    splats(root + '/clip', FRAMES)
    splats(root + '/still', 1)
    cam = ['cam%02d' % c for c in range(CAMERAS)]
    # 4DGaussians' MultipleView: frames count from 1, and so do the cameras.
    make_rig(root, 'multipleview', '/sparse_', ['image%d.jpg' % (c + 1) for c in range(CAMERAS)],
             lambda f, c: 'cam%02d/frame_%05d.png' % (c + 1, f + 1), first=1)
    text(root + '/multipleview/points3D_multipleview.ply', 'ply\nformat ascii 1.0\nelement vertex 2\n'
         + ''.join('property float %s\n' % c for c in 'xyz') + 'end_header\n0 0 3\n1 0 3\n')
    # SpacetimeGaussians: the COLMAP model of the first folder is used.
    images(root + '/colmap_t', lambda f, c: 'colmap_%d/images/%s.png' % (f, cam[c]))
    model_binary(root + '/colmap_t/colmap_0/sparse/0', rig, [n + '.png' for n in cam])
    for f in range(1, FRAMES):
        model_binary('%s/colmap_t/colmap_%d/sparse/0' % (root, f), [Camera(9)] * 3, [n + '.png' for n in cam])
    expect('colmap_t', lambda f, c: 'colmap_%d/images/%s.png' % (f, cam[c]), lambda c: c == 0)
    # Technicolor
    images(root + '/technicolor', lambda f, c: 'Fabien_undist_%05d_%02d.png' % (f, c))
    text(root + '/technicolor/cameras_parameters.txt', 'f cu cv ar sk qw qx qy qz tx ty tz\n' + ''.join(
        ' '.join(map(repr, [c.f, c.cx, c.cy, 1.0, 0.0] + list(c.q) + c.t)) + ' \n' for c in rig))
    expect('technicolor', lambda f, c: 'Fabien_undist_%05d_%02d.png' % (f, c), lambda c: c == 0)
    # Its original images have two distortion coefficients, which are 0 here, and an aspect ratio.
    images(root + '/technicolor_14', lambda f, c: 'Birthday_%03d_%02d.png' % (f + 151, c))
    text(root + '/technicolor_14/cameras_parameters.txt', 'f cu cv ar sk k1 k2 qw qx qy qz tx ty tz\n' + ''.join(
        ' '.join(map(repr, [c.f / 1.25, c.cx, c.cy, 1.25, 0.0, 0.0, 0.0] + [2 * v for v in c.q] + c.t)) + '\n'
        for c in rig))
    expect('technicolor_14', lambda f, c: 'Birthday_%03d_%02d.png' % (f + 151, c), lambda c: c == 0, first=151)
    for view in expected['technicolor_14']:
        view['fx'] /= 1.25
    # A rig with one COLMAP model: a folder per camera, a folder per frame, a single folder, and all
    # images registered in the model.
    make_rig(root, 'rig_cameras', '/sparse/0', [n + '.png' for n in cam], lambda f, c: '%s/%04d.png' % (cam[c], f))
    make_rig(root, 'rig_frames', '/sparse/0', [n + '.png' for n in cam],
             lambda f, c: 'images/%04d/%s.png' % (f, cam[c]))
    make_rig(root, 'rig_flat', '/sparse/0', [n + '_0000.png' for n in cam],
             lambda f, c: 'images/%s_%04d.png' % (cam[c], f))
    every = [(f, c) for f in range(FRAMES) for c in range(CAMERAS)]
    for name, image in (('rig_all', lambda f, c: '%s/%04d.png' % (cam[c], f)),
                        ('rig_folders', lambda f, c: '%04d_b/%s.png' % (f, cam[c]))):
        images(root + '/' + name, lambda f, c: 'images/' + image(f, c))
        model_text('%s/%s/sparse/0' % (root, name), [rig[c] for _, c in every], [image(f, c) for f, c in every])
        expect(name, lambda f, c: 'images/' + image(f, c), lambda c: c == 0)
    # Frames that lack some images: one of 9 is missing.
    make_rig(root, 'missing', '/sparse/0', [n + '.png' for n in cam],
             lambda f, c: None if (f, c) == (1, 2) else 'images/%s/%04d.png' % (cam[c], f))
    # Static scenes: text or binary COLMAP files beside the images, without point lines, in
    # sparse/0.
    names = ['left.png', 'middle.png', 'right.png']
    for name, write, where, images_in in (
            ('still', model_text, '/sparse/0', 'images/'), ('beside_text', model_text, '', ''),
            ('beside_binary', model_binary, '', ''), ('beside_images', model_text, '', 'images/'),
            ('no_points', lambda *a: model_text(*a, points=False), '/sparse', 'images/')):
        write(root + '/' + name + where, rig, names)
        for n in names:
            png('%s/%s/%s%s' % (root, name, images_in, n))
        expect(name, lambda f, c: images_in + names[c], lambda c: c == 0, frames=range(1))
    json.dump(expected, open(root + '/expected.json', 'w'))


def compare(expected, views, root):
    want, got = json.load(open(expected))[os.path.basename(root)], json.load(open(views))
    bad = [] if len(want) == len(got) else ['%d views, expected %d' % (len(got), len(want))]
    for a, b in zip(want, got):
        if not os.path.normpath(b['image']).endswith(os.path.normpath('/%s/%s' % (os.path.basename(root), a['image']))):
            bad.append('image %s, expected %s' % (b['image'], a['image']))
        for key in ('frame', 'camera', 'test', 'width', 'height'):
            if a[key] != b[key]:
                bad.append('%s: %s is %s, expected %s' % (a['image'], key, b[key], a[key]))
        worst = max(abs(x - y) for x, y in zip(a['w2c'] + [a[k] for k in ('fx', 'fy', 'cx', 'cy')],
                                               b['w2c'] + [b[k] for k in ('fx', 'fy', 'cx', 'cy')]))
        if not worst < 1e-9:
            bad.append('%s: a value of the camera is off by %g' % (a['image'], worst))
    for line in bad[:5]:
        print('#', line)
    sys.exit(bool(bad))


if __name__ == '__main__' and sys.argv[1] == 'make':
    make(sys.argv[2])
elif __name__ == '__main__':
    compare(sys.argv[2], sys.argv[3], sys.argv[4])
