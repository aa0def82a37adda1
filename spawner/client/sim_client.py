"""SimClient: services of one world on a session; step goals with progress and cancellation."""

import time
import uuid
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout

from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.bus.bus_session import Bus
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import (
    CancelStepsRequest,
    SimulateStepsRequest,
    SimulateStepsResponse,
    StepsProgress,
)
from zensim.proto.messages.telemetry_messages import Info, Stats
from zensim.proto.service_catalog import CANCEL_STEPS, SIMULATE_STEPS
from zensim.proto.topic_catalog import STATS, STEPS_PROGRESS
from zensim.spawner.client.service_client import CALL_TIMEOUT_S, ServiceClient
from zensim.spawner.client.topic_reader import TopicReader, read_topic

MAX_LATE_POLLS = 20
GOAL_POLL_S = 0.005
PROGRESS_DEPTH = 64
CANCEL_TIMEOUT_S = 2.0

OnProgress = Callable[[StepsProgress], None]


class StepGoalInterrupted(KeyboardInterrupt):
    """Ctrl-C canceled the goal; `completed_steps` is None if the server did not reply."""

    def __init__(self, completed_steps: int | None) -> None:
        super().__init__("the goal was canceled")
        self.completed_steps = completed_steps


def run_step_goal(
    bus: Bus,
    world: str,
    request: SimulateStepsRequest,
    *,
    on_progress: OnProgress,
    timeout_s: float,
) -> SimulateStepsResponse:
    """Run a goal; call `on_progress` on this thread, the last time before the return.

    An exception of `on_progress` or an interrupt cancels the goal. A timeout does not: the same
    request again joins the goal.

    Raises:
        StepGoalInterrupted: Instead of KeyboardInterrupt.
        ServiceError: The goal was refused, canceled or aborted.
        TimeoutError: The goal did not finish in time.
        NoServer: No server has this world.
    """
    progress = read_topic(bus, STEPS_PROGRESS.key(world), StepsProgress, PROGRESS_DEPTH)
    try:
        with ThreadPoolExecutor(1) as executor:
            response = executor.submit(
                bus.call, SIMULATE_STEPS, request, world=world, timeout_s=timeout_s
            )
            try:
                _follow_progress(progress, request.goal_id, response, on_progress)
            except KeyboardInterrupt as interrupt:
                _cancel_goal(bus, world, request.goal_id)
                raise StepGoalInterrupted(_count_completed_steps(response)) from interrupt
            except BaseException:
                _cancel_goal(bus, world, request.goal_id)
                raise
            return response.result()
    finally:
        progress.close()


def _follow_progress(
    progress: TopicReader[StepsProgress],
    goal_id: str,
    response: "Future[SimulateStepsResponse]",
    on_progress: OnProgress,
) -> None:
    last, late_polls = None, 0
    while True:
        # Checked first, so that progress that arrived with the response is not lost.
        is_over = response.done()
        for status in progress.take():
            if status.goal_id == goal_id:
                last = status
                on_progress(status)
        # On a congested link, the response overtakes the last progress.
        is_last = last is None or last.status != "executing" or late_polls >= MAX_LATE_POLLS
        if is_over and is_last:
            return
        late_polls += is_over
        time.sleep(GOAL_POLL_S)


def _cancel_goal(bus: Bus, world: str, goal_id: str) -> None:
    try:
        bus.call(CANCEL_STEPS, CancelStepsRequest(goal_id), world=world, timeout_s=CANCEL_TIMEOUT_S)
    except (ServiceError, TimeoutError, NoServer):
        # The goal is over or unreachable; the caller raises the more important error.
        return


def _count_completed_steps(response: "Future[SimulateStepsResponse]") -> int | None:
    """Count the completed steps of a canceled goal; None without a reply."""
    try:
        return response.result(CANCEL_TIMEOUT_S).completed_steps
    except ServiceError as error:
        reply = error.response
        return reply.completed_steps if isinstance(reply, SimulateStepsResponse) else None
    except (FutureTimeout, TimeoutError, NoServer):
        return None


POLL_S = 0.05


def _require_restored(info: Info) -> Info:
    """Return the status of a server that serves; raise TimeoutError if it restores its journal."""
    if info.state == "restoring":
        raise TimeoutError(
            f"the server has restored {info.restored} of {info.to_restore} entities; wait longer"
        )
    return info


class SimClient(ServiceClient):
    """Client of the services of one world, on a session."""

    def __init__(self, bus: Bus, world: str = "default", timeout_s: float = CALL_TIMEOUT_S) -> None:
        super().__init__(bus, world, timeout_s)
        self.bus = bus

    def stats(self) -> Stats:
        """Get the statistics of the server: counts since its start, times of the last second.

        Raises:
            NoServer: None replies.
        """
        key = STATS.key(self.world)
        if not (samples := self.bus.get(key, self._timeout_s)):
            raise NoServer(f"no server replies on {key} at {self.bus.endpoint}; check --world-name")
        return decode(Stats, samples[0].payload, samples[0].encoding)

    def wait_for_server(self, timeout_s: float, on_wait: Callable[[], None] | None = None) -> Info:
        """Call `info` until a server replies that has restored its journal.

        Raises:
            NoServer: There is no server within the timeout.
            TimeoutError: It does not reply, or still restores.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                return _require_restored(self.info())
            except (NoServer, TimeoutError):
                if time.monotonic() >= deadline:
                    raise
            if on_wait is not None:
                on_wait()
            time.sleep(POLL_S)

    def info_when_restored(self) -> Info:
        """Call `info`, again while the server restores its journal: until then most of it is 0.

        Raises:
            NoServer: There is no server.
            TimeoutError: It does not reply, or restores for longer than the timeout of a call.
        """
        deadline = time.monotonic() + self._timeout_s
        while (info := self.info()).state == "restoring" and time.monotonic() < deadline:
            time.sleep(POLL_S)
        return _require_restored(info)

    def simulate_steps(
        self,
        steps: int,
        *,
        goal_id: str = "",
        on_progress: OnProgress | None = None,
        timeout_s: float | None = None,
    ) -> SimulateStepsResponse:
        """Advance a paused simulation with progress, and wait for completion.

        Args:
            steps: > 0.
            goal_id: For `cancel_steps` and for joining the goal; generated if empty.
            on_progress: An exception that it raises cancels the goal.
            timeout_s: Then TimeoutError is raised, but the goal continues.
        """
        request = SimulateStepsRequest(steps, goal_id or uuid.uuid4().hex)
        timeout_s = self._step_timeout_s(steps) if timeout_s is None else timeout_s
        return run_step_goal(
            self.bus,
            self.world,
            request,
            on_progress=on_progress or (lambda _: None),
            timeout_s=timeout_s,
        )
