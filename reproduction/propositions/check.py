"""What an executable proposition leaves: numbers beside what they should be, and its limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Relation = Literal["=", "<=", ">="]


@dataclass(frozen=True)
class Quantity:
    """A measured number and what the proposition says about it.

    Attributes:
        name: What was measured.
        measured: The number.
        expected: What it is compared with.
        relation: How.
        tolerance: By how much the relation may be missed, absolutely.
    """

    name: str
    measured: float
    expected: float
    relation: Relation = "="
    tolerance: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether measured and expected stand in the relation."""
        excess = self.measured - self.expected
        below, above = excess <= self.tolerance, excess >= -self.tolerance
        return {"<=": below, ">=": above, "=": below and above}[self.relation]


@dataclass(frozen=True)
class Limit:
    """A case and what the proposition says of it, or would say, were it applied.

    Attributes:
        case: The case in one sentence.
        prediction: What the proposition says, and what is measured.
    """

    case: str
    prediction: Quantity

    @property
    def is_counterexample(self) -> bool:
        """Whether the prediction fails."""
        return not self.prediction.holds


@dataclass(frozen=True)
class Check:
    """A proposition put to the test.

    Attributes:
        name: As in the paper.
        statement: What it says, in one sentence.
        quantities: Identities, and examples of what it says, within its assumptions.
        limits: What is not covered, each shown by a number.
        refuted_by: Cases within its assumptions in which it says what is not so.
    """

    name: str
    statement: str
    quantities: tuple[Quantity, ...]
    limits: tuple[Limit, ...]
    refuted_by: tuple[Limit, ...] = ()

    @property
    def is_refuted(self) -> bool:
        """Whether there is a counterexample within its assumptions."""
        return any(each.is_counterexample for each in self.refuted_by)

    @property
    def holds(self) -> bool:
        """Whether every measurement within the assumptions is as expected."""
        return all(each.holds for each in self.quantities) and not self.is_refuted
