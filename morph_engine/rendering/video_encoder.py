"""Films as files: MP4, WebM and ProRes by PyAV, GIF and PNG by Pillow."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from PIL import Image

from morph_engine.errors import ConfigError
from morph_engine.files import replacing_frames
from morph_engine.optional_packages import load

VideoKind = Literal["mp4", "gif", "webm", "mov", "png"]
Picture = npt.NDArray[np.uint8]

EARLIEST = (1980, 1, 1, 0, 0, 0)
"""What a zip archive can say earliest; the same film twice gives the same bytes."""


@dataclass(frozen=True)
class _Encoding:
    """How PyAV writes a kind of video.

    Attributes:
        container: Format of the file.
        codec: Name of the encoder.
        opaque: Pixel format without transparency.
        transparent: Pixel format with it; empty where there is none.
        options: Of the encoder.
        container_options: Of the file.
    """

    container: str
    codec: str
    opaque: str
    transparent: str = ""
    options: Mapping[str, str] = field(default_factory=dict)
    container_options: Mapping[str, str] = field(default_factory=dict)


# A constant rate factor of H.264 of 0 is lossless, 18 looks so, 28 is coarse; VP9 counts to 63.
_ENCODINGS: dict[VideoKind, _Encoding] = {
    "mp4": _Encoding(
        "mp4",
        "libx264",
        "yuv420p",
        options={"crf": "20"},
        container_options={"movflags": "+faststart"},
    ),
    "webm": _Encoding(
        "webm",
        "libvpx-vp9",
        "yuv420p",
        "yuva420p",
        options={"crf": "24", "b": "0", "deadline": "good", "cpu-used": "4"},
    ),
    "mov": _Encoding(
        "mov", "prores_ks", "yuv444p10le", "yuva444p10le", options={"profile": "4444"}
    ),
}

BT_709 = 1
"""Primaries, transfer and matrix of HD video, by the number that ITU-T H.273 gives them."""

LIMITED_RANGE = 1
"""Of luma from 16 to 235, as players expect."""

LEAST_RATE, LARGEST_RATE = 0.01, 1000.0
"""Frames per second that a file can say."""

FASTEST_GIF = 50.0
"""Most frames per second of a GIF: browsers play a frame of 10 ms or less as one of 100 ms."""

TRANSPARENT_KINDS: tuple[VideoKind, ...] = ("png", "webm", "mov")
"""Kinds that may have a transparent background."""


def check_rate(kind: str, fps: float) -> None:
    """Refuse what is no rate, or what players would not play at its rate.

    Raises:
        ConfigError: There are too few or too many frames per second.
    """
    if not LEAST_RATE <= fps <= LARGEST_RATE:
        raise ConfigError(
            f"{fps:g} frames per second is out of range.",
            f"Use {LEAST_RATE:g} to {LARGEST_RATE:g}.",
        )
    if kind == "gif" and fps > FASTEST_GIF:
        raise ConfigError(
            f"Browsers play a GIF of {fps:g} frames per second several times slower.",
            f"Use at most {FASTEST_GIF:g} frames per second, or another kind of video.",
        )


def write_video(path: Path, pictures: Iterable[Picture], *, kind: VideoKind, fps: float) -> None:
    """Write pictures as a video, one after the other.

    Args:
        path: The file.
        pictures: RGB or RGBA, each of shape [height, width, 3 or 4], uint8; height and width are
            even. RGBA only for `TRANSPARENT_KINDS`.
        kind: ``mp4`` (H.264, which every player knows), ``webm`` (VP9), ``mov`` (ProRes 4444),
            ``gif``, or ``png`` for a zip archive with a file per picture.
        fps: Pictures per second; files of ``png`` do not tell.

    Raises:
        ConfigError: PyAV has been built without the encoder.
        ExtraError: PyAV is needed and not installed.
        OSError: The disk refuses.
    """
    if kind == "gif":
        _write_gif(path, pictures, fps)
    elif kind == "png":
        _write_archive(path, pictures)
    else:
        _write_by_av(path, pictures, fps, kind)


def write_pictures(folder: Path, pictures: Iterable[Picture]) -> None:
    """Write pictures as PNG files into a folder: frame-0000.png and so on, see `replacing_frames`.

    Args:
        folder: The folder.
        pictures: As for `write_video`.

    Raises:
        OSError: The disk refuses.
    """
    with replacing_frames(folder) as temporary:
        for name, data in _png_files(pictures):
            temporary(name).write_bytes(data)


def write_picture(path: Path, picture: Picture) -> None:
    """Write one picture as a PNG file.

    Args:
        path: The file, whatever its ending.
        picture: As for `write_video`.

    Raises:
        OSError: The disk refuses.
    """
    Image.fromarray(picture).save(path, "PNG")


def _write_by_av(path: Path, pictures: Iterable[Picture], fps: float, kind: VideoKind) -> None:
    av = load("av", extra="video", purpose={"mp4": "MP4", "webm": "WebM", "mov": "ProRes"}[kind])
    encoding = _ENCODINGS[kind]
    _check_codec(av, encoding.codec)
    rate = Fraction(fps).limit_denominator(1000)
    with av.open(
        str(path), "w", format=encoding.container, options=dict(encoding.container_options)
    ) as file:
        stream = file.add_stream(encoding.codec, rate=rate, options=dict(encoding.options))
        for count, picture in enumerate(pictures):
            with_alpha = picture.shape[2] == 4
            if not count:
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = encoding.transparent if with_alpha else encoding.opaque
                _tag_colors(stream.codec_context)
            frame = av.VideoFrame.from_ndarray(picture, format="rgba" if with_alpha else "rgb24")
            converted = frame.reformat(
                format=stream.pix_fmt, dst_colorspace="ITU709", dst_color_range="MPEG"
            )
            file.mux(stream.encode(converted))
        file.mux(stream.encode(None))


def _tag_colors(context: Any) -> None:
    """Say how colours are stored, since players guess differently where nothing is said."""
    context.colorspace = context.color_primaries = context.color_trc = BT_709
    context.color_range = LIMITED_RANGE


def _check_codec(av: Any, codec: str) -> None:
    try:
        av.codec.Codec(codec, "w")
    except ValueError as error:
        raise ConfigError(
            f"PyAV has been built without the encoder {codec}.",
            "Use another kind of video, or install PyAV from its wheels (pip install av).",
        ) from error


def _write_gif(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    images: list[Image.Image] = []
    last: Picture | None = None
    for picture in pictures:
        # choosing colours takes longer than drawing; a picture that rests has them already
        images.append(images[-1] if picture is last else Image.fromarray(picture).quantize(256))
        last = picture
    # a GIF counts hundredths of a second: rounded one by one they would add up to another duration
    ends = [round(100 * count / fps) for count in range(len(images) + 1)]
    durations = [10 * (end - begin) for begin, end in pairwise(ends)]
    images[0].save(
        path,
        "GIF",
        save_all=True,
        append_images=images[1:],
        duration=durations,
        loop=0,
        optimize=False,
    )


def _write_archive(path: Path, pictures: Iterable[Picture]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in _png_files(pictures):
            archive.writestr(zipfile.ZipInfo(name, EARLIEST), data)


def _png_files(pictures: Iterable[Picture]) -> Iterator[tuple[str, bytes]]:
    """Name and content of a file per picture."""
    for count, picture in enumerate(pictures):
        file = io.BytesIO()
        Image.fromarray(picture).save(file, "PNG")
        yield f"frame-{count:04d}.png", file.getvalue()
