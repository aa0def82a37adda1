"""WorldPage: the 3D page of a world, served by a process of its own."""

import threading
from queue import Empty, SimpleQueue

from zensim.api.api_errors import Error, Timeout
from zensim.api.program_keeper import ProgramOutput
from zensim.proto.printable_text import to_html
from zensim.proto.supervisor import Supervisor

PAGE_HEIGHT = 480
"""Height in notebooks [pixels]."""


class WorldPage:
    """A page that shows a world, until it or its simulation is closed.

    Attributes:
        url: Address for browsers on this host.
    """

    def __init__(self, endpoint: str, world: str, port: int, timeout_s: float) -> None:
        """Serve the page; see `Sim.show`."""
        self._arguments = (
            *("view", "--connect", endpoint, "--world-name", world),
            *("--port", str(port), "--no-open"),
        )
        self._output = ProgramOutput()
        self._is_over = threading.Event()
        self._lines: SimpleQueue[str] = SimpleQueue()
        # The kernel ends a program with the thread that started it.
        self._thread = threading.Thread(target=self._run, name="zensim page", daemon=True)
        self._thread.start()
        try:
            line = self._lines.get(timeout=timeout_s)
        except Empty as error:
            self.close()
            raise Timeout(f"the page is not served after {timeout_s:g} s") from error
        if not line:
            self.close()
            reason = ": ".join(["the page cannot be served", *list(self._output.lines)[-1:]])
            raise Error(reason, slug="no_page")
        self.url = line.split()[-1]

    def close(self) -> None:
        """End the page; may be repeated."""
        if not self._is_over.is_set():
            self._is_over.set()
            self._thread.join()
            self._output.close()

    def _run(self) -> None:
        supervisor = Supervisor(lambda _program, _status: None, self._output.descriptor)
        process = supervisor.start("page", self._arguments).process
        reader = threading.Thread(
            target=lambda: self._lines.put(
                process.stdout.readline().decode() if process and process.stdout else ""
            ),
            daemon=True,
        )
        reader.start()
        self._is_over.wait()
        supervisor.close()

    def _repr_html_(self) -> str:
        return f'<iframe src="{to_html(self.url)}" width="100%" height="{PAGE_HEIGHT}"></iframe>'

    def __repr__(self) -> str:
        """Write the address."""
        return f"WorldPage({self.url!r})"
