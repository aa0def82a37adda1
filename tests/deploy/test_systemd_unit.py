"""The unit of systemd, checked by systemd itself, without running it."""

import re
import subprocess
from pathlib import Path

import pytest

from tests.contract.repository import ROOT
from zensim.proto.exit_codes import ExitCode

UNIT = ROOT / "deploy" / "systemd" / "zensim@.service"
PROGRAM = "/opt/zensim/bin/zensim"
THRESHOLD = "20"
"""Exposure, in tenths; a service without settings has 96."""
BAD = {
    "an unknown setting": ("NoNewPrivileges=", "NoNewPrivilege="),
    "no program": ("ExecStart=", "ExecStar="),
    "a program that is not there": ("ExecStart=/", "ExecStart=/nowhere/"),
}


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    """Copy the unit, with a program that is on every host."""
    path = tmp_path / UNIT.name
    path.write_text(UNIT.read_text().replace(PROGRAM, "/bin/true"))
    return path


def analyze(*words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        ["systemd-analyze", *words], capture_output=True, text=True, check=False, timeout=60
    )


def check(unit: Path) -> bool:
    done = analyze("verify", "--man=no", str(unit))
    return done.returncode == 0 and unit.name not in done.stderr


def check_exposure(unit: Path) -> bool:
    words = ("security", "--offline=true", f"--threshold={THRESHOLD}", str(unit))
    return analyze(*words).returncode == 0


def test_unit_has_no_mistake_and_little_exposure(unit: Path) -> None:
    assert check(unit)
    assert check_exposure(unit)


@pytest.mark.parametrize("change", BAD.values(), ids=BAD)
def test_mistake_in_a_unit_is_found(unit: Path, change: tuple[str, str]) -> None:
    unit.write_text(unit.read_text().replace(*change))

    assert not check(unit)


def test_unit_without_hardening_is_refused(tmp_path: Path) -> None:
    plain = tmp_path / "plain.service"
    plain.write_text("[Service]\nExecStart=/bin/true\n")

    assert not check_exposure(plain)


def test_unit_waits_longer_for_the_end_than_a_server_drains() -> None:
    found = re.search(r"^TimeoutStopSec=(\d+)$", UNIT.read_text(), re.MULTILINE)

    assert found
    assert int(found[1]) > 10


def test_unit_reads_counters_of_the_host_for_metrics() -> None:
    """`process_*` need /proc/stat."""
    assert "ProcSubset=" not in UNIT.read_text()


def test_unit_is_not_started_again_with_the_same_mistake() -> None:
    found = re.search(r"^RestartPreventExitStatus=(\d+)$", UNIT.read_text(), re.MULTILINE)

    assert found
    assert int(found[1]) == ExitCode.USAGE
