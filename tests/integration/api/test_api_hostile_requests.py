"""Requests made to cost more than they weigh are refused early and in few words."""

from __future__ import annotations

import tracemalloc

from tests.integration.api.conftest import MORPH, Api

SHORT_ANSWER_BYTES = 10_000


def test_a_sweep_is_counted_before_it_is_made(api: Api) -> None:
    """Lists of 5 kB that make 20 million jobs take no memory; the answer names the number."""
    sweep = {
        "sources": [{"shape": "sphere"}] * 100,
        "targets": [{"shape": "star"}] * 100,
        "methods": ["flow"] * 20,
        "seeds": list(range(100)),
    }
    assert api.http.post("/v1/sweeps", json=sweep | {"methods": []}).status_code == 422  # is warm
    tracemalloc.start()
    try:
        answer = api.http.post("/v1/sweeps", json=sweep)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert answer.status_code == 422 and "20000000 jobs" in answer.json()["detail"]
    assert peak < 5e6


def test_many_faults_are_told_in_few_words(api: Api) -> None:
    """Tens of thousands of unknown fields, settings and long names are not sent back."""
    unknown = {f"x{index}": 0 for index in range(50_000)}
    long = {"y" * 500_000: 0}
    requests = [
        ("/v1/jobs", MORPH | unknown),
        ("/v1/jobs", MORPH | long),
        ("/v1/jobs", MORPH | {"overrides": unknown}),
        ("/v1/jobs", MORPH | {"overrides": long}),
        ("/v1/jobs", MORPH | {"preset": "p" * 500_000}),
        ("/v1/jobs", MORPH | {"method": "m" * 500_000}),
        ("/v1/jobs", MORPH | {"source": {"shape": "s" * 500_000}}),
        ("/v1/sweeps", {"sources": [MORPH["source"]], "targets": [MORPH["target"]]} | unknown),
        ("/v1/keys", {"name": "n" * 500_000} | unknown),
    ]
    for path, body in requests:
        answer = api.http.post(path, json=body)
        assert answer.status_code == 422 and answer.json()["remedy"], path
        assert len(answer.content) < SHORT_ANSWER_BYTES, (path, answer.text[:200])
    assert "50000 errors" in api.http.post("/v1/jobs", json=MORPH | unknown).json()["detail"]
