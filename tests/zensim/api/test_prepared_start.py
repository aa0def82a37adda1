"""Programs that are started with settings as JSON."""

import subprocess
import sys

import msgspec
import pytest

from tests.integration.processes import free_endpoint
from zensim.robot_agent.agent_config import AgentConfig, AgentProcessConfig

UNREACHABLE = AgentProcessConfig(
    endpoint=free_endpoint(), config=AgentConfig(entities=("r1",), wait_s=0.0), is_quiet=True
)


def run(*words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "zensim.api.prepared_start", *words],
        capture_output=True,
        text=True,
        check=False,
    )


def test_agent_exits_like_the_command() -> None:
    done = run("agent", msgspec.json.encode(UNREACHABLE).decode())

    assert done.returncode == 4
    assert done.stderr.startswith("zensim agent: ")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "value"), [(("serve", "{}"), "'serve'"), (("agent", "{}"), "`endpoint`")]
)
def test_invalid_settings_are_refused_in_one_line(words: tuple[str, str], value: str) -> None:
    done = run(*words)

    assert done.returncode == 2
    assert value in done.stderr
    assert done.stderr.count("\n") == 1


def test_agent_imports_only_what_it_uses() -> None:
    heavy = (
        "{'typer', 'rich', 'pydantic', 'numpy', 'pybullet', 'http', 'ssl', 'hashlib', 'email', "
        "'difflib', 'importlib.metadata'} & set(sys.modules)"
    )
    modules = "zensim.api.prepared_start, zensim.robot_agent.agent"

    done = subprocess.run(
        [sys.executable, "-c", f"import sys, {modules}; print({heavy})"],
        capture_output=True,
        text=True,
        check=True,
    )

    assert done.stdout == "set()\n"
