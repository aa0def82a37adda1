"""Imports of the code against dependencies in pyproject.toml."""

import ast
import re
import sys
from functools import cache
from importlib.metadata import distribution, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.contract.repository import PACKAGES, ROOT, files, shown, text_of
from zensim.sim_server.physics.engine_config import has_wheel

EXTRA_OF = {
    "sim_server/scene/camera_rendering.py": {"", "server", "cameras"},
    "sim_server/": {"", "server"},
    "spawner/page/": {"", "viewer"},
    "proto/operation_server.py": {"", "metrics"},
    "zensim/foxglove/": {"", "foxglove"},
    "zensim/vda5050/": {"", "vda5050"},
    "spawner/top/top_app.py": {"", "top"},
    "zensim/envs/": {"", "rl"},
    "zensim/recording/series_chart.py": {"", "plot"},
    "zensim/recording/table_files.py": {"", "dataset"},
    "deploy/sweep/ray_runs.py": {"", "ray"},
    "deploy/sweep/sweep_folder.py": {"", "dataset"},
    "deploy/sweep/sweep_plots.py": {"", "plot"},
    # A plug-in that pytest loads.
    "zensim/testing.py": {"", "dev"},
}


def outside_imports(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(text_of(path))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module)
    # mypy knows typing_extensions; it is imported for type checking only.
    ours = {
        *PACKAGES,
        "benchmarks",
        # Part of Python since 3.14.
        "compression",
        "tests",
        "typing_extensions",
        "zensim",
        *sys.stdlib_module_names,
    }
    return {name.split(".")[0] for name in names} - ours


@cache
def modules_of(package: str) -> frozenset[str]:
    """Find the top-level modules that a distribution installed."""
    record = distribution(package).read_text("RECORD") or ""
    return frozenset(line.split(",")[0].split("/")[0].split(".")[0] for line in record.splitlines())


@cache
def importable(extras: frozenset[str]) -> frozenset[str]:
    needs = [Requirement(line) for line in requires("zensim") or []]
    declared = {
        need.name
        for need in needs
        if need.marker is None or any(need.marker.evaluate({"extra": extra}) for extra in extras)
    }
    return frozenset(module for package in declared for module in modules_of(package))


def extras_of(path: Path) -> frozenset[str]:
    name = shown(path)
    if name.startswith("tests/"):
        ours = {"server", "viewer", "vda5050", "top", "dataset", "rl"}
        return frozenset({"", *ours, "metrics", "dev"})
    return frozenset(next((ours for part, ours in EXTRA_OF.items() if name.startswith(part)), {""}))


def test_module_imports_only_what_its_extra_declares() -> None:
    sources = [
        path
        for path in files()
        if path.suffix == ".py"
        and path.relative_to(ROOT).parts[0] in {*PACKAGES, "tests"}
        # Scripts of another interpreter, which has rclpy.
        and not shown(path).startswith("tests/interop/ros_programs/")
    ]

    found = {shown(path): outside_imports(path) - importable(extras_of(path)) for path in sources}

    assert sources
    assert {name: modules for name, modules in found.items() if modules} == {}


PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
PLATFORMS = {
    "Linux x86_64": ("linux", "x86_64"),
    "Linux arm64": ("linux", "aarch64"),
    "macOS arm64": ("darwin", "arm64"),
    "Windows": ("win32", "AMD64"),
}
PYBULLET_WHEELS = {("Linux x86_64", "3.10"): "pybullet", ("Linux x86_64", "3.11"): "pybullet"}
"""Those of PyBullet 3.2.7, as the index of packages has them."""
FORK_WHEELS = {
    (platform, python): "pybullet-arm64"
    for platform in PLATFORMS.keys() - {"Linux arm64"}
    for python in PYTHONS[:-1]
}
"""Those of its fork, version 3.2.8."""


def engines_of(extra: str, platform: str, python: str) -> set[str]:
    """Find the packages of engines that an extra installs, in pyproject.toml."""
    system, machine = PLATFORMS[platform]
    environment = {"sys_platform": system, "platform_machine": machine, "python_version": python}
    _, _, block = text_of(ROOT / "pyproject.toml").partition(f"\n{extra} = [")
    lines = re.findall(r'^  "((?:pybullet|mujoco)\b[^"]*)"', block.partition("\n]")[0], re.M)
    needs = [Requirement(line) for line in lines]
    return {n.name for n in needs if n.marker is None or n.marker.evaluate(environment)}


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("platform", PLATFORMS)
def test_server_installs_mujoco_on_each_platform(platform: str, python: str) -> None:
    package = "mujoco" if python == "3.10" else "mujoco-core"

    assert package in engines_of("server", platform, python)


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("platform", PLATFORMS)
def test_server_installs_pybullet_where_it_has_a_wheel(platform: str, python: str) -> None:
    package = {**FORK_WHEELS, **PYBULLET_WHEELS}.get((platform, python))

    found = engines_of("server", platform, python) - {"mujoco", "mujoco-core"}

    assert found == ({package} if package else set())


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("platform", PLATFORMS)
def test_hint_of_a_missing_engine_knows_where_pybullet_has_a_wheel(
    platform: str, python: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    system, machine = PLATFORMS[platform]
    monkeypatch.setattr("sys.platform", system)
    monkeypatch.setattr("platform.machine", lambda: machine)
    monkeypatch.setattr("sys.version_info", tuple(map(int, python.split("."))))

    assert has_wheel("pybullet") == ((platform, python) in {**FORK_WHEELS, **PYBULLET_WHEELS})


def test_all_has_each_extra_of_users() -> None:
    text = text_of(ROOT / "pyproject.toml").partition("[project.optional-dependencies]")[2]
    named = re.findall(r"^([a-z0-9]+) = \[", text.partition("\n[")[0], re.M)
    chosen = re.findall(r'^  "zensim\[([a-z0-9,]+)\]', text, re.M)

    assert "server" in named
    assert set(",".join(chosen).split(",")) == set(named) - {"all", "dev"}


def test_classifiers_name_the_supported_versions_of_python() -> None:
    text = text_of(ROOT / "pyproject.toml")

    named = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', text)

    assert tuple(named) == PYTHONS
    assert f'requires-python = ">={PYTHONS[0]}"' in text
