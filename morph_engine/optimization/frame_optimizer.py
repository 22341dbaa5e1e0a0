"""One frame: control steps, line search and watchdog (algorithm 6).

A frame starts from the carried state with zero control and improves the control of its layers in
passes. A control step takes the gradient of the loss at the last layer by the control of one layer
(or of all), tries ever smaller steps, and keeps the first that lowers the loss and raises no fault.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

from morph_engine.errors import SimulationError
from morph_engine.losses.chamfer import ChamferLoss
from morph_engine.losses.grid_mass import GridMassLoss
from morph_engine.mpm.faults import NON_FINITE, OUTSIDE, fault_names
from morph_engine.mpm.simulation import Simulation
from morph_engine.optimization import watchdog
from morph_engine.optimization.layer_optimizer import LayerOptimizer, Norm
from morph_engine.optimization.line_search import backtrack
from morph_engine.optimization.schedule import FrameWeights
from morph_engine.optimization.watchdog import Event
from morph_engine.sections import OptimizerConfig

SMALLEST = 1e-12


@dataclass(frozen=True)
class Losses:
    """L_phys and L_ch of one state; L_ch is 0 where the Chamfer term is off."""

    physics: float
    chamfer: float


@dataclass
class FrameReport:
    """What happened in one frame: final losses, control steps, time step [s] and watchdog events.

    A control step has failed if every trial was rejected.
    """

    losses: Losses = Losses(math.nan, math.nan)
    accepted: int = 0
    failed: int = 0
    dt: float = math.nan
    events: list[Event] = field(default_factory=list)


class FrameOptimizer:
    """Optimises the control of a simulation's frame.

    Args:
        simulation: The layers of the frame; layer 0 holds the state it starts from.
        grid_loss: Grid mass loss.
        chamfer_loss: Chamfer loss, or None for physics alone.
        config: Passes, steps and line search.
        restarts: Restarts of a frame at half the time step.
        normalize_by: Gradient norm that scales the update.
        weight_mode: Where the weight of the grid mass loss acts.
    """

    def __init__(
        self,
        simulation: Simulation,
        grid_loss: GridMassLoss,
        chamfer_loss: ChamferLoss | None = None,
        *,
        config: OptimizerConfig,
        restarts: int,
        normalize_by: Literal["physics", "total"] = "total",
        weight_mode: Literal["coupling_only", "chain", "literal"] = "coupling_only",
    ) -> None:
        self._simulation = simulation
        self._grid_loss = grid_loss
        self._chamfer_loss = chamfer_loss
        self._config = config
        self._restarts = restarts
        self._normalize_by = normalize_by
        self._weight_mode = weight_mode
        self._dt = simulation.dt
        count = len(simulation.transitions)
        self._controls = [LayerOptimizer(simulation.particle_count, config) for _ in range(count)]
        size = config.layers_per_step
        self._groups = [
            list(range(first, min(first + size, count))) for first in range(0, count, size)
        ]
        self._norm = Norm()
        self._weights = FrameWeights(0.0, 0.0, 1.0, 1.0)
        self._step = config.step
        self._counts = [0] * count
        self._losses = Losses(math.nan, math.nan)
        self._rejected: Counter[str] = Counter()
        self._tolerated = 0

    def run(self, frame: int, weights: FrameWeights, distance: float) -> FrameReport:
        """Optimise one frame from the state in layer 0; the result is the last layer.

        Args:
            frame: 0-based frame index.
            weights: The scheduled numbers of the frame.
            distance: Two-sided distance between particles and target in layer 0 [dx].

        A frame that fails even without control is restarted from its first state with half the
        time step. A particle that leaves the domain at any time step may do so, and is left there
        as in the published program (algorithm 2.1): the grid holds it less and less, and from one
        cell outside not at all. With a margin before the walls none may.

        Raises:
            SimulationError: It still fails after all restarts.
        """
        report = FrameReport()
        simulation = self._simulation
        simulation.smoothing = weights.smoothing
        self._weights = weights
        self._step = self._first_step(distance)
        before = simulation.outside(simulation.layers[0])
        may_leave = OUTSIDE if simulation.domain >= simulation.grid.half_extent else 0
        self._tolerate(may_leave if before else 0)
        faults = self._start(frame, report)
        if faults & may_leave:
            self._tolerate(may_leave)
            faults = self._start(frame, report)
        if faults:
            names = ", ".join(fault_names(faults))
            raise SimulationError.after(
                frame,
                f"{names}, even at a time step of {simulation.dt:.2g} s",
                "try a smaller `optimizer.step` or `time.dt`",
            )
        for pass_index in range(self._config.passes):
            for group in self._groups:
                if self._control_step(group, pass_index):
                    report.accepted += 1
                else:
                    report.failed += 1
        report.losses = self._losses
        report.dt = simulation.dt
        report.events += [
            watchdog.rejected(frame, count, cause)
            for cause, count in sorted(self._rejected.items())
        ]
        if self._tolerated and (now := simulation.outside(simulation.last)) != before:
            report.events.append(watchdog.outside(frame, now))
        return report

    def _start(self, frame: int, report: FrameReport) -> int:
        """Simulate a frame without control, at the largest time step at which that succeeds.

        Returns:
            Its faults at the smallest time step; 0 if it has succeeded.
        """
        simulation = self._simulation
        simulation.dt = self._dt
        for restart in range(self._restarts + 1):
            self._reset()
            faults = self._forward()
            if faults == 0:
                self._losses = self._evaluate()
                if math.isfinite(self._losses.physics + self._losses.chamfer):
                    return 0
                faults = NON_FINITE
            if restart < self._restarts:
                simulation.dt /= 2
                cause = ", ".join(fault_names(faults))
                report.events.append(watchdog.restarted(frame, simulation.dt, cause))
        return faults

    def _tolerate(self, faults: int) -> None:
        self._tolerated = faults
        self._simulation.let_go(bool(faults))

    def _forward(self, first: int = 0) -> int:
        """Simulate from a layer on; the faults that are not tolerated in this frame."""
        return self._simulation.forward(first) & ~self._tolerated

    def _reset(self) -> None:
        for control, transition in zip(self._controls, self._simulation.transitions, strict=True):
            control.reset()
            transition.U = control.kept
        self._counts = [0] * len(self._controls)
        self._rejected.clear()

    def _control_step(self, group: list[int], pass_index: int) -> bool:
        """Improve the control of the layers in a group; whether a trial was accepted."""
        optimizer = self._config
        lowest = group[0]
        before = self._losses
        chamfer_weight = self._chamfer_weight(before)
        norms = self._physics_norms(group) if self._normalize_by == "physics" else None
        if norms is None or chamfer_weight or self._decay(pass_index) != 1:
            self._seed_gradient(chamfer_weight)
            self._simulation.backward(lowest, decay=self._decay(pass_index))
        norms = norms or self._norms(group)

        def trial(share: float) -> float:
            for layer, norm in zip(group, norms, strict=True):
                scale = optimizer.target_norm / max(norm, 1e-6)
                alpha = self._step * min(max(scale, optimizer.smallest_scale), 1.0)
                self._simulation.transitions[layer].U = self._controls[layer].try_step(
                    self._simulation.transitions[layer].U_bar,
                    norm,
                    alpha * share,
                    self._update_count(layer) + 1,
                )
            faults = self._forward(lowest)
            self._losses = self._evaluate() if faults == 0 else Losses(math.nan, math.nan)
            value = self._objective(self._losses, chamfer_weight)
            if faults or not math.isfinite(value):
                self._rejected.update(fault_names(faults or NON_FINITE))
            return value

        if backtrack(
            trial,
            self._objective(before, chamfer_weight),
            trials=optimizer.line_search_trials,
            factor=optimizer.line_search_factor,
        ):
            for layer in group:
                self._controls[layer].accept()
                self._counts[layer] += 1
            return True
        for layer in group:
            self._simulation.transitions[layer].U = self._controls[layer].kept
        self._simulation.forward(lowest)
        self._losses = self._evaluate()
        return False

    def _first_step(self, distance: float) -> float:
        """alpha_0 of a frame: larger where there is far to go."""
        optimizer = self._config
        if optimizer.far_distance == 0:
            return optimizer.step
        growth = distance / optimizer.far_distance
        return optimizer.step * min(max(growth, 1.0), optimizer.far_factor)

    def _update_count(self, layer: int) -> int:
        shared = self._config.shared_counter
        return sum(self._counts) if shared else self._counts[layer]

    def _evaluate(self) -> Losses:
        x = self._simulation.last.x
        chamfer = 0.0
        if self._chamfer_loss is not None and self._weights.chamfer > 0:
            chamfer = self._chamfer_loss.evaluate(x, self._weights.reverse)
        return Losses(self._grid_loss.evaluate(x), chamfer)

    def _chamfer_weight(self, losses: Losses) -> float:
        """W of algorithm 5.4, frozen for one control step."""
        weight = self._weights.chamfer
        loss = self._chamfer_loss
        if loss is not None and loss.config.normalize and losses.chamfer > SMALLEST:
            return weight * losses.physics / losses.chamfer
        return weight

    def _physics_weight(self) -> float:
        literal = self._weight_mode == "literal"
        return self._weights.physics if literal else 1.0

    def _decay(self, pass_index: int) -> float:
        chain = self._weight_mode == "chain" and pass_index > 0
        return self._weights.physics if chain else 1.0

    def _objective(self, losses: Losses, chamfer_weight: float) -> float:
        return self._physics_weight() * losses.physics + chamfer_weight * losses.chamfer

    def _seed_gradient(self, chamfer_weight: float) -> None:
        """Put the gradient of the objective by the last layer into the adjoint state."""
        x, bar = self._simulation.last.x, self._simulation.bar
        bar.clear()
        self._grid_loss.gradient(x, bar.x, self._physics_weight())
        if chamfer_weight and self._chamfer_loss is not None:
            self._chamfer_loss.add_gradient(x, bar.x, chamfer_weight, self._weights.reverse)

    def _physics_norms(self, group: list[int]) -> list[float]:
        """Norms of the physics gradient alone; leaves that gradient in the adjoint state."""
        self._seed_gradient(0.0)
        self._simulation.backward(group[0])
        return self._norms(group)

    def _norms(self, group: list[int]) -> list[float]:
        transitions = self._simulation.transitions
        return [max(self._norm(transitions[layer].U_bar), SMALLEST) for layer in group]
