"""`zensim up FILE`: a scenario in a world that runs by itself."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import zensim
from tests.integration.processes import free_endpoint

TEXT = (
    "zensim: 1\nrobots:\n  - {name: r, model: box_bot, count: 2, layout: {spacing: 2 m}}\n"
    "behaviours:\n  - {name: go, robots: r*, do: drive, v: 0.3}\n"
    "checks:\n  - {name: slow, robots: r0, that: speed, below: 0.1}\n"
    "  - {name: far, that: distance, above: 1}\nend: {at: 2 s}\n"
)


def up(*words: str) -> "subprocess.CompletedProcess[str]":
    listen = ("--listen", free_endpoint(), "--no-viewer")
    return subprocess.run(
        [sys.executable, "-m", "zensim", "up", *words, *listen],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_scenario_ends_by_itself_and_its_checks_warn(tmp_path: Path) -> None:
    file = tmp_path / "a.scenario.yaml"
    file.write_text(TEXT)

    done = up(str(file))

    assert done.returncode == 0, done.stderr
    assert f"{file}:7" in done.stderr
    assert f"{file}:8" not in done.stderr
    assert "at 2 s" in done.stdout


def test_duration_wins_over_the_end_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "a.scenario.yaml"
    file.write_text(TEXT.replace("at: 2 s", "at: 1 h"))

    done = up(str(file), "--duration", "1", "--json")

    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[0])["end_s"] == 1.0


@pytest.mark.parametrize(("text", "status"), [("zensim: 3\n", 2), ("", 3)])
def test_scenario_with_mistakes_starts_nothing(text: str, status: int, tmp_path: Path) -> None:
    file = tmp_path / "a.scenario.yaml"
    if text:
        file.write_text(text)

    done = up(str(file))

    assert done.returncode == status
    assert "serve" not in done.stderr


def test_scenario_is_recorded_with_the_commands_of_its_world(tmp_path: Path) -> None:
    file = tmp_path / "a.scenario.yaml"
    file.write_text(TEXT + "record: {to: 'runs/{name}-{seed}.mcap', keep: on_failure}\n")

    done = up(str(file))

    assert done.returncode == 0, done.stderr
    recording = zensim.Recording(tmp_path / "runs" / "a-0.mcap")
    assert recording.is_closed
    assert recording.counts["/r0/odom"] > 50
    assert {"/sim/default/requests", "/sim/default/inputs", "/clock"} <= set(recording.topics)
