"""Subjects that are computed on the spot, without the engine: the 2D experiment and the theory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from chamfer_morph.reproduction.planar_section import planar_section
from chamfer_morph.reproduction.propositions_section import propositions_section
from chamfer_morph.reproduction.section import Section


@dataclass(frozen=True)
class Study:
    """A subject that makes its own section.

    Attributes:
        name: What `morph reproduce` calls it.
        title: Heading in the report.
        origin: Where it stands in the paper.
        cpu_seconds: What it costs about [CPU s].
        make: Computes it, given name, title, origin and the folder of figures.
        in_all: Whether it is a part of `morph reproduce all`.
    """

    name: str
    title: str
    origin: str
    cpu_seconds: float
    make: Callable[[str, str, str, Path], Section]
    in_all: bool = True

    def section(self, figures: Path) -> Section:
        """Compute it, and draw its figures into a folder.

        Raises:
            OSError: The folder cannot be written.
        """
        return self.make(self.name, self.title, self.origin, figures)

    def quick(self) -> Study:
        """The same: it takes no more than a minute."""
        return self


STUDIES = {
    study.name: study
    for study in (
        Study("planar", "Circle to star in 2D", "Table 9", 60.0, planar_section),
        Study("propositions", "The propositions", "Appendix", 10.0, propositions_section),
    )
}
"""All studies by name, in the order of the report."""
