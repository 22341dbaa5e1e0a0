"""Who has changed what: a line for each request that may change something."""

from __future__ import annotations

import json
import logging
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.integration.api.conftest import MORPH, Api
from tests.integration.api.contract import OPERATIONS
from tests.integration.api.test_api_contract import SAMPLES
from tests.patience import PATIENCE

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
    """Reading is not; what is done without keys is, and a refusal; no line has a secret."""
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
        ("makeKey", "", 201), ("submitJob", "root", 202), ("cancelJob", "root", 202),
        ("deleteJob", "", 401),
    ]  # fmt: skip
    assert [line["job"] for line in lines()] == ["", job, job, "no-such-job"]
    last = lines()[-1]
    assert last["request"] == refused.headers["X-Request-ID"]
    assert last["path"] == ADDRESS and last["method"] == "DELETE" and last["seconds"] >= 0
    assert lines()[2]["request"] == "click-7"
    assert (lines()[0]["new_key"], lines()[0]["scopes"]) == ("root", ["admin"])
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
    assert [len(json.dumps(line)) < 600 for line in lines()] == [True, True]


@pytest.mark.parametrize(
    ("method", "path", "name"),
    [
        (method, path, operation["operationId"])
        for method, path, operation in OPERATIONS
        if method != "get"
    ],
)
def test_every_operation_that_changes_something_is_logged(
    api: Api, lines: Callable[[], list[dict[str, Any]]], method: str, path: str, name: str
) -> None:
    """Once, with its name and the status of its answer, also without keys."""
    answer = api.http.request(method, re.sub(r"{(\w+)}", lambda part: SAMPLES[part[1]], path))
    (line,) = lines()
    assert (line["operation"], line["status"]) == (name, answer.status_code)
    assert line["request"] == answer.headers["X-Request-ID"]


def test_commands_that_change_keys_are_logged(tmp_path: Path) -> None:
    """Who makes and revokes keys on the machine leaves a line, without the secret; a look none."""

    def keys(*arguments: str) -> tuple[str, list[str]]:
        command = [sys.executable, "-m", "chamfer_morph.server", "keys", *arguments]
        own = {name: value for name, value in os.environ.items() if name[:6] != "MORPH_"}
        ran = subprocess.run(
            command, env=own | {"MORPH_DATA_DIR": str(tmp_path)}, timeout=PATIENCE,
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        found = [line for line in ran.stderr.splitlines() if "chamfer_morph.audit" in line]
        return ran.stdout.strip(), found

    secret, (added,) = keys("add", "ann")
    assert '"operation": "makeKey", "path": "/v1/keys/ann"' in added and secret not in added
    assert '"scopes": ["read", "submit"]' in added
    assert keys("list")[1] == keys("add", "ann")[1] == keys("remove", "bob")[1] == []
    _, (removed,) = keys("remove", "ann")
    assert '"operation": "revokeKey", "path": "/v1/keys/ann"' in removed
