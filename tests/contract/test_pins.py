"""Pinned requirements against dependencies in pyproject.toml."""

import re
from functools import cache
from importlib.metadata import requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.contract.repository import ROOT

PINS = ROOT / "requirements"
EXTRAS = {
    "base": {""},
    "server": {"", "server"},
    "demo": {"", "server", "viewer", "xacro"},
    "viewer": {"", "viewer"},
    "xacro": {"", "xacro"},
    "dev": {"", "server", "viewer", "xacro", "dev"},
}
PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
FILES = sorted(path.stem for path in PINS.glob("*.txt"))
HASH = re.compile(r" *--hash=sha256:[0-9a-f]{64}")


@cache
def pins_of(path: Path) -> tuple[Requirement, ...]:
    entries = path.read_text().replace("\\\n", "").splitlines()
    return tuple(Requirement(HASH.sub("", one)) for one in entries if not one.startswith("#"))


def applies(requirement: Requirement, python: str, extra: str = "") -> bool:
    environment = {
        "python_version": python,
        "python_full_version": f"{python}.0",
        "sys_platform": "linux",
        "platform_system": "Linux",
        "platform_machine": "x86_64",
        "extra": extra,
    }
    return requirement.marker is None or requirement.marker.evaluate(environment)


def versions(name: str, python: str) -> dict[str, str]:
    pins = [pin for pin in pins_of(PINS / f"{name}.txt") if applies(pin, python)]
    return {canonicalize_name(pin.name): str(pin.specifier).removeprefix("==") for pin in pins}


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("name", EXTRAS)
def test_pins_contain_every_dependency_of_the_extra(name: str, python: str) -> None:
    asked = [Requirement(line) for line in requires("zensim") or []]
    wanted = [need for need in asked if any(applies(need, python, extra) for extra in EXTRAS[name])]

    pinned = versions(name, python)

    assert wanted
    unmet = [
        str(need)
        for need in wanted
        if not need.specifier.contains(pinned.get(canonicalize_name(need.name), "0"))
    ]
    assert unmet == []


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("name", sorted({*FILES} - {"dev", "peers"}))
def test_pins_agree_with_those_of_dev(name: str, python: str) -> None:
    assert versions(name, python).items() <= versions("dev", python).items()


def test_pins_of_the_build_are_what_it_requires() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (line,) = re.findall(r"^requires = \[(.*)\]$", text, re.MULTILINE)
    asked = [Requirement(one.strip(' "')) for one in line.split(",")]
    pinned = versions("build", PYTHONS[0])

    assert {need.name for need in asked} == set(pinned)
    assert all(need.specifier.contains(pinned[need.name]) for need in asked)


@pytest.mark.parametrize("name", FILES)
def test_pin_is_exact_and_hashed_without_url(name: str) -> None:
    text = (PINS / f"{name}.txt").read_text().replace("\\\n", "")

    entries = [line for line in text.splitlines() if not line.startswith("#")]

    assert all("==" in entry and HASH.search(entry) for entry in entries)
    assert re.findall(r"\S*://\S*", text) == []
