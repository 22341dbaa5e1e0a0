"""Image, compose file and Kubernetes manifests start what there is, with known settings."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from chamfer_morph.server.__main__ import _parser as server_parser
from chamfer_morph.worker.__main__ import _parser as worker_parser
from chamfer_morph.worker.settings import GIB, Settings
from tests.web_server import running

ROOT = Path(__file__).resolve().parents[2]
DOCKERFILE = (ROOT / "docker" / "Dockerfile").read_text(encoding="utf-8")
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text("utf-8"))
MANIFESTS: list[dict[str, Any]] = list(
    yaml.safe_load_all((ROOT / "docker" / "kubernetes.yaml").read_text("utf-8"))
)
OWN = {name: each for name, each in COMPOSE["services"].items() if "build" in each}
"""Services of the image."""

WORKLOADS = {
    each["metadata"]["labels"]["app.kubernetes.io/component"]: each
    for each in MANIFESTS
    if each["kind"] in ("Deployment", "StatefulSet")
}


def pod(workload: dict[str, Any]) -> dict[str, Any]:
    """What its pods are."""
    spec: dict[str, Any] = workload["spec"]["template"]["spec"]
    return spec


def container(workload: dict[str, Any]) -> dict[str, Any]:
    """The one container of its pods."""
    (only,) = pod(workload)["containers"]
    assert isinstance(only, dict)
    return only


def commands() -> Iterator[list[str]]:
    """Every command line of the service that the files have."""
    for service in OWN.values():
        yield service["command"]
        yield service.get("healthcheck", {}).get("test", ["CMD"])[1:]
    for workload in WORKLOADS.values():
        yield container(workload)["command"]
        yield container(workload).get("livenessProbe", {}).get("exec", {}).get("command", [])


@pytest.mark.parametrize("command", [each for each in commands() if each], ids=" ".join)
def test_a_command_is_understood(command: list[str]) -> None:
    """One that is renamed would show at the first start only."""
    python, option, module, *arguments = command
    assert (python, option) == ("python", "-m")
    parsers = {"chamfer_morph.server": server_parser, "chamfer_morph.worker": worker_parser}
    parsers[module]().parse_args(arguments)  # exits where it does not understand


def test_every_variable_is_a_setting() -> None:
    """MORPH_* that are none are refused when a process starts; comments count, too."""
    texts = [path.read_text("utf-8") for path in (ROOT / "docker").rglob("*") if path.is_file()]
    names = set(re.findall(r"\bMORPH_[A-Z_]+", "".join(texts)))
    assert len(names) > 5
    assert names <= {f"MORPH_{name.upper()}" for name in Settings.model_fields}


@pytest.mark.parametrize(
    "manifest", MANIFESTS, ids=lambda each: f"{each['kind']} {each['metadata']['name']}"
)
def test_a_manifest_is_what_kubernetes_knows(manifest: dict[str, Any]) -> None:
    """By its own schemas, which allow no field that it would ignore."""
    kubernetes_validate.validate(manifest, kubernetes_validate.latest_version(), strict=True)
    if manifest["kind"] != "Namespace":
        assert manifest["metadata"]["namespace"] == "morph"


@pytest.mark.parametrize("role", [*WORKLOADS])
def test_pods_are_as_restricted_as_their_namespace_wants(role: str) -> None:
    """Kubernetes refuses other pods: https://kubernetes.io/docs/concepts/security/pod-security-standards."""
    (namespace,) = (each for each in MANIFESTS if each["kind"] == "Namespace")
    assert namespace["metadata"]["labels"]["pod-security.kubernetes.io/enforce"] == "restricted"
    spec, only = pod(WORKLOADS[role]), container(WORKLOADS[role])
    assert not {"hostNetwork", "hostPID", "hostIPC"} & {*spec}
    assert spec["securityContext"]["runAsNonRoot"]
    assert spec["securityContext"]["runAsUser"] > 0
    assert spec["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert only["securityContext"]["allowPrivilegeEscalation"] is False
    assert only["securityContext"]["capabilities"] == {"drop": ["ALL"]}
    assert only["securityContext"]["readOnlyRootFilesystem"]
    assert all({*volume} == {"name", "emptyDir"} for volume in spec["volumes"])
    assert {each["name"] for each in only["volumeMounts"]} == {
        each["name"] for each in spec["volumes"]
    }


@pytest.mark.parametrize("role", [*WORKLOADS])
def test_pods_are_selected_and_looked_after(role: str) -> None:
    """By their labels, and by a probe that has time to start Python."""
    workload = WORKLOADS[role]
    labels = workload["spec"]["template"]["metadata"]["labels"]
    assert labels == workload["spec"]["selector"]["matchLabels"] == workload["metadata"]["labels"]
    probe = container(workload)["livenessProbe"]
    assert "httpGet" in probe or probe["timeoutSeconds"] >= 10
    assert pod(workload)["automountServiceAccountToken"] is False
    assert "limits" in container(workload)["resources"]


def test_a_job_fits_its_pod() -> None:
    """With the worker itself and the process that is ready for the next job."""
    (config,) = (each["data"] for each in MANIFESTS if each["kind"] == "ConfigMap")
    limit = container(WORKLOADS["worker"])["resources"]["limits"]["memory"]
    assert limit.endswith("Gi")
    assert int(config["MORPH_JOB_MEMORY_BYTES"]) <= int(limit[:-2]) * GIB - GIB


def test_only_the_api_is_reached() -> None:
    """The policy of all pods lets nobody in, and that of the API opens its port."""
    policies = {
        each["metadata"]["name"]: each["spec"]
        for each in MANIFESTS
        if each["kind"] == "NetworkPolicy"
    }
    everyone = policies["morph"]
    assert {*everyone["policyTypes"]} == {"Ingress", "Egress"} and "ingress" not in everyone
    for role, workload in WORKLOADS.items():
        labels = workload["spec"]["template"]["metadata"]["labels"]
        opened = [
            policy["ingress"]
            for policy in policies.values()
            if "ingress" in policy
            and policy["podSelector"]["matchLabels"].items() <= labels.items()
        ]
        assert opened == ([[{"ports": [{"port": "http"}]}]] if role == "api" else [])
    (port,) = container(WORKLOADS["api"])["ports"]
    assert port == {"name": "http", "containerPort": 8000}


def test_no_secret_is_in_a_file() -> None:
    """Whoever starts it chooses them; without, compose refuses to start."""
    for service in COMPOSE["services"].values():
        for name, value in service.get("environment", {}).items():
            if re.search("PASSWORD|KEY|SECRET", name):
                assert value.startswith("${") and ":?" in value, name
            assert not re.search(r"://\w+:\w", str(value)), name
    kinds = {each["kind"] for each in MANIFESTS}
    assert "Secret" not in kinds


def test_the_key_is_told_to_the_api_alone() -> None:
    """Processes that run engines do not know it."""
    for role, workload in WORKLOADS.items():
        sources = container(workload)["envFrom"]
        secrets = {each["secretRef"]["name"] for each in sources if "secretRef" in each}
        assert secrets == {"morph", *(["morph-api"] if role == "api" else [])}
    for name, service in OWN.items():
        assert ("MORPH_ADMIN_KEY" in service["environment"]) is (name == "api")


def test_the_services_of_compose_fit_together() -> None:
    """Each has a check of its own, and volumes and services that are named are there."""
    assert {*OWN} == {"api", "janitor", "worker"}
    for name, service in OWN.items():
        assert name == "api" or service["healthcheck"]["test"][-1] == name
        assert service["read_only"] and service["cap_drop"] == ["ALL"]
        assert {*service["depends_on"]} <= {*COMPOSE["services"]}
        assert {volume.partition(":")[0] for volume in service["volumes"]} <= {*COMPOSE["volumes"]}


def test_images_of_others_do_not_move() -> None:
    """Whoever starts it names them by their digests; without, it is refused."""
    assert re.findall(r"^ARG BASE(.*)$", DOCKERFILE, re.M) == [""]
    assert {*re.findall(r"^FROM (\S+)", DOCKERFILE, re.M)} == {"$BASE"}
    for service in OWN.values():
        assert service["build"]["args"]["BASE"].startswith("${BASE:?")
    assert COMPOSE["services"]["database"]["image"].startswith("${POSTGRES_IMAGE:?")


def test_the_image_asks_the_port_that_the_service_has() -> None:
    """Its check fails where nobody answers, and passes where somebody does at MORPH_PORT."""
    (found,) = re.findall(r"^HEALTHCHECK .*CMD (\[.*\])$", DOCKERFILE, re.M)
    python, *arguments = json.loads(found)
    assert python == "python"
    with running() as server:

        def check() -> int:
            environment = os.environ | {"MORPH_PORT": str(server.server_port)}
            command = [sys.executable, *arguments]
            return subprocess.run(command, env=environment, capture_output=True).returncode

        assert check() != 0
        server.files["livez"] = b"{}"
        assert check() == 0
