"""Propositions 1 to 3 and Corollary 1 of the paper as executable checks (its appendix on theory).

Each check measures what the statement says on a small scene with exact gradients, and shows where
it ends by numbers that break its prediction (`Limit`). The three propositions are identities and
hold. The corollary is refuted as written, by cases inside its assumptions. What does not follow is
that a run must collapse: cells change, collapsed points separate, lists cross clusters, Adam
rescales, and a penalty that leaves a centroid alone still keeps points apart.
"""

from chamfer_morph.reproduction.propositions.check import Check, Quantity
from chamfer_morph.reproduction.propositions.collapse import proposition_1
from chamfer_morph.reproduction.propositions.coupling import corollary_1
from chamfer_morph.reproduction.propositions.drift import proposition_3
from chamfer_morph.reproduction.propositions.figure import figure
from chamfer_morph.reproduction.propositions.separation import proposition_2

__all__ = ["Check", "Quantity", "all_checks", "figure"]


def all_checks() -> tuple[Check, ...]:
    """The four statements in the paper's order; a few seconds."""
    return proposition_1(), proposition_2(), proposition_3(), corollary_1()
