"""A server replies before it has imported what serves a world."""

import subprocess
import sys

PRINT_EARLY = "import sys, zensim.sim_server.server; print(*sys.modules)"
LATE = {"lxml", "numpy", "zensim.sim_server.served_world", "zensim.sim_server.runtime.loop"}


def test_what_a_reply_during_a_restore_needs_is_imported_alone() -> None:
    found = subprocess.run([sys.executable, "-c", PRINT_EARLY], capture_output=True, check=True)

    imported = set(found.stdout.decode().split())
    assert "zensim.sim_server.runtime.restore_replies" in imported
    assert not imported & LATE
