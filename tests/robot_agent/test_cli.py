"""`zensim agent`, as far as it goes without a server."""

from typing import TYPE_CHECKING

import pytest

from tests.integration.processes import free_endpoint, zensim

if TYPE_CHECKING:
    import subprocess


def agent(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return zensim("agent", *arguments)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("r-1",), "entity 'r-1' is not valid"),
        (("r1", "--world-name", "*"), "world '*' is not valid"),
        (("r1", "--name", "a/b"), "agent 'a/b' is not valid"),
        (("r1", "--on-release", "maybe"), "'maybe'"),
        (("r1", "--connect", "nowhere"), "endpoint 'nowhere' is not valid"),
    ],
)
def test_agent_says_in_one_line_what_was_wrong_with_its_arguments(
    arguments: tuple[str, ...], complaint: str
) -> None:
    done = agent(*arguments)

    assert done.returncode == 2
    assert done.stderr.startswith("zensim agent: USAGE (2): ")
    assert complaint in done.stderr
    assert done.stderr.count("\n") == 1


def test_agent_waits_for_a_server_no_longer_than_asked() -> None:
    done = agent("r1", "--connect", free_endpoint(), "--wait", "0.4")

    assert done.returncode == 4
    assert done.stderr.startswith("zensim agent: UNREACHABLE (4): nobody listens at tcp/127.0.0.1:")
    assert done.stderr.count("\n") == 1
