"""`zensim config show`: values and their sources."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.processes import run_in_process
from zensim.proto.exit_codes import ExitCode


def show(*words: str) -> dict[str, dict[str, Any]]:
    done = run_in_process("config", "show", *words, "--json")
    assert done.returncode == ExitCode.OK, done.stderr
    return {one["option"]: one for one in json.loads(done.stdout)}


def test_value_and_source_of_each_option_are_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "zensim.yaml"
    file.write_text("serve:\n  world: walls\n  seed: 4\n")
    monkeypatch.setenv("ZENSIM_SERVE_SEED", "5")
    monkeypatch.delenv("ZENSIM_CONNECT", raising=False)

    found = show("serve", "--config", str(file))

    assert (found["world"]["value"], found["world"]["source"]) == ("walls", f"file {file}")
    assert (found["seed"]["value"], found["seed"]["source"]) == (5, "variable ZENSIM_SERVE_SEED")
    assert (found["paused"]["value"], found["paused"]["source"]) == (False, "default")
    assert found["connect"]["variables"] == ["ZENSIM_SERVE_CONNECT", "ZENSIM_CONNECT"]


def test_command_of_a_group_is_shown() -> None:
    assert show("sensors", "run")["always"]["variables"] == ["ZENSIM_SENSORS_RUN_ALWAYS"]


@pytest.mark.parametrize("words", [("sweep",), ("sweep run",), ("sweep", "run")])
def test_command_that_may_be_left_out_is_shown(words: tuple[str, ...]) -> None:
    assert show(*words)["jobs"]["variables"] == ["ZENSIM_SWEEP_RUN_JOBS", "ZENSIM_SWEEP_JOBS"]


def test_table_has_a_line_for_each_option() -> None:
    done = run_in_process("config", "show", "serve")

    assert any(line.startswith("--rtf ") for line in done.stdout.splitlines())


def test_join_token_is_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZENSIM_AGENT_CONNECT", "zs1.c2VjcmV0")

    assert "c2VjcmV0" not in json.dumps(show("agent"))


@pytest.mark.parametrize(
    "words", [("nothing",), ("topic",), ("sensors", "walk"), ("serve", "more")]
)
def test_unknown_command_is_refused(words: tuple[str, ...]) -> None:
    done = run_in_process("config", "show", *words)

    assert done.returncode == ExitCode.USAGE
    assert len(done.stderr.splitlines()) == 1


def test_value_that_is_not_valid_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZENSIM_SERVE_RTF", "fast")

    done = run_in_process("config", "show", "serve")

    assert done.returncode == ExitCode.USAGE
    assert "--rtf" in done.stderr


def test_endpoint_for_clients_is_not_that_of_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZENSIM_CONNECT", "tcp/127.0.0.1:1")
    found = show("up")["connect"]
    assert (found["source"], found["variables"]) == ("default", ["ZENSIM_UP_CONNECT"])

    monkeypatch.setenv("ZENSIM_UP_CONNECT", "tcp/127.0.0.1:2")
    assert show("up")["connect"]["source"] == "variable ZENSIM_UP_CONNECT"


@pytest.mark.parametrize(
    ("text", "variable", "used"),
    [
        ("listen: tcp/127.0.0.1:3", "ZENSIM_CONNECT", "listen"),
        ("listen: tcp/127.0.0.1:3", "ZENSIM_SERVE_CONNECT", "connect"),
        ("connect: tcp/127.0.0.1:3", "ZENSIM_SERVE_LISTEN", "listen"),
        ("seed: 1", "ZENSIM_CONNECT", "connect"),
    ],
)
def test_endpoint_that_serve_would_use_is_shown(
    text: str, variable: str, used: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "zensim.yaml"
    file.write_text(f"serve: {{{text}}}")
    monkeypatch.delenv("ZENSIM_CONNECT", raising=False)
    monkeypatch.setenv(variable, "tcp/127.0.0.1:1")

    found = show("serve", "--config", str(file))

    assert {key for key in ("listen", "connect") if found[key]["source"] != "default"} == {used}
