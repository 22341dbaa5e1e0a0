"""How commands end, without starting a process."""

import json

import pytest

from chamfer_morph.cli.exit_status import exit_status
from chamfer_morph.cli.output import print_json
from morph_engine.errors import MeshError


def fails_with(error):
    """A command that raises."""

    def command():
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (MeshError("It is flat.", "Give it a volume."), 2),
        (MemoryError(), 2),
        (RuntimeError("[pool.cpp:62] Virtual memory allocation (235 B) failed."), 2),
        (ZeroDivisionError("division by zero"), 1),
    ],
)
def test_every_exception_becomes_a_status_and_two_lines(error, status, capsys):
    """No exception reaches the user as a traceback, and the two sentences always come."""
    assert exit_status(fails_with(error), as_json=True, debug=False) == status
    captured = capsys.readouterr()
    assert len(captured.err.strip().splitlines()) == 2
    assert "Traceback" not in captured.err
    assert set(json.loads(captured.out)["error"]) == {"cause", "remedy"}


def test_a_fault_names_what_to_report(capsys):
    """An unexpected exception says its type, where it happened, and how to see more."""
    exit_status(fails_with(ZeroDivisionError("by zero")), as_json=False, debug=False)
    said = capsys.readouterr().err
    assert "ZeroDivisionError" in said and "test_cli_exit_status.py" in said and "--debug" in said


def test_debug_lets_the_traceback_through():
    """With --debug the exception itself arrives."""
    with pytest.raises(ZeroDivisionError):
        exit_status(fails_with(ZeroDivisionError()), as_json=False, debug=True)


def test_non_finite_numbers_are_null_in_json(capsys):
    """JSON has no inf or nan."""
    print_json({"hausdorff": float("inf"), "rows": [float("nan"), 1.5]})
    assert json.loads(capsys.readouterr().out) == {"hausdorff": None, "rows": [None, 1.5]}
