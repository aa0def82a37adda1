"""The manifest of a sweep on KubeRay: its schema, its pods, and the version of Ray in it."""

import copy
import json
import re
import shlex
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.contract.repository import ROOT, text_of
from tests.contract.schema_validators import jsonschema, kubernetes_validate
from zensim.deploy.sweep.sweep_plan import make_plan

MANIFEST = ROOT / "deploy" / "kubernetes" / "ray_job.yaml"
SCHEMA = json.loads(text_of(Path(__file__).with_name("ray_job.schema.json")))
KUBERNETES = "1.30"


@cache
def documents() -> dict[str, Any]:
    return {one["kind"]: one for one in map(yaml.safe_load, text_of(MANIFEST).split("\n---\n"))}


def pod_specs(job: dict[str, Any]) -> dict[str, Any]:
    cluster = job["spec"]["rayClusterSpec"]
    groups = [cluster["headGroupSpec"], *cluster["workerGroupSpecs"]]
    names = ["head", *(group["groupName"] for group in groups[1:])]
    return {name: group["template"]["spec"] for name, group in zip(names, groups, strict=True)}


def test_job_fits_the_schema_of_its_definition() -> None:
    jsonschema().validate(documents()["RayJob"], SCHEMA)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("entrypont",), "x"),
        (("backoffLimit",), "3"),
        (("rayClusterSpec", "rayVersion"), 2.6),
        (("rayClusterSpec", "authOptions", "mode"), "none"),
        (("rayClusterSpec", "headGroupSpec", "rayStartParams", "num-cpus"), 0),
    ],
)
def test_schema_refuses_mistakes(path: tuple[str, ...], value: object) -> None:
    job = copy.deepcopy(documents()["RayJob"])
    place = job["spec"]
    for word in path[:-1]:
        place = place[word]
    place[path[-1]] = value

    with pytest.raises(jsonschema().ValidationError):
        jsonschema().validate(job, SCHEMA)


@pytest.mark.parametrize("kind", ["ConfigMap", "PersistentVolumeClaim"])
def test_other_documents_are_valid(kind: str) -> None:
    kubernetes_validate().validate(documents()[kind], KUBERNETES, strict=True)


@pytest.mark.parametrize("name", ["head", "runs"])
def test_pods_are_valid_and_may_do_little(name: str) -> None:
    spec = pod_specs(documents()["RayJob"])[name]
    pod = {"apiVersion": "v1", "kind": "Pod", "metadata": {"name": name}, "spec": spec}

    kubernetes_validate().validate(pod, KUBERNETES, strict=True)

    assert spec["securityContext"]["runAsNonRoot"]
    (container,) = spec["containers"]
    assert not container["securityContext"]["allowPrivilegeEscalation"]
    assert container["resources"]["requests"] == container["resources"]["limits"]
    mounted = {one["name"] for one in container["volumeMounts"]}
    assert mounted == {one["name"] for one in spec["volumes"]}


def test_all_pods_have_the_scenario_at_the_path_of_the_command() -> None:
    job = documents()["RayJob"]
    (inner,) = shlex.split(job["spec"]["entrypoint"])[2:]
    words = shlex.split(inner)
    file = Path(words[2])

    assert words[:2] == ["zensim", "sweep"]
    assert file.name in documents()["ConfigMap"]["data"]
    for spec in pod_specs(job).values():
        mounts = {one["name"]: one["mountPath"] for one in spec["containers"][0]["volumeMounts"]}
        assert mounts["scenario"] == str(file.parent)
    assert str(Path(words[words.index("--output") + 1]).parent) == "/results"


def test_scenario_of_the_manifest_makes_its_runs(tmp_path: Path) -> None:
    (name, text), *_ = documents()["ConfigMap"]["data"].items()
    (tmp_path / name).write_text(text)

    assert len(make_plan(str(tmp_path / name)).runs) == 100


def test_version_of_ray_is_that_of_the_pins() -> None:
    pinned = re.search(r"^ray==(\S+)", text_of(ROOT / "requirements" / "ray.txt"), re.MULTILINE)

    assert pinned is not None
    assert documents()["RayJob"]["spec"]["rayClusterSpec"]["rayVersion"] == pinned.group(1)
