"""What shells are offered for a name, by a real server and without one."""

import os
import subprocess
import sys

from tests.integration.processes import Server
from tests.spawner.cli.commands import NOWHERE


def offered(line: str, endpoint: str) -> list[str]:
    """Complete the last word of a line as bash does; standard error stays empty."""
    asked = {
        "_ZENSIM_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split(" ")) - 1),
        "ZENSIM_CONNECT": endpoint,
    }
    done = subprocess.run(
        [sys.executable, "-m", "zensim"],
        capture_output=True,
        text=True,
        timeout=30,
        check=True,
        env={**os.environ, **asked},
    )
    assert done.stderr == ""
    return done.stdout.split()


def test_names_of_entities_are_offered(two: Server) -> None:
    assert offered("zensim inspect ", two.endpoint) == ["r1", "r2"]
    assert offered("zensim state get r", two.endpoint) == ["r1", "r2"]
    assert offered("zensim info set x", two.endpoint) == []


def test_name_that_is_there_is_not_offered_again(two: Server) -> None:
    assert offered("zensim delete r1 ", two.endpoint) == ["r2"]


def test_server_may_be_named_on_the_line(two: Server) -> None:
    line = f"zensim inspect --connect {two.endpoint} r1"

    assert offered(line, NOWHERE) == ["r1"]


def test_names_of_worlds_are_offered(server: Server) -> None:
    assert offered("zensim world load w", server.endpoint) == ["walls", "warehouse"]


def test_nothing_is_offered_when_nobody_answers(server: Server) -> None:
    assert offered("zensim inspect ", NOWHERE) == []
    assert offered("zensim inspect --world-name mars r", server.endpoint) == []
