"""Manifests: schemas of Kubernetes, references, security, command lines as zensim reads them."""

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.main import get_command

from tests.contract.repository import ROOT
from tests.contract.schema_validators import kubernetes_validate
from tests.deploy.manifests import (
    FOLDER,
    POD_OWNERS,
    PODS,
    Manifest,
    find_pod,
    list_of_kind,
    list_pods,
    list_rendered,
    render,
)
from zensim.deploy.cli import VERBS, build
from zensim.deploy.cli.command_settings import Command, add_settings, list_commands, list_options
from zensim.proto.setting_variables import name_variable
from zensim.sim_server.runtime.loop import MAX_DRAIN_NS

VERSION = "1.30"
OTHERS = ("kustomization.yaml", "ray_job.yaml")
"""Kinds that Kubernetes itself lacks; tests/deploy/sweep/test_ray_job.py checks the last one."""
FILES = sorted(path for path in FOLDER.rglob("*.yaml") if path.name not in OTHERS)
WORLDS = ("office", "warehouse")
BAD = {
    "a text as a number": ("periodSeconds: 2", "periodSeconds: two"),
    "an unknown key": ("serviceName:", "serviceNam:"),
    "an unknown kind of mount": ("mountPath: /tmp", "mountPaths: /tmp"),
}


def validate(manifest: Manifest) -> None:
    """Check a manifest strictly.

    Raises:
        kubernetes_validate.ValidationError: It is not valid.
    """
    kubernetes_validate().validate(manifest, VERSION, strict=True)


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(os.environ):
        if name.startswith("ZENSIM_"):
            monkeypatch.delenv(name)


def list_all(path: Path) -> list[Manifest]:
    return list(yaml.safe_load_all(path.read_text()))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(FOLDER).as_posix())
def test_file_is_valid(path: Path) -> None:
    for manifest in list_all(path):
        validate(manifest)


def test_rendered_manifests_are_valid_and_unique() -> None:
    rendered = list_rendered()

    for manifest in rendered:
        validate(manifest)
    names = [(one["kind"], one["metadata"]["name"]) for one in rendered]
    assert len(names) == len(set(names)) > 15
    assert all(one["metadata"].get("namespace", "zensim") == "zensim" for one in rendered)


@pytest.mark.parametrize("change", BAD.values(), ids=BAD)
def test_mistake_in_a_manifest_is_found(change: tuple[str, str]) -> None:
    text = (FOLDER / "world" / "server.yaml").read_text()
    service, stateful_set = yaml.safe_load_all(text.replace(*change))

    validate(service)
    with pytest.raises(kubernetes_validate().ValidationError):
        validate(stateful_set)


@pytest.mark.parametrize("world", WORLDS)
def test_world_has_one_server_pools_sensors_and_its_own_settings(world: str) -> None:
    stateful_sets = list_of_kind("StatefulSet")
    (server,) = [one for one in stateful_sets if one["metadata"]["name"] == f"server-{world}"]
    parts = [
        one for one in list_of_kind(*POD_OWNERS) if one["metadata"]["labels"].get("world") == world
    ]

    assert (server["spec"]["replicas"], server["spec"]["serviceName"]) == (1, f"server-{world}")
    assert sorted(one["metadata"]["name"] for one in parts) == [
        f"pool-{world}",
        f"sensors-{world}",
        f"server-{world}",
    ]
    assert all(find_settings(find_pod(one))["ZENSIM_WORLD"] == world for one in parts)


def find_settings(pod: Manifest) -> dict[str, str]:
    """Find the variables that a pod gets from a ConfigMap."""
    maps = {one["metadata"]["name"]: one["data"] for one in list_of_kind("ConfigMap")}
    (container,) = pod["spec"]["containers"]
    found: dict[str, str] = {}
    for source in container.get("envFrom", ()):
        found |= maps[source["configMapRef"]["name"]]
    return found


def test_selectors_find_pods() -> None:
    pods = [find_pod(one)["metadata"]["labels"] for one in list_of_kind(*POD_OWNERS)]
    selectors = [
        *(one["spec"]["selector"] for one in list_of_kind("Service")),
        *(
            one["spec"]["selector"]["matchLabels"]
            for one in list_of_kind("PodDisruptionBudget", *POD_OWNERS)
        ),
        *(one["spec"]["podSelector"]["matchLabels"] for one in list_of_kind("NetworkPolicy")),
    ]

    counts = [sum(wanted.items() <= labels.items() for labels in pods) for wanted in selectors]

    assert len(selectors) > 15
    assert min(counts) >= 1
    # Only the policy of the network is for all pods.
    assert sorted(counts)[:-1] == [1] * (len(counts) - 1)


def test_each_world_has_a_budget_for_its_server_and_its_pools() -> None:
    names = [one["metadata"]["name"] for one in list_of_kind("PodDisruptionBudget")]

    wanted = (f"{part}-{world}" for part in ("pool", "server") for world in WORLDS)
    assert sorted(names) == sorted(wanted)


