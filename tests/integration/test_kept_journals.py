"""Journals of released versions are opened by this one, and kept as they were."""

import json
import re
import shutil
from importlib.metadata import version
from pathlib import Path

import pytest

from tests.contract.repository import ROOT, text_of
from tests.integration.journals import serving_with_journal
from tests.integration.keep_journal import EXPECTED, JOURNAL, KEPT, describe_world
from tests.integration.processes import free_endpoint, run_in_process
from zensim.sim_server.journal.sqlite_store import COPIES

RELEASE = re.compile(r"^## \[(\d+\.\d+\.\d+)\]", re.MULTILINE)
VERSIONS = sorted(path.name for path in KEPT.iterdir())


def test_there_is_a_journal_of_each_release_and_of_this_version() -> None:
    released = RELEASE.findall(text_of(ROOT / "CHANGELOG.md"))

    assert {*released, version("zensim")} <= set(VERSIONS)


@pytest.mark.parametrize("kept", VERSIONS)
def test_journal_of_a_release_is_opened_and_kept(kept: str, tmp_path: Path) -> None:
    folder = tmp_path / "journal"
    shutil.copytree(KEPT / kept / JOURNAL, folder)
    expected = json.loads((KEPT / kept / EXPECTED).read_text(encoding="utf-8"))

    with serving_with_journal(folder, free_endpoint()) as server:
        found = describe_world(server)

    assert found["state"] == expected["state"]
    assert found["places"].keys() == expected["places"].keys()
    for name, place in expected["places"].items():
        assert found["places"][name] == pytest.approx(place, abs=0.01), name
    copies = sorted(path.name for path in (folder / COPIES).glob("*"))
    assert copies == ([] if kept == version("zensim") else [kept])


@pytest.mark.parametrize("kept", VERSIONS)
def test_journal_of_a_release_is_whole(kept: str, tmp_path: Path) -> None:
    folder = tmp_path / "journal"
    shutil.copytree(KEPT / kept / JOURNAL, folder)

    done = run_in_process("journal", "verify", str(folder))

    assert done.returncode == 0, done.stderr
