#!/usr/bin/env python3
"""jpeg_noise.py DIR...: how many dB a perfect picture would have against photographs that were saved as JPEG.

Each file under DIR/ims is cut by some pixels, so that its blocks lie elsewhere, and saved again with its own tables and
subsampling. What that changes is about what the first saving changed: saving a third time, cut again, gives the same
within 0.3 dB (the second number). Needs NumPy and Pillow."""
import glob
import io
import sys

import numpy as np
from PIL import Image, JpegImagePlugin

MOST = 24  # pictures of a data set


def saved(pixels, like):
    buffer = io.BytesIO()
    sampling = JpegImagePlugin.get_sampling(like)
    Image.fromarray(pixels).save(buffer, "JPEG", qtables=like.quantization, subsampling=sampling)
    return np.asarray(Image.open(buffer))


def squares(path):
    like = Image.open(path)
    pixels, found = np.asarray(like.convert("RGB")), []
    for by in 4, 3:
        cut = np.ascontiguousarray(pixels[by:, by:])
        pixels = saved(cut, like)
        found.append(np.mean((pixels.astype(float) - cut) ** 2))
    return found


for folder in sys.argv[1:]:
    files = sorted(glob.glob(f"{folder}/ims/*/*.jpg"))
    files = files[:: max(1, len(files) // MOST)]
    if not files:
        sys.exit(f"jpeg_noise.py: no file {folder}/ims/*/*.jpg")
    first, second = 10 * np.log10(255**2 / np.mean([squares(f) for f in files], axis=0))
    print(f"{folder}: {first:.2f} dB, saved once more {second:.2f} dB, of {len(files)} pictures")
