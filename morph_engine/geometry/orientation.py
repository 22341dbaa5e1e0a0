"""Faces that face against their neighbours, as found in scans and merged models."""

from __future__ import annotations

from typing import Any

import lazy_loader as lazy
import numpy as np
import numpy.typing as npt

from morph_engine.geometry.topology import Topology, face_volumes

igl: Any = lazy.load("igl")


def reversed_faces(
    vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int32]
) -> npt.NDArray[np.bool_]:
    """Which faces have to be turned for all of a part to look the same way, outwards.

    Parts whose faces agree stay as they are, since those that look inwards are cavities. Faces hang
    together where just two meet at an edge.

    Args:
        vertices: Corner positions, shape [v, 3].
        faces: Vertex indices, shape [f, 3].

    Returns:
        Shape [f].
    """
    topology = Topology(vertices, faces)
    turned = np.zeros(len(faces), np.bool_)
    if not topology.disagree:
        return turned
    corners = topology.faces.astype(np.int64)
    oriented, part = igl.bfs_orient(corners)
    other = (oriented != corners).any(axis=1)
    disagreeing = np.bincount(part, other) > 0
    inwards = np.bincount(part, face_volumes(topology.points, oriented)) < 0
    turned[topology.kept] = disagreeing[part] & (other ^ inwards[part])
    return turned
