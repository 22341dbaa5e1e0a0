"""Video files: MP4 by PyAV, GIF by Pillow."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from PIL import Image

from morph_engine.optional_packages import load

VideoKind = Literal["mp4", "gif"]
Picture = npt.NDArray[np.uint8]

QUALITY = "20"
"""Constant rate factor of H.264: 0 is lossless, 18 looks so, 28 is coarse."""


def write_video(path: Path, pictures: Iterable[Picture], *, kind: VideoKind, fps: float) -> None:
    """Write pictures as a video, one after the other.

    Args:
        path: The file.
        pictures: RGB, each of shape [height, width, 3], uint8; height and width are even.
        kind: ``mp4`` (H.264, which every player knows) or ``gif``.
        fps: Pictures per second.

    Raises:
        ExtraError: An MP4 is asked for, and PyAV is not installed.
        OSError: The disk refuses.
    """
    if kind == "mp4":
        _write_mp4(path, pictures, fps)
    else:
        _write_gif(path, pictures, fps)


def _write_mp4(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    av = load("av", extra="video", purpose="MP4")
    rate = Fraction(fps).limit_denominator(1000)
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as file:
        stream = file.add_stream("libx264", rate=rate, options={"crf": QUALITY})
        stream.pix_fmt = "yuv420p"
        for count, picture in enumerate(pictures):
            if not count:
                stream.height, stream.width = picture.shape[:2]
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        file.mux(stream.encode(None))


def _write_gif(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    images: list[Image.Image] = []
    last: Picture | None = None
    for picture in pictures:
        # choosing colours takes longer than drawing; a picture that rests has them already
        images.append(images[-1] if picture is last else Image.fromarray(picture).quantize(256))
        last = picture
    images[0].save(
        path,
        "GIF",
        save_all=True,
        append_images=images[1:],
        duration=round(1000 / fps),
        loop=0,
        optimize=False,
    )
