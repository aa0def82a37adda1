"""WorldPage: the 3D page of a world, served by a process of its own."""

import json

from zensim.api.program_thread import ProgramThread
from zensim.proto.printable_text import to_html
from zensim.proto.supervisor import TERMINATE_TIMEOUT_S

PAGE_HEIGHT = 480
"""Height in notebooks [pixels]."""


class WorldPage:
    """A page that shows a world, until it or its simulation is closed.

    Attributes:
        url: Address for browsers on this host.
    """

    def __init__(self, endpoint: str, world: str, port: int, timeout_s: float) -> None:
        """Serve the page; see `Sim.show`."""
        arguments = (
            *("view", "--connect", endpoint, "--world-name", world),
            *("--port", str(port), "--no-open", "--json"),
        )
        self._program = ProgramThread("page", arguments, TERMINATE_TIMEOUT_S)
        line = self._program.read_line(timeout_s, "the page is not served")
        self.url = str(json.loads(line)["viewer"])

    def close(self) -> None:
        """End the page; may be repeated."""
        self._program.close()

    def _repr_html_(self) -> str:
        return f'<iframe src="{to_html(self.url)}" width="100%" height="{PAGE_HEIGHT}"></iframe>'

    def __repr__(self) -> str:
        """Write the address."""
        return f"WorldPage({self.url!r})"
