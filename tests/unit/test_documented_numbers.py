"""Measured numbers in the documentation stand in the tables of our runs that lie beside it."""

import csv
import json
import re
from collections import defaultdict
from pathlib import Path

import pytest

from chamfer_morph.reproduction.experiments.experiment import Experiment
from chamfer_morph.reproduction.registry import select

DOCS = Path(__file__).resolve().parents[2] / "docs"
CLAIMS = ("reproduction.md", "## The paper says, we find")
COSTS = ("reproduction.md", "## What it costs")
SPEEDS = ("presets.md", "## What the text's parameters do")
DEFAULTS = ("presets.md", "## Why `fast` is what it is for `joint`")
MEASURED = (
    CLAIMS,
    ("findings.md", "## What we found"),
    ("transport.md", "## Measured"),
    SPEEDS,
    DEFAULTS,
)
"""Documents, and the heading of a part in which every number is a measurement."""

OF_RUNS = ("8.2", "8.3", "8.4", "8.5", "8.6", "9.2")
"""Sections of the algorithm in which every number is of a run, or of the published program."""

CONSTANTS = {"0.999"}
"""Numbers there that are settings."""

COLUMNS = (
    "printed", "published_program", "ours", "standard_deviation", "minus_printed", "minus_program",
)  # fmt: skip
COUNT = re.compile(r"\b\d+ of \d+\b")
NUMBER = re.compile(r"(?<![\w.,/-])\d*\.\d{3,4}(?![\w.])")


def rows():
    """The numbers of each row of the committed tables."""
    found = defaultdict(list)
    for path in DOCS.glob("results/tables/*.csv"):
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                found[path.stem, row.get("row")] += [
                    abs(float(row[name])) for name in COLUMNS if row.get(name)
                ]
    return list(found.values())


def sentences():
    """The numbers of the reports outside their tables: what was found over many rows."""
    lines = [
        line
        for path in DOCS.glob("results/*.md")
        for line in path.read_text(encoding="utf-8").splitlines()
    ]
    return numbers("\n".join(line for line in lines if line[:1] != "|"))


def part(name, heading):
    """The measurements of a document: from their heading to the next one of its level."""
    text = (DOCS / name).read_text(encoding="utf-8").split(heading)[1]
    return re.split(r"^## ", text, flags=re.MULTILINE)[0]


def table_lines(text):
    """The cells of each line of the tables in a text, their heads left out."""
    tables = re.findall(r"^\|.*\n\|[-| ]+\n((?:\|.*\n)+)", text, flags=re.MULTILINE)
    return [
        [cell.strip(" *") for cell in line.strip("|").split("|")]
        for lines in tables
        for line in lines.splitlines()
    ]


def numbers(text):
    """Those with three digits or four behind the point, as they stand there."""
    return NUMBER.findall(text)


def is_among(number, values):
    """Whether a number is one of these, to the digits that are shown."""
    half_a_digit = 0.501 * 10.0 ** -len(number.split(".")[1])
    return any(abs(float(value) - float(number)) <= half_a_digit for value in values)


@pytest.mark.parametrize("place", MEASURED, ids=" ".join)
def test_every_measurement_is_in_a_table(place):
    """What stands together, in a row or in a cell of one, is of one row of our tables.

    A number that stands alone is told by a sentence of the report, or in a table.
    """
    known, told = rows(), sentences()
    every = [value for values in known for value in values] + told
    measured = part(*place)
    assert len(numbers(measured)) >= 10

    def is_of_one_row(shown):
        return any(all(is_among(number, values) for number in shown) for values in known)

    for line in measured.splitlines():
        if line[:1] != "|":
            for number in numbers(line):
                assert is_among(number, every), (number, line)
        elif not is_of_one_row(numbers(line)):
            for cell in line.split("|"):
                shown = numbers(cell)
                is_told = all(is_among(number, told) for number in shown)
                assert is_told or (len(shown) > 1 and is_of_one_row(shown)), (cell, line)


def test_every_count_of_the_claims_is_told_by_a_report():
    """What holds on so many of so many is counted by the program, not by hand."""
    told = set(COUNT.findall("\n".join(p.read_text("utf-8") for p in DOCS.glob("results/*.md"))))
    counts = COUNT.findall(re.sub(r'"[^"]*"', "", part(*CLAIMS)))
    assert len(counts) > 10
    assert set(counts) <= told


def test_every_claim_has_its_place_and_a_verdict():
    """At least 25 sentences of the paper, each with one of five verdicts."""
    claims = [line.split(" | ") for line in part(*CLAIMS).splitlines()[4:] if line]
    claims = [claim for claim in claims if claim[0].startswith("|")]
    assert len(claims) >= 25
    for number, claim in enumerate(claims, 1):
        assert claim[0] == f"| {number}"
        assert len(claim) == 7 and claim[1] and claim[2]
        assert claim[3] in ("holds", "holds weakly", "fails", "not testable", "open there")


def records():
    """The committed records by the ids of their runs."""
    paths = DOCS.glob("results/runs/*.json")
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in paths}


