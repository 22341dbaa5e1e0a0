"""The step in C++ (cpp/), float32, two threads, compiled here by `g++ -O3 -march=native`."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from benchmarks import scene as constants
from benchmarks.peers import PeerMissingError
from benchmarks.scene import Layer, Scene

THREADS = 2
SOURCES = Path(__file__).with_name("cpp")
FLOATS = ("GRID_MIN", "DT", "DRAG", "LAMBDA", "MU", "SMOOTHING", "MASS_FLOOR")


class CppStep:
    """A `Stepper` in plain C++; needs g++ with OpenMP."""

    name: ClassVar[str] = "plain C++"
    transfer: ClassVar[str] = "transfer_plain.h"

    def __init__(self, scene: Scene) -> None:
        layer = scene.layer
        self.inputs = [
            np.ascontiguousarray(a, dtype=np.float32)
            for a in (scene.volume, layer.x, layer.v, layer.C, layer.F, scene.U)
        ]
        self.next = Layer(*(np.zeros_like(a) for a in self.inputs[1:5]))
        outputs = (self.next.x, self.next.v, self.next.C, self.next.F)
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (*self.inputs, *outputs)]
        self.arguments = (scene.particle_count, ctypes.c_float(scene.mass), *pointers)
        self.step = library(self.transfer).mpm_step

    def advance(self) -> None:
        """One step."""
        self.step(*self.arguments)

    def result(self) -> Layer:
        """Return the layer after the scene's."""
        return self.next


class CppFloat4Step(CppStep):
    """The same with the transfer arranged for vector registers: about the limit of this way."""

    name: ClassVar[str] = "C++, vectorised by hand"
    transfer: ClassVar[str] = "transfer_float4.h"


@cache
def library(transfer: str) -> Any:
    """Compile cpp/step.cpp and load it; raises PeerMissingError without a working g++."""
    compiler = shutil.which("g++")
    if compiler is None:
        raise PeerMissingError("g++ is not installed")
    # Threads that spin between parallel loops would be charged as CPU time.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    definitions = [f"-D{name}={np.float32(getattr(constants, name))!s}f" for name in FLOATS]
    definitions += [f"-DNODES_PER_AXIS={constants.NODES_PER_AXIS}", f"-DTHREADS={THREADS}"]
    definitions += [f'-DTRANSFER="{transfer}"']
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "step.so"
        options = ["-O3", "-march=native", "-std=c++17", "-fopenmp", "-shared", "-fPIC"]
        command = [compiler, *options, *definitions, str(SOURCES / "step.cpp"), "-o", str(target)]
        outcome = subprocess.run(command, capture_output=True, text=True, check=False)
        if outcome.returncode != 0:
            raise PeerMissingError(f"g++ failed: {outcome.stderr.strip().splitlines()[-1]}")
        return ctypes.CDLL(str(target))
