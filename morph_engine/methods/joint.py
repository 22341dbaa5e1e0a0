"""Differentiable MPM driven by grid mass and Chamfer distance together (algorithm 5, 7)."""

from __future__ import annotations

from typing import ClassVar

from morph_engine.methods.physics import Physics


class Joint(Physics):
    """Physics first, then the bidirectional Chamfer distance as well; the paper's own method."""

    name: ClassVar[str] = "joint"
    with_chamfer: ClassVar[bool] = True