def test_costs_of_the_reproduction_are_those_of_the_records():
    """Runs, CPU hours and mean seconds by method, of all that `morph reproduce all` computes."""
    runs = {
        run.id: run
        for experiment in select(["all"])
        if isinstance(experiment, Experiment)
        for run in experiment.runs
    }
    known, seconds = records(), defaultdict(list)
    for name, run in runs.items():
        record = known[name]
        kind = run.method if run.method in ("joint", "physics") else "points"
        seconds[kind].append(record.get("cpu_seconds") or record["provenance"]["cpu_seconds"])
    lines = table_lines(part(*COSTS))
    for kind, (_, *shown, _) in zip(("joint", "physics", "points"), lines, strict=True):
        total, count = sum(seconds[kind]), len(seconds[kind])
        assert shown == [f"{count}", f"{total / 3600:.1f}", f"{total / count:.0f}"], kind
    total = sum(map(sum, seconds.values()))
    assert f"the {len(runs)} runs of `all` add up to {total / 3600:.1f} hours" in part(*COSTS)


def numbers_of_runs():
    """The numbers of each run: of its record, in all frames, and what tables print beside them."""
    found = defaultdict(list)
    for name, record in records().items():
        curves = (value for curve in record["curves"].values() for value in curve)
        values = (*record["metrics"].values(), *curves)
        found[name] += [abs(value) for value in values if value is not None]
    for path in DOCS.glob("results/tables/*.csv"):
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                if row.get("run_ids") in found:
                    found[row["run_ids"]] += [abs(float(row[c])) for c in COLUMNS if row.get(c)]
    with (DOCS.parent / "reproduction/published/program.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            name = row.pop("run")
            found[f"{name}, published program"] = [float(value) for value in row.values() if value]
    return list(found.values())


def section_of_algorithm(number):
    """The text under a heading of the algorithm."""
    text = (DOCS / "algorithm.md").read_text(encoding="utf-8").split(f"\n### {number} ")[1]
    return re.split(r"^##+ ", text, flags=re.MULTILINE)[0]


@pytest.mark.parametrize("section", OF_RUNS)
def test_every_measurement_of_the_algorithm_is_of_a_run(section):
    """What stands in a row of a table is of one run."""
    known = numbers_of_runs()
    every = [value for values in known for value in values]
    measured = [line for line in section_of_algorithm(section).splitlines() if numbers(line)]
    assert measured
    for line in measured:
        shown = [number for number in numbers(line) if number not in CONSTANTS]
        if line[:1] == "|":
            is_of_one = any(all(is_among(each, values) for each in shown) for values in known)
            assert is_of_one, line
        for number in shown:
            assert is_among(number, every), (number, line)


def test_frames_of_the_algorithm_are_those_of_the_run():
    """Of sphere to bunny by physics, to the digits that are shown."""
    curves = records()["sphere-bunny-physics"]["curves"]
    columns = ("loss_physics", "s2t", "t2s", "two_sided", "hausdorff", "f1")
    lines = re.findall(r"^\| (\d+) \|(.*)\|$", section_of_algorithm("13.4"), flags=re.MULTILINE)
    assert len(lines) == 11
    for frame, line in lines:
        shown = [cell.strip() for cell in line.split("|")]
        for name, number in zip(columns, shown, strict=True):
            assert is_among(number, [curves[name][int(frame)]]), (frame, name, number)


def test_every_benchmark_that_is_told_is_a_stored_document():
    """Row by row: ours, the peer and the score, to the digits that are shown."""
    folder = DOCS.parent / "benchmarks"
    seen = (folder / "README.md").read_text(encoding="utf-8").split("## Seen")[1].split("\n## ")[0]
    documents = [json.loads(p.read_text(encoding="utf-8")) for p in folder.glob("results/*.json")]
    assert documents and all(each["commit"] and each["date"] for each in documents)
    stored = {row["what"]: row for document in documents for row in document["rows"]}
    lines = [line.strip("| ").split(" | ") for line in seen.splitlines() if line[:1] == "|"][2:]
    assert lines
    for what, *shown in lines:
        row = stored[what]
        for text, value in zip(shown, (row["ours"], row["peer"], row["score"]), strict=True):
            digits = len(text.partition(".")[2])
            assert f"{value:.{digits}f}" == text, what


def test_speeds_of_the_first_frames_are_those_of_the_runs():
    """Three a row, in the order of the table of runs."""
    with (DOCS / "results/tables/speeds.csv").open(encoding="utf-8", newline="") as file:
        speeds = [float(row["ours"]) for row in csv.DictReader(file)]
    shown = [cells[1] for cells in table_lines(part(*SPEEDS))]
    assert ", ".join(shown) == ", ".join(f"{speed:.1f}" for speed in speeds)


def test_cpu_seconds_of_the_presets_are_those_of_the_runs():
    """In the same row as its distance."""
    known = rows()
    lines = table_lines(part(*DEFAULTS))
    assert len(lines) == 17
    for cells in lines:
        shown = numbers(" ".join(cells))
        assert any(
            all(is_among(number, values) for number in shown)
            and any(f"{value:.0f}" == cells[-1] for value in values)
            for values in known
        ), cells
