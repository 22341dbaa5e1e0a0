"""The alerts and the dashboard ask for what the service tells."""

from __future__ import annotations

import itertools
import json
import re
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml

from chamfer_morph.schemas import Problem
from chamfer_morph.server.routes.health import Metrics

FOLDER = Path(__file__).resolve().parents[2] / "docker" / "monitoring"


def alerts() -> dict[str, str]:
    """Expressions by the names of their alerts."""
    groups = yaml.safe_load((FOLDER / "alerts.yaml").read_text(encoding="utf-8"))["groups"]
    return {rule["alert"]: rule["expr"] for group in groups for rule in group["rules"]}


def panels() -> dict[str, Any]:
    """Targets of the dashboard, by the place of their panel."""
    board = json.loads((FOLDER / "dashboard.json").read_text(encoding="utf-8"))
    return {
        f"{panel['id']} {panel['title']} {target['refId']}": target["expr"]
        for panel in board["panels"]
        for target in panel["targets"]
    }


@pytest.fixture(scope="module")
def labels() -> dict[str, set[str]]:
    """Names of the samples that the service tells, with the names of their labels."""
    metrics = Metrics()
    metrics.requests.labels("livez", "200").inc()
    metrics.seconds.labels("livez").observe(1)
    metrics.jobs.labels("queued").set(1)
    metrics.failures.labels("crash").inc()
    metrics.workers.labels("busy").set(1)
    samples = (sample for metric in metrics.registry.collect() for sample in metric.samples)
    return {sample.name: set(sample.labels) for sample in samples}


@pytest.mark.parametrize("expression", [*alerts().values(), *panels().values()])
def test_expressions(expression: str, labels: dict[str, set[str]]) -> None:
    """Every metric and every label in them is there."""
    found = re.findall(r"(morph_\w+)(?:\{([^}]*)\})?", expression)
    assert found or "up{" in expression
    for name, selectors in found:
        assert name in labels
        for label in re.findall(r"(\w+)\s*(?:=|!=|=~)", selectors):
            assert label in labels[name]
    for grouping in re.findall(r"by \(([^)]*)\)", expression):
        wanted = set(re.split(r", *", grouping))
        assert any(wanted <= labels[name] for name, _ in found)


SHARED = ("morph_job_failures_total", "morph_adoptions_total")
"""Counters that every API process tells of the whole service."""


@pytest.mark.parametrize("expression", [*alerts().values(), *panels().values()])
def test_a_failure_is_counted_once(expression: str) -> None:
    """Each API process counts every failure, so that a sum over them would be too much."""
    for name in SHARED:
        if name in expression:
            assert re.search(rf"max(?: by \(kind\) )?\((?:increase|rate)\({name}", expression)


def test_panels_do_not_overlap() -> None:
    """Each place of the grid of 24 columns belongs to one panel at most."""
    board = json.loads((FOLDER / "dashboard.json").read_text(encoding="utf-8"))
    taken: set[tuple[int, int]] = set()
    for panel in board["panels"]:
        at = panel["gridPos"]
        columns = range(at["x"], at["x"] + at["w"])
        rows = range(at["y"], at["y"] + at["h"])
        cells = set(itertools.product(columns, rows))
        assert not cells & taken and max(columns) < 24
        taken |= cells


def test_every_failure_that_is_not_the_users_raises_an_alert() -> None:
    """Users see to their input, their settings and their time limits."""
    kinds = set(get_args(Problem.model_fields["kind"].annotation))
    (listed,) = re.findall(r'kind=~"([^"]*)"', alerts()["MorphEnginesBreakOff"])
    assert set(listed.split("|")) == kinds - {"input", "simulation", "timeout"}
