"""Everything that can be reproduced by name, in the order of the report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from chamfer_morph.reproduction.experiments.defaults import DEFAULTS
from chamfer_morph.reproduction.experiments.experiment import Experiment, distinct
from chamfer_morph.reproduction.experiments.extensions import EXTENSIONS
from chamfer_morph.reproduction.experiments.paper_tables import PAPER_TABLES
from chamfer_morph.reproduction.report.planar_section import planar_section
from chamfer_morph.reproduction.report.propositions_section import propositions_section
from chamfer_morph.reproduction.report.section import Section
from chamfer_morph.reproduction.runs.run import Run
from morph_engine.errors import unknown_name

ALL = "all"


@dataclass(frozen=True)
class StandaloneExperiment:
    """An experiment without runs of the engine, computed whenever it is asked for.

    Attributes:
        name: What `morph reproduce` calls it.
        title: Heading in the report.
        origin: Where it stands in the paper.
        cpu_seconds: What it costs about [CPU s].
        make_section: Computes it, given name, title, origin and the folder of figures.
        in_all: Whether it is a part of `morph reproduce all`.
    """

    name: str
    title: str
    origin: str
    cpu_seconds: float
    make_section: Callable[[str, str, str, Path], Section]
    in_all: bool = True

    def section(self, figures: Path) -> Section:
        """Compute it, and draw its figures into a folder.

        Raises:
            OSError: The folder cannot be written.
        """
        return self.make_section(self.name, self.title, self.origin, figures)


AnyExperiment = Experiment | StandaloneExperiment

STANDALONE = {
    experiment.name: experiment
    for experiment in (
        StandaloneExperiment(
            "planar", "Circle to star in 2D", "Table 10 and figure 3", 60.0, planar_section
        ),
        StandaloneExperiment(
            "propositions", "The propositions", "Appendix A", 10.0, propositions_section
        ),
    )
}

EXPERIMENTS: dict[str, AnyExperiment] = {**PAPER_TABLES, **EXTENSIONS, **DEFAULTS, **STANDALONE}


def select(names: Sequence[str], *, quick: bool = False) -> tuple[AnyExperiment, ...]:
    """The experiments of some names or "all", each once, in the order of the report.

    Raises:
        ConfigError: There is nothing of a name.
    """
    for name in names:
        if name not in (*EXPERIMENTS, ALL):
            raise unknown_name("table", name, (*EXPERIMENTS, ALL))
    selected = [
        experiment
        for name, experiment in EXPERIMENTS.items()
        if name in names or (ALL in names and experiment.in_all)
    ]
    return tuple(
        each.quick() if quick and isinstance(each, Experiment) else each for each in selected
    )


def runs_of(experiments: Iterable[AnyExperiment]) -> tuple[Run, ...]:
    """All runs that experiments need, each once."""
    return distinct(
        run
        for experiment in experiments
        if isinstance(experiment, Experiment)
        for run in experiment.runs
    )


def cpu_seconds_of(experiments: Sequence[AnyExperiment]) -> float:
    """What experiments cost about [CPU s], if nothing is in the store."""
    standalone = sum(each.cpu_seconds for each in experiments if not isinstance(each, Experiment))
    return standalone + sum(run.expected_cpu_seconds for run in runs_of(experiments))
