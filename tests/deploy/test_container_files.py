"""Dockerfile and Compose file, read by other programs without building anything."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.contract.repository import ROOT, text_of
from zensim.sim_server.runtime.loop import MAX_DRAIN_NS

FOLDER = ROOT / "deploy" / "containers"
DOCKERFILE, COMPOSE = FOLDER / "Dockerfile", FOLDER / "compose.yaml"
REQUIREMENTS = ROOT / "requirements"
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
    words = ("--builtin-schema", "vendor.compose-spec", str(path))
    return run_tool("check-jsonschema", *words).returncode == 0


def choose() -> list[str]:
    """List the lines of the requirements of the server's image."""
    names = ("server.txt", "mujoco.txt")
    command = ["sh", str(FOLDER / "choose"), *(str(REQUIREMENTS / name) for name in names)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def name_packages(lines: list[str]) -> list[str]:
    return [line.split("==")[0] for line in lines if re.match(r"[a-z]", line)]


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


def test_image_of_the_server_has_fewer_packages_and_all_hashes() -> None:
    lines = choose()
    names = name_packages(lines)
    all_names = name_packages((REQUIREMENTS / "server.txt").read_text().splitlines())
    entries = "\n".join(lines).replace("\\\n", "").splitlines()

    assert {"lxml", "mujoco-core", "numpy", "scipy", "trimesh[easy]", "embreex"} <= set(names)
    assert not {"pybullet", "yourdfpy", "mujoco-studio"} & set(names)
    assert len(set(names)) < len(set(all_names))
    assert all("--hash=sha256:" in entry for entry in entries)
    assert len(entries) == len(set(entries))


def test_what_the_image_leaves_out_is_pinned() -> None:
    """A package that was renamed would come back unseen."""
    pattern = r"^left_out=['\"](?:\$left_out\|)?(.*)['\"]$"
    parts = re.findall(pattern, text_of(FOLDER / "choose"), re.MULTILINE)
    left_out = "|".join(parts).split("|")
    pinned = [
        name.split("[")[0]
        for file in ("server.txt", "mujoco.txt")
        for name in name_packages(text_of(REQUIREMENTS / file).splitlines())
    ]

    assert len(left_out) > 20
    assert set(left_out) - set(pinned) == set()


def test_wheel_in_the_image_is_built_with_the_pinned_version() -> None:
    pinned = re.search(r"^setuptools==(\S+)", (REQUIREMENTS / "dev.txt").read_text(), re.MULTILINE)

    assert pinned
    assert f"setuptools=={pinned[1]}" in DOCKERFILE.read_text()
