"""No cell of a table is a formula."""

from __future__ import annotations

import csv
import io

from chamfer_morph.server.http.csv_table import csv_table


def test_texts_that_begin_like_formulas() -> None:
    """They get an apostrophe; numbers stay numbers."""
    cells = ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "bunny", -1.5, ""]
    names, row = csv.reader(io.StringIO(csv_table(["=name", *"abcdefg"], [cells])))
    assert names[0] == "'=name"
    assert row == ["'=1+1", "'+1", "'-1", "'@SUM(A1)", "'\t=1", "bunny", "-1.5", ""]
