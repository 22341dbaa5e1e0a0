"""Everything that can be reproduced, in the order of the report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from chamfer_morph.reproduction.beyond import BEYOND
from chamfer_morph.reproduction.experiment import Experiment, distinct
from chamfer_morph.reproduction.experiments import EXPERIMENTS
from chamfer_morph.reproduction.run import Run
from chamfer_morph.reproduction.studies import STUDIES, Study
from morph_engine.errors import unknown_name

Subject = Experiment | Study

ALL = "all"

SUBJECTS: dict[str, Subject] = {**EXPERIMENTS, **BEYOND, **STUDIES}


def choose(names: Sequence[str], *, quick: bool = False) -> tuple[Subject, ...]:
    """The subjects of some names, each once, in the order of the report.

    Args:
        names: Names, or "all".
        quick: With the preset `fast`.

    Raises:
        ConfigError: There is nothing of a name.
    """
    for name in names:
        if name not in (*SUBJECTS, ALL):
            raise unknown_name("table", name, (*SUBJECTS, ALL))
    chosen = [
        subject
        for name, subject in SUBJECTS.items()
        if name in names or (ALL in names and subject.in_all)
    ]
    return tuple(subject.quick() if quick else subject for subject in chosen)


def runs_of(subjects: Iterable[Subject]) -> tuple[Run, ...]:
    """All runs that subjects need, each once."""
    return distinct(
        run for subject in subjects if isinstance(subject, Experiment) for run in subject.runs
    )


def cpu_seconds_of(subjects: Iterable[Subject]) -> float:
    """What subjects cost about [CPU s], if nothing is in the store."""
    chosen = tuple(subjects)
    studies = sum(subject.cpu_seconds for subject in chosen if isinstance(subject, Study))
    return studies + sum(run.expected_cpu_seconds for run in runs_of(chosen))
