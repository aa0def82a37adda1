"""`zensim view` without its packages."""

import subprocess
import sys

WITHOUT_VISER = """
import sys
sys.modules["viser"] = None
sys.argv = ["zensim", "view"]
from zensim.deploy.cli import main
main()
"""


def test_view_names_the_extra_when_viser_is_not_installed() -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_VISER],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )

    assert done.returncode == 1
    assert done.stdout == ""
    assert "pip install 'zensim[viewer]'" in done.stderr
    assert done.stderr.count("\n") == 1
