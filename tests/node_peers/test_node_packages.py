"""Packages of npm: locked without addresses, installed once, and refused without Node."""

import json
from pathlib import Path

import pytest

from tests.node_peers import node_packages
from tests.node_peers.node_packages import (
    FOLDER,
    NodeMissing,
    find_node,
    install_packages,
    make_key,
    start_script,
)


def test_lock_file_has_exact_versions_and_no_addresses() -> None:
    lock = json.loads((FOLDER / "package-lock.json").read_text())
    wanted = json.loads((FOLDER / "package.json").read_text())["dependencies"]

    packages = {path: one for path, one in lock["packages"].items() if path}

    assert [path for path, one in packages.items() if "resolved" in one] == []
    assert [path for path, one in packages.items() if "integrity" not in one] == []
    assert {name: packages[f"node_modules/{name}"]["version"] for name in wanted} == wanted


def test_key_changes_with_the_lock_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = make_key()
    for name in node_packages.MANIFESTS:
        (tmp_path / name).write_text((FOLDER / name).read_text() + "\n")

    monkeypatch.setattr(node_packages, "FOLDER", tmp_path)

    assert make_key() != before


def test_program_finds_the_installed_packages(tmp_path: Path) -> None:
    script = tmp_path / "names.cjs"
    script.write_text(
        "const { McapIndexedReader } = require('@mcap/core');"
        "process.stdin.on('data', (line) => console.log(McapIndexedReader.name + line));"
    )

    with start_script(script) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(" was asked\n")
        process.stdin.flush()
        line = process.stdout.readline()

    assert line == "McapIndexedReader was asked\n"
    assert process.poll() is not None
    assert install_packages() == install_packages()


def test_missing_node_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))

    with pytest.raises(NodeMissing, match="nodejs"):
        find_node()
