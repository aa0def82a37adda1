"""WorldCalls: calls of services for visitors; long ones do not stop the drawing."""

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from queue import Empty, SimpleQueue
from typing import Final

from zensim.proto.bus.bus_errors import BusError
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.result_messages import ServiceError, SetSimulationStateCode
from zensim.proto.network_protocols import CallingNetwork
from zensim.proto.service_catalog import SET_SIMULATION_STATE
from zensim.spawner.page.side_panel import WorldCall, ignore

CALL_TIMEOUT_S: Final = 0.8
"""Short, so that Ctrl-C takes effect within a second."""
RESET_TIMEOUT_S: Final = 60.0
"""Time limit of a long call that resets: a thousand entities take seconds."""
LAST_CALLS_S: Final = 1.0
"""Time limit of all calls at the end of the program."""
MAX_LONG_CALLS: Final = 64
"""Most long calls at the same time; a further one is refused."""


class WorldCalls:
    """Calls services of one world; callbacks run in the thread that calls `make` and `settle`."""

    def __init__(self, network: CallingNetwork, world: str) -> None:
        """Take the network; make no call yet."""
        self._network, self._world = network, world
        self._finished: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._running = 0

    def make(self, call: WorldCall) -> None:
        """Make a call: with a time limit of its own, on a thread of its own."""
        if not call.timeout_s:
            self._call(call, CALL_TIMEOUT_S)()
        elif self._running >= MAX_LONG_CALLS:
            call.on_error(f"{MAX_LONG_CALLS} requests are not answered yet; wait for them")
        else:
            self._running += 1
            threading.Thread(target=self._run, args=(call,), daemon=True).start()

    def make_last(self, calls: Iterable[WorldCall]) -> None:
        """Make calls at the end of the program; wait for their replies at most `LAST_CALLS_S`."""
        executor = ThreadPoolExecutor(MAX_LONG_CALLS)
        wait([executor.submit(self._call, call, LAST_CALLS_S) for call in calls], LAST_CALLS_S)
        executor.shutdown(wait=False, cancel_futures=True)

    def settle(self) -> None:
        """Run the callbacks of the long calls that are over."""
        while True:
            try:
                finish = self._finished.get_nowait()
            except Empty:
                return
            self._running -= 1
            finish()

    def _run(self, call: WorldCall) -> None:
        finish: Callable[[], None] = partial(call.on_error, "internal error")
        try:
            finish = self._call(call, call.timeout_s)
        finally:
            self._finished.put(finish)

    def _call(self, call: WorldCall, timeout_s: float) -> Callable[[], None]:
        """Make a call, and return what is to be done with its result."""
        try:
            response = self._network.call(
                call.service, call.request, world=self._world, timeout_s=timeout_s
            )
        except ServiceError as error:
            if is_in_state_already(call, error):
                return partial(ignore, call)
            if getattr(error.response, "results", ()):
                # A refusal with a reason for each of many entities.
                return partial(call.on_reply, error.response)
            return partial(call.on_error, str(error))
        except (BusError, TimeoutError, MalformedPayload) as error:
            return partial(call.on_error, str(error))
        return partial(call.on_reply, response)


def is_in_state_already(call: WorldCall, error: ServiceError) -> bool:
    """Whether a world has the state that was requested; the code has other meanings elsewhere."""
    already = SetSimulationStateCode.ALREADY_IN_TARGET_STATE
    return call.service is SET_SIMULATION_STATE and error.code == already
