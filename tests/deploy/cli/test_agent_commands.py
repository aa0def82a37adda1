"""`zensim agent` without a server."""

import pytest

from tests.integration.processes import free_endpoint, run_in_process, zensim


@pytest.mark.parametrize(
    ("arguments", "value"),
    [
        (("r-1",), "'r-1'"),
        (("r1", "--world-name", "*"), "'*'"),
        (("r1", "--name", "a/b"), "'a/b'"),
        (("r1", "--on-release", "maybe"), "'maybe'"),
        (("r1", "--connect", "nowhere"), "'nowhere'"),
    ],
)
def test_agent_rejects_invalid_arguments_in_one_line(
    arguments: tuple[str, ...], value: str
) -> None:
    done = run_in_process("agent", *arguments)

    assert done.returncode == 2
    assert done.stderr.startswith("zensim agent: ")
    assert value in done.stderr
    assert done.stderr.count("\n") == 1


def test_agent_stops_waiting_for_a_server_at_its_deadline() -> None:
    done = zensim("agent", "r1", "--connect", free_endpoint(), "--wait", "0.4")

    assert done.returncode == 4
    assert done.stderr.startswith("zensim agent: ")
    assert done.stderr.count("\n") == 1
