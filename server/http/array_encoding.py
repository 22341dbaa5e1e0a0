"""Arrays of points as bytes: float32, 16-bit levels, PLY, NumPy; headers tell how to read them."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from fastapi import Request, Response
from numpy.typing import NDArray

from chamfer_morph.schemas import FrameFormat
from chamfer_morph.server.http.conditional import binary_responses, bytes_response

BYTES = "application/octet-stream"
PLY = "application/x-ply"
NPY = "application/x-npy"
LEVELS = 65535

HEADERS = {
    "Morph-Particles": ("integer", "Number of points."),
    "Morph-Offset": ("number", "For u16: position = Morph-Offset + Morph-Scale x value."),
    "Morph-Scale": ("number", "For u16: position = Morph-Offset + Morph-Scale x value."),
}


def array_responses(
    description: str, headers: Mapping[str, tuple[str, str]] | None = None
) -> dict[int | str, dict[str, Any]]:
    """The contract of an endpoint that answers points; arguments as of `binary_responses`."""
    return binary_responses(description, (BYTES, PLY, NPY), HEADERS | dict(headers or {}))


def array_response(
    request: Request,
    positions: NDArray[np.float32],
    format: FrameFormat,
    extent: float,
    headers: Mapping[str, str] | None = None,
) -> Response:
    """The answer to a request for points, as of `encode_positions`, unless the caller has them."""
    body, media_type = encode_positions(positions, format, extent)
    all_headers = {"Morph-Particles": str(len(positions)), **(headers or {})}
    if format == "u16":
        all_headers |= {"Morph-Offset": repr(-extent), "Morph-Scale": repr(2 * extent / LEVELS)}
    return bytes_response(request, body, media_type, all_headers)


def encode_positions(
    positions: NDArray[np.float32], format: FrameFormat, extent: float
) -> tuple[bytes, str]:
    """Positions as bytes.

    Args:
        positions: Particle positions [grid units], shape [n, 3], float32.
        format: f32, u16, ply or npy.
        extent: Half edge of the domain, which the levels of u16 divide evenly [grid units].

    Returns:
        The bytes and their media type.
    """
    plain = np.ascontiguousarray(positions, "<f4")
    if format == "f32":
        return plain.tobytes(), BYTES
    if format == "u16":
        levels = np.nan_to_num((plain.astype(np.float64) + extent) * (LEVELS / (2 * extent)))
        return np.rint(levels).clip(0, LEVELS).astype("<u2").tobytes(), BYTES
    if format == "npy":
        file = io.BytesIO()
        np.save(file, plain, allow_pickle=False)
        return file.getvalue(), NPY
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment lengths in grid units\n"
        f"element vertex {len(plain)}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    return header.encode() + plain.tobytes(), PLY
