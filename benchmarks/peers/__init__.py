"""The peers: other programs for the same MPM step, each written as well as its own means allow.

Every stepping peer is a class with the attributes and methods of `Stepper`. A peer that cannot run
here raises `PeerMissingError`, with the reason, when it is imported or constructed.
"""

from __future__ import annotations

from typing import ClassVar, Protocol

from benchmarks.scene import Layer, Scene


class PeerMissingError(RuntimeError):
    """A peer cannot run on this machine; the message says why."""


class Stepper(Protocol):
    """One program that takes a scene one forward step further."""

    name: ClassVar[str]

    def __init__(self, scene: Scene) -> None:
        """Compile and move the scene into the peer's own memory (not timed)."""

    def advance(self) -> None:
        """Compute the layer after the scene's; each call repeats the same work (timed)."""

    def result(self) -> Layer:
        """Copy out the layer that `advance` computed (not timed)."""
