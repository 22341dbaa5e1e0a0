"""Tables, findings and the report, made from given numbers."""

import csv
import io
import re
from collections import Counter
from datetime import datetime, timezone
from itertools import product

import pytest
from scipy.stats import binom

from chamfer_morph.reproduction.experiments.paper_tables import (
    ABLATION,
    PAIR_SEEDS,
    PAIRS,
    PAPER_TABLES,
    REPULSION,
    SCATTER,
    SHAPES_TABLE,
    SPHERE,
)
from chamfer_morph.reproduction.published.numbers import PAPER
from chamfer_morph.reproduction.report.findings import findings
from chamfer_morph.reproduction.report.paired import (
    median_interval,
    paired_difference,
    share_interval,
)
from chamfer_morph.reproduction.report.section import display_table
from chamfer_morph.reproduction.report.sources import sources, summary
from chamfer_morph.reproduction.report.tables import (
    coincidence_floor,
    format_difference,
    tabulate,
)
from chamfer_morph.reproduction.report.writer import write
from chamfer_morph.reproduction.runs.store import Record, Store
from morph_engine.results.provenance import Provenance


def as_printed(experiment):
    """Records in which every row has just its printed numbers, and 0.5 for the others."""
    records = {}
    for row in experiment.rows:
        numbers = PAPER.get(experiment.name, {}).get(row.label, {})
        metrics = {name: numbers.get(name, 0.5) for name in experiment.metrics}
        for run in row.runs:
            records[run.id] = record(run, **metrics)
    return records


def record(run, provenance=None, **metrics):
    """A finished run."""
    return Record(
        run=run, digest=f"digest-of-{run.id}", status="complete", metrics=metrics, frames=40,
        provenance=provenance or Provenance(), software={"chamfer-morph": "9.1"},
    )  # fmt: skip


def computed(code, day):
    """What a record says of a run that some code computed on a day of November."""
    return Provenance(
        code=code * 64, commit=f"{'c' * 40}-dirty", device="cpu", cpu="EPYC", threads=2,
        date=datetime(2026, 11, day, tzinfo=timezone.utc), wall_seconds=20, cpu_seconds=34,
    )  # fmt: skip


def test_a_cell_has_printed_program_ours_and_difference():
    """The first row of the Sphere table, with what is known of it."""
    records = as_printed(SPHERE)
    first = SPHERE.rows[0].runs[0]
    records[first.id] = record(first, **{**records[first.id].metrics, "two_sided": 0.244})
    cell = tabulate(SPHERE, records).cell("Bunny, physics", "two_sided")
    assert (cell.printed, cell.program, cell.ours) == (0.251, 0.2438, 0.244)
    assert cell.minus_printed == pytest.approx(-0.007)
    assert cell.minus_program == pytest.approx(0.0002)


def test_the_best_of_a_group_is_marked_by_the_direction_of_its_metric():
    """Distances want to be small, F1 wants to be large; each target is a group of its own."""
    table = tabulate(SPHERE, as_printed(SPHERE))
    for target in ("Bunny", "Duck", "Cow", "Teapot"):
        for metric in ("s2t", "two_sided", "hausdorff", "f1"):
            assert table.cell(f"{target}, joint", metric).is_best
    assert table.cell("Duck, physics", "t2s").is_best


def test_repeats_are_averaged_with_their_spread():
    """Mean and standard deviation over seeds; without one of them there is no number."""
    records = as_printed(ABLATION)
    row = ABLATION.rows[0]
    for run, value in zip(row.runs, (0.20, 0.21, 0.22), strict=True):
        records[run.id] = record(run, **{**records[run.id].metrics, "two_sided": value})
    cell = tabulate(ABLATION, records).cell(row.label, "two_sided")
    assert cell.ours == pytest.approx(0.21) and cell.deviation == pytest.approx(0.01)
    del records[row.runs[2].id]
    table = tabulate(ABLATION, records)
    assert table.ours(row.label, "two_sided") is None and not table.is_complete


def test_a_ratio_is_taken_to_the_row_that_it_is_over():
    """Table 2 prints DCO over physics on the Duck as 3.0; the row of physics itself has none."""
    table = tabulate(SHAPES_TABLE, as_printed(SHAPES_TABLE))
    cell = table.cell("Duck, DCO", "ratio")
    assert cell.printed == 3.0
    assert cell.ours == pytest.approx(0.744 / 0.247)
    assert table.ours("Duck, Physics", "ratio") is None
    for label, numbers in PAPER["shapes"].items():
        if "ratio" in numbers:
            assert table.ours(label, "ratio") == pytest.approx(numbers["ratio"], abs=0.05)


def test_the_scatter_has_the_printed_pairs():
    """Figure 7 is table 5, drawn: every point has its printed one beside it."""
    table = tabulate(SCATTER, as_printed(PAIRS))
    assert all(line.cells["two_sided"].printed is not None for line in table.lines)


