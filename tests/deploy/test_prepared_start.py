"""Programs whose settings come ready made."""

import subprocess
import sys

import msgspec
import pytest

from tests.integration.processes import free_endpoint
from zensim.robot_agent.agent_config import AgentConfig, AgentProcessConfig

NOBODY = AgentProcessConfig(
    endpoint=free_endpoint(), config=AgentConfig(entities=("r1",), wait_s=0.0), is_quiet=True
)


def run(*words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "zensim.deploy.prepared_start", *words],
        capture_output=True,
        text=True,
        check=False,
    )


def test_agent_ends_as_that_of_the_command_line_does() -> None:
    done = run("agent", msgspec.json.encode(NOBODY).decode())

    assert done.returncode == 4
    assert done.stderr.startswith(
        f"zensim agent: UNREACHABLE (4): nobody listens at {NOBODY.endpoint}"
    )
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "complaint"),
    [(("serve", "{}"), "'serve' is unknown here"), (("agent", "{}"), "`endpoint`")],
)
def test_settings_that_are_none_are_refused_in_one_line(
    words: tuple[str, str], complaint: str
) -> None:
    done = run(*words)

    assert done.returncode == 2
    assert complaint in done.stderr
    assert done.stderr.count("\n") == 1


def test_agent_loads_no_command_line_and_no_arrays() -> None:
    heavy = "{'typer', 'rich', 'pydantic', 'numpy', 'pybullet'} & set(sys.modules)"

    done = subprocess.run(
        [sys.executable, "-c", f"import sys, deploy.ready; print({heavy})"],
        capture_output=True,
        text=True,
        check=True,
    )

    assert done.stdout == "set()\n"
