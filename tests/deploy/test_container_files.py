"""Dockerfile and Compose file, read by other programs without building anything."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.contract.repository import ROOT, text_of
from tests.contract.schema_validators import find_schema_mistakes
from zensim.sim_server.runtime.loop import MAX_DRAIN_NS

FOLDER = ROOT / "deploy" / "containers"
DOCKERFILE, COMPOSE = FOLDER / "Dockerfile", FOLDER / "compose.yaml"
REQUIREMENTS = ROOT / "requirements"
RESOLVED = text_of(DOCKERFILE).replace("\\\n", "").replace("$PIP", "pip")
"""The Dockerfile, one line for each instruction."""
BAD_DOCKERFILES = {
    "the newest base": ("${BASE} AS python", "debian:latest AS python"),
    "the shell form": ('ENTRYPOINT ["zensim"]', "ENTRYPOINT zensim"),
    "an unknown instruction": ("WORKDIR /src", "WORKDIRS /src"),
}
BAD_COMPOSE_FILES = {
    "an unknown key": ("read_only: true", "readonly: true"),
    "a time without a unit": ("interval: 5s", "interval: [5]"),
    "an unknown condition": ("service_healthy", "service_is_fine"),
}


def run_tool(name: str, *words: str) -> "subprocess.CompletedProcess[str]":
    """Run a tool of the environment of the tests."""
    tool = Path(sys.executable).with_name(name)
    return subprocess.run([str(tool), *words], capture_output=True, text=True, check=False)


def lint(path: Path) -> bool:
    return run_tool("hadolint", str(path)).returncode == 0


def check_compose(path: Path) -> bool:
    return find_schema_mistakes("vendor.compose-spec", path) == ""


def test_dockerfile_follows_the_rules() -> None:
    done = run_tool("hadolint", str(DOCKERFILE))

    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.parametrize("change", BAD_DOCKERFILES.values(), ids=BAD_DOCKERFILES)
def test_mistake_in_a_dockerfile_is_found(change: tuple[str, str], tmp_path: Path) -> None:
    before = DOCKERFILE.read_text()
    bad = tmp_path / "Dockerfile"
    bad.write_text(before.replace(*change))

    assert bad.read_text() != before
    assert not lint(bad)


def test_compose_file_has_the_form_of_the_specification() -> None:
    assert check_compose(COMPOSE)


@pytest.mark.parametrize("change", BAD_COMPOSE_FILES.values(), ids=BAD_COMPOSE_FILES)
def test_mistake_in_a_compose_file_is_found(change: tuple[str, str], tmp_path: Path) -> None:
    before = COMPOSE.read_text()
    bad = tmp_path / "compose.yaml"
    bad.write_text(before.replace(*change))

    assert bad.read_text() != before
    assert not check_compose(bad)


def test_services_are_hardened_and_have_images_of_the_dockerfile() -> None:
    targets = re.findall(r"^FROM runtime AS (\w+)$", DOCKERFILE.read_text(), re.MULTILINE)
    services = yaml.safe_load(COMPOSE.read_text())["services"]

    assert targets == ["agent", "server", "full"]
    assert len(services) == 7
    for service in services.values():
        assert service["image"].rstrip("}").rpartition(":")[2] in targets
        assert service["read_only"] is True
        assert service["user"] == "10001:10001"
        assert service["cap_drop"] == ["ALL"]
        assert (service["mem_limit"], service["pids_limit"]) == ("2g", 512)
        assert int(service["stop_grace_period"].rstrip("s")) > 2 * MAX_DRAIN_NS * 1e-9


def test_volumes_are_mounted_where_the_image_has_a_folder_of_the_user() -> None:
    """A volume belongs to the user whose folder it covers first."""
    (made,) = re.findall(r"install -d .* -o 10001 ((?:.|\\\n)*?)\n[A-Z]", DOCKERFILE.read_text())
    folders = set(re.findall(r"/\S+", made))
    content = yaml.safe_load(COMPOSE.read_text())
    mounts = [one for service in content["services"].values() for one in service.get("volumes", ())]

    assert mounts
    assert {mount.split(":")[1] for mount in mounts} <= folders
    assert {mount.split(":")[0] for mount in mounts} == set(content["volumes"])


def test_images_install_nothing_without_hashes() -> None:
    """But the wheel that is built of the copied sources."""
    installs = re.findall(r"pip install (.*?) *(?:&&|$)", RESOLVED, re.MULTILINE)

    assert len(installs) == 6
    unpinned = [words for words in installs if "--require-hashes -r requirements/" not in words]
    assert unpinned == ["--no-compile --no-deps /opt/wheel/*.whl"]


def test_targets_install_the_extras_that_they_are_for() -> None:
    stages = dict(re.findall(r"^FROM build AS build-(\w+)\n((?:(?!FROM).*\n)*)", RESOLVED, re.M))
    installed = {name: re.findall(r"requirements/(\w+)\.txt", stages[name]) for name in stages}

    assert installed == {"agent": [], "server": ["server"], "full": ["server", "viewer"]}
    assert all((REQUIREMENTS / f"{name}.txt").is_file() for name in installed["full"])
