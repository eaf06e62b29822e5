#!/usr/bin/env python3
"""LPIPS of two synthetic images with synthetic weights, in plain NumPy and double precision.

    python3 tests/tools/lpips-reference.py > fixtures/lpips/expected.json

Written from the description of the method (Zhang et al. 2018, version 0.1 of its weights),
independently of src/eval/lpips.c: the convolution is a sum over shifted images. Weights and images
come from the formula in noise() below, which tests/eval/t-lpips.c implements as well, so that no
weights need to be stored."""
import json
import sys

import numpy as np

WIDTH, HEIGHT = 67, 45
VGG = [(0, 3, 64), (2, 64, 64), "stage", "pool", (5, 64, 128), (7, 128, 128), "stage", "pool",
       (10, 128, 256), (12, 256, 256), (14, 256, 256), "stage", "pool",
       (17, 256, 512), (19, 512, 512), (21, 512, 512), "stage", "pool",
       (24, 512, 512), (26, 512, 512), (28, 512, 512), "stage"]
ALEX = [(0, 3, 64, 11, 4, 2), "stage", "pool", (3, 64, 192, 5, 1, 2), "stage", "pool",
        (6, 192, 384), "stage", (8, 384, 256), "stage", (10, 256, 256), "stage"]


def noise(stream, n):
    """n float32 in [0, 1), the same as noise() of the test."""
    h = np.arange(n, dtype=np.uint32) * np.uint32(2654435761) + np.uint32(stream) * np.uint32(40503)
    h ^= h >> np.uint32(15)
    h *= np.uint32(2246822519)
    h ^= h >> np.uint32(13)
    h *= np.uint32(3266489917)
    h ^= h >> np.uint32(16)
    return (h >> np.uint32(8)).astype(np.float32) / np.float32(1 << 24)


def weights(net, place, n_in, n_out, kernel):
    size = np.float32(2 * np.sqrt(6 / (n_in * kernel * kernel)))
    w = (noise(1000 * net + 2 * place, n_out * n_in * kernel * kernel) - np.float32(0.5)) * size
    b = (noise(1000 * net + 2 * place + 1, n_out) - np.float32(0.5)) * np.float32(0.2)
    return w.reshape(n_out, n_in, kernel, kernel).astype(np.float64), b.astype(np.float64)


def conv(x, w, b, stride, pad):
    kernel = w.shape[2]
    x = np.pad(x, ((0, 0), (pad, pad), (pad, pad)))
    height = (x.shape[1] - kernel) // stride + 1
    width = (x.shape[2] - kernel) // stride + 1
    out = np.zeros((w.shape[0], height, width)) + b[:, None, None]
    for v in range(kernel):
        for u in range(kernel):
            part = x[:, v:v + stride * height:stride, u:u + stride * width:stride]
            out += np.tensordot(w[:, :, v, u], part[:, :height, :width], axes=1)
    return out


def pool(x, window):
    height, width = (x.shape[1] - window) // 2 + 1, (x.shape[2] - window) // 2 + 1
    return np.max([x[:, v:v + 2 * height:2, u:u + 2 * width:2][:, :height, :width]
                   for v in range(window) for u in range(window)], axis=0)


def features(net, layers, image):
    shift = np.array([-0.030, -0.088, -0.188])[:, None, None]
    scale = np.array([0.458, 0.448, 0.450])[:, None, None]
    x = (2 * image - 1 - shift) / scale
    found = []
    for layer in layers:
        if layer == "stage":
            found.append(x)
        elif layer == "pool":
            x = pool(x, 2 if net == 0 else 3)
        else:
            place, n_in, n_out, kernel, stride, pad = layer if len(layer) == 6 else (*layer, 3, 1, 1)
            w, b = weights(net, place, n_in, n_out, kernel)
            x = np.maximum(conv(x, w, b, stride, pad), 0)
    return found


def distance(net, layers, first, second):
    stages = []
    pairs = zip(features(net, layers, first), features(net, layers, second))
    for s, (f, g) in enumerate(pairs):
        f = f / (np.sqrt((f * f).sum(0)) + 1e-10)
        g = g / (np.sqrt((g * g).sum(0)) + 1e-10)
        lin = noise(1000 * net + 900 + s, f.shape[0]).astype(np.float64)
        stages.append(float((lin[:, None, None] * (f - g) ** 2).sum(0).mean()))
    return {"distance": sum(stages), "stages": stages}


def main():
    first = noise(5000, 3 * WIDTH * HEIGHT).astype(np.float64).reshape(3, HEIGHT, WIDTH)
    second = noise(5001, 3 * WIDTH * HEIGHT).astype(np.float64).reshape(3, HEIGHT, WIDTH)
    second = np.float32(0.75) * first + np.float32(0.25) * second
    json.dump({"width": WIDTH, "height": HEIGHT, "vgg": distance(0, VGG, first, second),
               "alex": distance(1, ALEX, first, second)}, sys.stdout, indent=1)
    print()


main()
