"""`zensim`: one command over all programs, and `zensim up` when it is mistyped."""

import os
import re
import subprocess
import sys
from importlib.metadata import version

import pytest
from typer.testing import CliRunner

from tests.integration.processes import zensim
from zensim.deploy.cli import VERBS, build
from zensim.proto.exit_codes import ExitCode

RUNNER = CliRunner()
HEAVY = ("pybullet", "viser", "yourdfpy", "lxml", "zenoh", "numpy")


def modules_after(code: str) -> set[str]:
    """Tell which of the heavy modules a program has imported."""
    program = f"{code}\nimport sys\nprint(*[name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=30, check=True
    )
    return set(done.stdout.split())


def test_help_names_every_verb_with_its_line() -> None:
    done = RUNNER.invoke(build(""), ["--help"], env={"COLUMNS": "200"})

    assert done.exit_code == ExitCode.OK
    for verb, (_, line) in VERBS.items():
        assert re.search(rf"\b{verb}\b +{re.escape(line)}", done.stdout)


def test_help_is_shown_when_nothing_was_asked() -> None:
    done = RUNNER.invoke(build(""), [])

    assert "Usage:" in done.output


def test_help_imports_nothing_heavy() -> None:
    assert modules_after("from zensim.deploy.cli import build; build('')") == set()


@pytest.mark.parametrize("verb", VERBS)
def test_verb_shows_its_own_help(verb: str) -> None:
    done = RUNNER.invoke(build(verb), [verb, "--help"], env={"COLUMNS": "200"})

    assert done.exit_code == ExitCode.OK
    assert "--" in done.stdout


def test_verbs_import_neither_engine_nor_page_before_they_run() -> None:
    code = "from zensim.deploy.cli import VERBS, build\nfor verb in VERBS: build(verb)"

    assert not modules_after(code) & {"pybullet", "viser", "yourdfpy", "lxml"}


def test_version_is_that_of_the_package() -> None:
    done = RUNNER.invoke(build(""), ["--version"])

    assert (done.exit_code, done.stdout) == (ExitCode.OK, f"zensim {version('zensim')}\n")


@pytest.mark.parametrize("verb", ["state", "info", "world"])
def test_group_lists_its_commands_when_none_is_named(verb: str) -> None:
    done = zensim(verb)

    assert f"Usage: zensim {verb} [OPTIONS] COMMAND" in done.stdout + done.stderr
    assert done.returncode == ExitCode.USAGE


def test_unknown_verb_is_refused() -> None:
    done = zensim("levitate")

    assert done.returncode == ExitCode.USAGE
    assert "No such command 'levitate'" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--layout", "spiral"), "--layout 'spiral' is unknown; use row, grid, circle"),
        (("--spacing", "0"), "is no fleet; use at least 1 robot and more than 0 m"),
        (("--world-name", "my world"), "world name 'my world' is not valid; use a letter"),
        (("--listen", "here"), "endpoint 'here' is not valid; use protocol/host:port"),
        (("--model", "my robot.urdf"), "prefix 'my robot' is not valid; use a letter"),
    ],
)
def test_up_is_refused_in_one_line_when_it_is_mistyped(
    arguments: tuple[str, ...], message: str
) -> None:
    done = zensim("up", *arguments)

    assert done.returncode == ExitCode.USAGE
    assert done.stderr.startswith("zensim up: USAGE (2): ")
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_up_says_why_when_its_server_does_not_come_up() -> None:
    done = zensim("up", "--world", "nowhere.sdf", "--listen", "tcp/127.0.0.1:0", "--no-viewer")

    assert done.returncode == ExitCode.FAILED
    assert "world 'nowhere.sdf' is neither a file nor one of empty" in done.stderr
    assert "zensim up: FAILED (1): server ended with status 2" in done.stderr


@pytest.mark.parametrize(
    ("line", "word", "offered"),
    [
        ("zensim p", 1, "pause\nplay\n"),
        ("zensim spawn --str", 2, "--strict\n"),
        ("zensim state ", 2, "get\nset\n"),
        ("zensim world load --al", 3, "--allow-missing\n"),
    ],
)
def test_shell_completes_verbs_and_their_options(line: str, word: int, offered: str) -> None:
    asked = {"_ZENSIM_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(word)}
    done = subprocess.run(
        [sys.executable, "-c", "from zensim.deploy.cli import main; main()"],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
        env={**os.environ, **asked},
    )

    assert done.stdout == offered
