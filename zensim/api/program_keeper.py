"""ProgramKeeper: the programs of a launched simulation, started, watched and ended by one thread.

The kernel ends a program with the thread that started it, so that this thread lives as long as the
programs; the caller's may end before.
"""

import logging
import os
import threading
import time
from collections import deque

from zensim.api.api_errors import ConnectionLost, Error, Timeout
from zensim.api.call_deadline import limit
from zensim.api.local_deployment import DemandLaunch, LaunchConfig, LaunchFailed, start_programs
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError, TooFewFiles
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.supervisor import ProgramDied, Supervisor

LOG = logging.getLogger(__name__)
POLL_S, LIST_S = 0.01, 1.0
WATCH_PERIOD_S = 0.1
MAX_KEPT_LINES = 64
OUTPUT_TIMEOUT_S = 1.0


class ProgramOutput:
    """What programs write to their standard error; it is logged with level INFO.

    Attributes:
        descriptor: Of the end that programs write to.
        lines: The last ones.
    """

    def __init__(self) -> None:
        self._reader, self.descriptor = os.pipe()
        self.lines: deque[str] = deque(maxlen=MAX_KEPT_LINES)
        self._thread = threading.Thread(target=self._read, name="zensim output", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Read the rest, when all programs have ended."""
        os.close(self.descriptor)
        self._thread.join(OUTPUT_TIMEOUT_S)

    def _read(self) -> None:
        with os.fdopen(self._reader, encoding="utf-8", errors="replace") as stream:
            for line in stream:
                self.lines.append(line.rstrip())
                LOG.info("%s", line.rstrip())


class ProgramKeeper:
    """Starts programs, restarts those that ended, and starts sensor processes on demand."""

    def __init__(self, config: LaunchConfig, timeout_s: float) -> None:
        """Start the programs; `connect` waits for them.

        Args:
            config: What to start.
            timeout_s: Wall time of the start.
        """
        self._config = config
        self._deadline_s = time.monotonic() + timeout_s
        self._timeout_s = timeout_s
        self._output = ProgramOutput()
        self._supervisor = Supervisor(lambda _program, _status: None, self._output.descriptor)
        self._on_demand: DemandLaunch | None = None
        self._failure: Exception | None = None
        self._is_started, self._is_over = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="zensim programs", daemon=True)
        self._thread.start()

    def connect(self) -> Bus:
        """Wait for the server, and connect to it.

        Raises:
            Error: A program ended at its start.
            Timeout: The server did not start in time.
        """
        self._is_started.wait(self._timeout_s)
        alive = keys.alive_server(self._config.network.world_name)
        bus_config = BusConfig(connect=(self._config.endpoint,), open_timeout_s=0.1)
        bus: Bus | None = None
        while self._failure is None and time.monotonic() < self._deadline_s:
            try:
                bus = bus or open_bus(bus_config)
                if bus.list_tokens(alive, limit(LIST_S)):
                    self._on_demand = DemandLaunch(self._config, self._supervisor, bus)
                    return bus
            except BusError:
                continue
            time.sleep(POLL_S)
        if bus is not None:
            bus.close()
        raise self._make_start_error()

    def check(self) -> None:
        """Check that the programs run.

        Raises:
            ConnectionLost: One that is not restarted has ended.
        """
        if self._failure is not None:
            raise ConnectionLost(str(self._failure), slug="program_ended")

    def close(self) -> None:
        """End all programs; may be repeated."""
        if not self._is_over.is_set():
            self._is_over.set()
            self._thread.join()
            self._output.close()

    def _run(self) -> None:
        try:
            start_programs(
                self._config, self._supervisor, self._timeout_s, should_stop=self._is_over.is_set
            )
            self._is_started.set()
            while not self._is_over.wait(WATCH_PERIOD_S):
                self._supervisor.watch()
                if self._on_demand is not None:
                    self._on_demand.poll(time.monotonic())
        except (LaunchFailed, ProgramDied, TooFewFiles) as error:
            self._failure = error
        finally:
            self._supervisor.close()
            self._is_started.set()

    def _make_start_error(self) -> Error:
        if self._failure is None:
            return Timeout(f"the server has not started after {self._timeout_s:g} s")
        self.close()
        if isinstance(self._failure, TooFewFiles):
            message, _, hint = str(self._failure).partition(": ")[2].partition("; ")
            return Error(message, slug=self._failure.slug, hint=hint)
        last = [line for line in self._output.lines if line.strip()][-1:]
        return Error(": ".join([str(self._failure), *last]), slug="launch_failed")