def seeded(method, values):
    """Records of Sphere → Bunny by seed with these two-sided distances."""
    row = next(row for row in PAIR_SEEDS.rows if row.label == f"Sphere → Bunny, {method}")
    return {
        run.id: record(run, two_sided=value) for run, value in zip(row.runs, values, strict=False)
    }


def test_differences_are_paired_by_seed():
    """What both runs of a seed share cancels; Student's interval of three is 4.303 s / √3 wide."""
    records = seeded("physics", (0.2, 0.3, 0.4)) | seeded("joint", (0.19, 0.28, 0.37))
    table = tabulate(PAIR_SEEDS, records)
    labels = "Sphere → Bunny, joint", "Sphere → Bunny, physics"
    found = paired_difference(table, *labels, "two_sided")
    assert (found.mean, found.count) == (pytest.approx(-0.02), 3)
    assert found.half_width == pytest.approx(4.3027 * 0.01 / 3**0.5, rel=1e-4)
    assert not found.excludes_zero
    assert "Of 20 pairs 1 have been run" in " ".join(findings(table))


def test_what_has_not_been_run_says_so():
    """A row with one seed of three has no number of its own, and tells how many are lacking."""
    records = seeded("physics", (0.2,))
    table = tabulate(PAIR_SEEDS, records)
    remarks = {name: remark for name, remark, _ in table.display_rows}
    assert remarks["Sphere → Bunny, physics"] == "Not run yet: 2 of 3 seeds."
    assert remarks["Sphere → Bunny, joint"] == "Not run yet."
    assert (
        paired_difference(table, "Sphere → Bunny, joint", "Sphere → Bunny, physics", "s2t") is None
    )


def test_interval_of_a_share():
    """Wilson's, by its own equation: the ends are where the share is z deviations away."""
    for wins in (0, 14, 18, 20):
        for end in share_interval(wins, 20):
            deviation = (end * (1 - end) / 20) ** 0.5
            assert abs(wins / 20 - end) == pytest.approx(1.959964 * deviation, abs=1e-6)


@pytest.mark.parametrize("count", [6, 9, 25, 40])
def test_the_interval_of_a_median_holds_it_in_19_of_20_draws(count):
    """It is the narrowest one between two of the values that does."""
    low, high = median_interval(list(range(count))[::-1])
    assert low + high == count - 1
    within = 1 - 2 * binom.cdf(low, count, 0.5)
    narrower = 1 - 2 * binom.cdf(low + 1, count, 0.5)
    assert within >= 0.95 > narrower


def test_least_coincidence():
    """The least over all ways to put particles onto points, which are tried one by one."""
    for particles, points in product(range(1, 7), range(1, 5)):
        least = min(
            sum(count for count in Counter(places).values() if count > 1)
            for places in product(range(points), repeat=particles)
        )
        assert coincidence_floor(particles, points) == pytest.approx(least / particles)
    run = REPULSION.rows[0].runs[0]
    made = record(run, overlap_01=0.5).model_copy(update={"particle_count": 5, "target_count": 4})
    cell = tabulate(REPULSION, {run.id: made}).cell("DCO at rest", "overlap_floor")
    assert cell.ours == pytest.approx(0.4) and not cell.is_best


def test_findings_on_the_printed_numbers_are_the_papers():
    """16 of 20 pairs, and those four are not among them."""
    sentences = " ".join(findings(tabulate(PAIRS, as_printed(PAIRS))))
    assert "better than physics on 16 of 20 pairs; the paper: 16" in sentences
    assert "s→t better on 20 of 20; the paper: 20" in sentences
    assert "not better on Duck → Sphere, Duck → Cow, Cow → Sphere, Teapot → Cow" in sentences


def test_findings_follow_our_numbers():
    """Other numbers, another sentence."""
    records = as_printed(SPHERE)
    run = SPHERE.rows[1].runs[0]
    records[run.id] = record(run, **{**records[run.id].metrics, "two_sided": 9.0})
    sentences = findings(tabulate(SPHERE, records))
    assert "two-sided distance on 3 of 4" in sentences[0]


@pytest.mark.parametrize("experiment", PAPER_TABLES.values(), ids=PAPER_TABLES)
def test_a_failed_run_is_shown_with_its_cause_and_the_rest_stands(experiment):
    """No finding falls over a missing number, and it says what is missing."""
    records = as_printed(experiment)
    row = experiment.rows[-1]
    failed = row.runs[0]
    records[failed.id] = Record(run=failed, digest="", status="failed", problem="It burst.")
    table = tabulate(experiment, records)
    _, remark, cells = display_table(table.display_rows).rows[-1]
    assert remark == "It burst." and "failed" in {cell.text for cell in cells}
    assert row.label in findings(table)[-1]
    findings(tabulate(experiment, {}))


