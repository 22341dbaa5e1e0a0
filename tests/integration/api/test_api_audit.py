"""Who has changed what: a line for each request that may change something."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from typing import Any

import pytest

from tests.integration.api.conftest import MORPH, Api

ADDRESS = "/v1/jobs/no-such-job"


@pytest.fixture
def lines(caplog: pytest.LogCaptureFixture) -> Callable[[], list[dict[str, Any]]]:
    """Returns what has been logged so far."""
    caplog.set_level(logging.INFO, "chamfer_morph.audit")

    def read() -> list[dict[str, Any]]:
        audit = (record for record in caplog.records if record.name == "chamfer_morph.audit")
        return [json.loads(record.getMessage()) for record in audit]

    return read


def test_changes_are_logged_with_key_and_name(
    api: Api, lines: Callable[[], list[dict[str, Any]]]
) -> None:
    """Reading is not, nor what is done without keys; a refusal is; no line has a secret."""
    made = api.http.post("/v1/keys", json={"name": "root", "scopes": ["admin"]})
    secret = {"Authorization": f"Bearer {made.json()['secret']}"}
    job = api.http.post("/v1/jobs?x=secret", json=MORPH, headers=secret).json()["id"]
    assert api.http.get(f"/v1/jobs/{job}", headers=secret).status_code == 200
    cancelled = api.http.post(
        f"/v1/jobs/{job}/cancel", headers=secret | {"X-Request-ID": "click-7"}
    )
    assert cancelled.headers["X-Request-ID"] == "click-7"
    refused = api.http.delete(ADDRESS)
    logged = [(line["operation"], line["key"], line["status"]) for line in lines()]
    assert logged == [
        ("submitJob", "root", 202), ("cancelJob", "root", 202), ("deleteJob", "", 401),
    ]  # fmt: skip
    assert [line["job"] for line in lines()] == [job, job, "no-such-job"]
    last = lines()[-1]
    assert last["request"] == refused.headers["X-Request-ID"]
    assert last["path"] == ADDRESS and last["method"] == "DELETE" and last["seconds"] >= 0
    assert lines()[1]["request"] == "click-7"
    text = json.dumps(lines())
    assert made.json()["secret"] not in text and "secret" not in text


@pytest.mark.parametrize("given", ["two words", "x" * 65, '"}', "a\tb"])
def test_a_name_that_could_break_a_line_is_replaced(api: Api, given: str) -> None:
    """Every request has a name of its own."""
    names = {
        api.http.get("/livez", headers={"X-Request-ID": given}).headers["X-Request-ID"]
        for _ in range(2)
    }
    assert len(names) == 2 and given not in names


def test_long_paths_are_cut(api: Api, lines: Callable[[], list[dict[str, Any]]]) -> None:
    """However long an address is, its line is short."""
    api.http.post("/v1/keys", json={"name": "root", "scopes": ["admin"]})
    assert api.http.delete("/v1/jobs/" + "x" * 5000).status_code == 401
    assert [len(json.dumps(line)) < 600 for line in lines()] == [True]