@pytest.mark.parametrize("name", PODS)
def test_pod_is_restricted_probed_and_has_what_it_mounts(name: str) -> None:
    spec = list_pods()[name]["spec"]
    (container,) = spec["containers"]
    ports = {port["name"] for port in container["ports"]}
    volumes = {one["name"] for one in spec["volumes"]} | {"state"}

    assert spec["securityContext"]["runAsNonRoot"]
    assert spec["securityContext"]["runAsUser"] == 10001
    assert spec["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert not spec["automountServiceAccountToken"]
    assert spec["terminationGracePeriodSeconds"] > 2 * MAX_DRAIN_NS * 1e-9
    assert container["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    assert container["image"] in {"zensim:agent", "zensim:server"}
    assert {one["name"] for one in container["volumeMounts"]} <= volumes
    for probe in ("livenessProbe", "readinessProbe"):
        check = container[probe].get("httpGet") or container[probe]["tcpSocket"]
        assert check["port"] in ports
    assert container["resources"]["limits"].keys() == {"memory"}, name


def test_names_of_pods_are_those_of_the_manifests() -> None:
    assert sorted(list_pods()) == sorted(PODS)


@pytest.mark.parametrize("name", [name for name in PODS if name != "router"])
def test_no_probe_that_restarts_a_pod_waits_until_it_is_ready(name: str) -> None:
    (container,) = list_pods()[name]["spec"]["containers"]

    paths = [container[f"{one}Probe"]["httpGet"]["path"] for one in ("startup", "liveness")]

    assert paths == ["/livez", "/livez"]
    assert container["readinessProbe"]["httpGet"]["path"] == "/readyz"


def test_pods_reach_only_the_router_and_the_dns_of_the_cluster() -> None:
    (policy,) = [
        one["spec"]
        for one in list_of_kind("NetworkPolicy")
        if "Egress" in one["spec"]["policyTypes"]
    ]

    ports = {rule["ports"][0]["port"]: rule.get("to") for rule in policy["egress"]}

    kube_system = {"matchLabels": {"kubernetes.io/metadata.name": "kube-system"}}
    assert ports.keys() == {7447, 53}
    assert ports[7447]
    assert ports[53] == [{"namespaceSelector": kube_system}]


def find_command(words: list[str]) -> tuple[Command, list[str], str]:
    """Find the command of a command line, its arguments, and its name."""
    commands = dict(list_commands(get_command(build(words[0])).commands[words[0]], words[0]))  # type: ignore[attr-defined]
    length = 2 if " ".join(words[:2]) in commands else 1
    name = " ".join(words[:length])
    return commands[name], words[length:], name


@pytest.mark.parametrize("name", PODS)
def test_command_line_of_a_pod_is_read_with_its_variables(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pod = list_pods()[name]
    settings = find_settings(pod)
    for variable, value in settings.items():
        monkeypatch.setenv(variable, value)
    command, words, verb = find_command(pod["spec"]["containers"][0]["args"])
    add_settings(command, verb)

    found: dict[str, Any] = command.make_context(verb, list(words)).params

    part, _, world = name.partition("-")
    if part == "router":
        assert (found["listen"], found["insecure"]) == (["tcp/0.0.0.0:7447"], True)
        return
    assert found["connect"] == "tcp/router:7447"
    assert found["world_name"] == world
    assert found["metrics"] == "0.0.0.0:9464"
    if part == "server":
        assert (found["world"], str(found["journal"])) == (world, "/var/lib/zensim/journal")
        assert (ROOT / "sim_server" / "worlds" / f"{world}.sdf").is_file()


def test_unknown_option_of_a_pod_is_refused() -> None:
    command, words, verb = find_command(["agent", "--pools=0"])

    with pytest.raises(Exception, match="--pools"):
        command.make_context(verb, words)


def test_variables_of_settings_are_those_of_options() -> None:
    known = {
        name
        for verb in VERBS
        for words, one in list_commands(get_command(build(verb)).commands[verb], verb)  # type: ignore[attr-defined]
        for key, option in list_options(one).items()
        for name in (name_variable(words, key), *as_list(option.envvar))
    }
    named = {name for one in list_of_kind("ConfigMap") for name in one["data"]}

    assert "ZENSIM_SERVE_WORLD" in named
    assert named <= known


def as_list(names: str | list[str] | None) -> list[str]:
    return [names] if isinstance(names, str) else names or []


def test_ten_worlds_are_rendered_as_the_guide_says(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "kubernetes.md").read_text()
    script = page.split("```sh\n# ten worlds\n")[1].split("```")[0]
    folder = tmp_path / "deploy" / "kubernetes"
    shutil.copytree(FOLDER, folder)
    subprocess.run(["sh", "-eu", "-c", script], cwd=tmp_path, check=True)

    rendered = list(yaml.safe_load_all(render(str(folder))))

    servers = [one["metadata"]["name"] for one in rendered if one["kind"] == "StatefulSet"]
    assert sorted(servers) == sorted(f"server-w{number}" for number in range(1, 11))
    for manifest in rendered:
        validate(manifest)
