"""Shell completion of names, with and without a server."""

import os
import subprocess
import sys

from tests.deploy.cli.commands import NOWHERE
from tests.integration.processes import Server


def complete(line: str, endpoint: str) -> list[str]:
    """Complete the last word of a line as bash does; check that standard error is empty."""
    variables = {
        "_ZENSIM_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split(" ")) - 1),
        "ZENSIM_CONNECT": endpoint,
    }
    done = subprocess.run(
        [sys.executable, "-m", "zensim"],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        env={**os.environ, **variables},
    )
    assert done.stderr == ""
    return done.stdout.split()


def test_entity_names_are_completed(two: Server) -> None:
    assert complete("zensim inspect ", two.endpoint) == ["r1", "r2"]
    assert complete("zensim inspect r", two.endpoint) == ["r1", "r2"]
    assert complete("zensim set x", two.endpoint) == []


def test_given_name_is_not_completed_again(two: Server) -> None:
    assert complete("zensim delete r1 ", two.endpoint) == ["r2"]


def test_completion_uses_the_connect_option(two: Server) -> None:
    line = f"zensim inspect --connect {two.endpoint} r1"

    assert complete(line, NOWHERE) == ["r1"]


def test_world_names_are_completed(server: Server) -> None:
    assert complete("zensim world load w", server.endpoint) == ["walls", "warehouse"]


def test_nothing_is_completed_without_a_reply(server: Server) -> None:
    assert complete("zensim inspect ", NOWHERE) == []
    assert complete("zensim inspect --world-name mars r", server.endpoint) == []
