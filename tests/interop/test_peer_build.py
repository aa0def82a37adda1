"""Builds of the peers: found again by their contents, and refused without cargo."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.benchmark_report import Section
from tests.interop import __main__ as interop
from tests.interop.crate_pins import pin_crates
from tests.interop.foreign_peers import JAZZY
from tests.interop.peer_build import SOURCES, PeersMissing, find_cargo, find_peers, key_of

LOCK = """version = 4

[[package]]
name = "hiroz"
version = "0.2.0"

[[package]]
name = "syn"
version = "1.0.109"

[[package]]
name = "syn"
version = "2.0.110"

[[package]]
name = "libc"
version = "0.2.1"
"""


def test_key_changes_with_contents_and_names(tmp_path: Path) -> None:
    file = tmp_path / "a" / "Cargo.toml"
    file.parent.mkdir()
    file.write_text("one")
    first = key_of(tmp_path)

    file.write_text("two")
    second = key_of(tmp_path)
    file.rename(file.with_name("b"))

    assert len({first, second, key_of(tmp_path)}) == 3


def test_crates_are_pinned_once_each_and_direct_ones_are_left() -> None:
    manifest = '[dependencies]\nhiroz = { version = "=0.2.0" }\n'

    once = pin_crates(manifest, LOCK)

    assert once.startswith(manifest)
    assert 'libc = { version = "=0.2.1", default-features = false }\n' in once
    assert 'syn-1-0-109 = { package = "syn", version = "=1.0.109"' in once
    assert once.count("hiroz") == 1
    assert pin_crates(once, LOCK) == once


def test_every_dependency_has_an_exact_version() -> None:
    text = (SOURCES / "Cargo.toml").read_text()
    tables = text.split("\n[")
    lines = [
        line
        for table in tables
        if table.partition("\n")[0].endswith("dependencies]")
        for line in table.splitlines()[1:]
        if " = " in line
    ]

    assert len(lines) > 15
    assert [line for line in lines if '"=' not in line] == []


@pytest.fixture
def _without_cargo(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("INTEROP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("sys.argv", ["tests.interop", "--short"])


@pytest.mark.usefixtures("_without_cargo")
@pytest.mark.parametrize(("required", "status"), [("", 0), ("require", 1)])
def test_run_without_cargo_is_skipped_unless_it_is_required(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], required: str, status: int
) -> None:
    monkeypatch.setenv("INTEROP", required)

    with pytest.raises(PeersMissing):
        find_cargo()

    assert interop.run() == status
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.fixture
def _cargo_that_must_not_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cargo = tmp_path / "cargo"
    cargo.write_text(f"#!/bin/sh\ntouch {tmp_path}/has_run\nexit 1\n")
    cargo.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setenv("INTEROP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("INTEROP", "cached")


@pytest.mark.usefixtures("_cargo_that_must_not_run")
def test_run_from_the_cache_is_left_out_in_a_line_without_a_build(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr("sys.argv", ["tests.interop", "--short"])

    assert interop.run() == 0
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (tmp_path / "has_run").exists()


@pytest.mark.usefixtures("_cargo_that_must_not_run")
def test_run_from_the_cache_measures_with_the_build_that_is_there(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("sys.argv", ["tests.interop", "talk", "--short"])
    built = find_peers(JAZZY)
    built.parent.mkdir(parents=True)
    built.touch()
    measured: list[str] = []

    def measure(name: str, *, is_short: bool) -> Section:
        measured.append(name)
        return Section(f"short: {is_short}", ("a figure",))

    monkeypatch.setattr(interop, "DOCUMENT", replace(interop.DOCUMENT, make=measure))

    assert interop.run() == 1
    assert measured == ["talk"]
    assert not (tmp_path / "has_run").exists()