def test_csv_has_every_number_with_its_origin():
    """A line a number, traceable to runs and digests."""
    text = tabulate(SPHERE, as_printed(SPHERE)).csv()
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == len(SPHERE.rows) * len(SPHERE.metrics)
    line = next(r for r in rows if (r["row"], r["metric"]) == ("Bunny, joint", "two_sided"))
    assert (line["printed"], line["published_program"], line["ours"]) == (
        "0.226",
        "0.2117",
        "0.226",
    )
    assert line["run_ids"] == "sphere-bunny-joint"
    assert line["config_digests"] == "digest-of-sphere-bunny-joint"
    assert (line["code_digests"], line["version"]) == ("", "9.1")


def test_a_table_says_in_one_line_which_code_computed_it_and_when():
    """Versions, digests and dates of its runs, and which of them are older than provenance."""
    a, b, c = SPHERE.runs[:3]
    runs = [record(a, computed("a", 3)), record(b, computed("b", 4)), record(c), record(c)]
    assert summary(sources(runs)) == (
        f"2 runs by version 9.1, code {'a' * 12}, {'b' * 12}, 2026-11-03 to 2026-11-04; "
        "1 run by version 9.1, before provenance."
    )
    assert summary(sources(runs[:1])) == f"1 run by version 9.1, code {'a' * 12}, 2026-11-03."
    assert summary(()) == ""


def test_the_report_ends_with_a_list_of_all_runs(tmp_path):
    """Each once, with the tables that it serves, its code, machine, times and date."""
    records = as_printed(SCATTER) | as_printed(SPHERE)
    run = SPHERE.runs[0]
    records[run.id] = record(run, computed("a", 3), **records[run.id].metrics)
    html = write((SPHERE, SCATTER), records, Store(tmp_path)).report.read_text(encoding="utf-8")
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    listed = text.partition("## Where the numbers come from")[2].strip().splitlines()[2:]
    assert len(listed) == len({run.id for run in (*SPHERE.runs, *SCATTER.runs)})
    row = next(line for line in listed if line.startswith(f"| {run.id} |"))
    words = ("a" * 12, f"{'c' * 12}-dirty", "cpu: EPYC, 2 threads", "34 s, 20 s", "2026-11-03",
             "sphere, scatter")  # fmt: skip
    for word in words:
        assert f"| {word} |" in row
        assert f"<td>{word}</td>" in html
    for page in (text, html):
        assert f"code {'a' * 12}, 2026-11-03; 7 runs by version 9.1, before provenance." in page


def test_the_report_has_every_table_and_asks_the_network_for_nothing(tmp_path):
    """All headings, all row names, findings; no address, script or style sheet from elsewhere."""
    records = {}
    for experiment in PAPER_TABLES.values():
        records |= as_printed(experiment)
    output = write(tuple(PAPER_TABLES.values()), records, Store(tmp_path))
    html = output.report.read_text(encoding="utf-8")
    for experiment in PAPER_TABLES.values():
        assert f'<section id="{experiment.name}">' in html and f'href="#{experiment.name}"' in html
        assert (tmp_path / "tables" / f"{experiment.name}.csv").exists()
    assert "Sphere → Bunny, joint" in html and "digest-of-sp" in html
    assert "prefers-color-scheme: dark" in html and 'name="viewport"' in html
    without_images = re.sub(r"data:image/png;base64,[^\"]+", "", html)
    for foreign in ("http:", "https:", "//", "<script", "<link", "@import", "url("):
        assert foreign not in without_images
    assert "figure is missing" in html  # there are no frames in this store
    assert (tmp_path / "figures" / "scatter-pairs.svg").exists()


def test_the_report_in_markdown_has_every_number_and_its_figures_beside_it(tmp_path):
    """As many cells in each row as the head has, every number of a grid, no figure astray."""
    write((SPHERE, SCATTER), as_printed(SCATTER) | as_printed(SPHERE), Store(tmp_path))
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    table = [line for line in text.splitlines() if line.startswith("| ")]
    assert len({line.count("|") for line in table[: 2 + len(SPHERE.rows)]}) == 1
    shown = display_table(tabulate(SPHERE, as_printed(SPHERE)).display_rows)
    for name, _, entries in shown.rows:
        row = next(line for line in table if line.startswith(f"| {name} |"))
        cells = [cell.strip(" *") for cell in row.strip("|").split("|")]
        assert cells == [name, *(entry.text for entry in entries)]
    figures = re.findall(r"\]\((figures/[^)]+)\)", text)
    assert figures and all((tmp_path / path).is_file() for path in figures)


def test_differences_have_their_sign_and_no_negative_zero():
    """As a reader expects them."""
    assert [format_difference(x) for x in (0.0123, -0.0123, -0.0001, None)] == [
        "+0.012", "−0.012", "0.000", "",
    ]  # fmt: skip
