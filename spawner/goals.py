"""Goals of steps as a caller sees them: progress while they run, and canceled when he gives up."""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout

from zensim.proto import keys
from zensim.proto.bus import Bus, NoServer, Subscription
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import (
    CancelStepsRequest,
    SimulateStepsRequest,
    SimulateStepsResponse,
    StepsProgress,
)
from zensim.proto.service_catalog import CANCEL_STEPS, SIMULATE_STEPS

POLL_S = 0.005
DEPTH = 64
CANCEL_TIMEOUT_S = 2.0

OnProgress = Callable[[StepsProgress], None]


class GoalInterrupted(KeyboardInterrupt):
    """Ctrl-C, and the goal was canceled; `made` is how many steps it got to, if that is known."""

    def __init__(self, made: int | None) -> None:
        super().__init__("the goal was canceled")
        self.made = made


def reach_goal(
    bus: Bus,
    world: str,
    request: SimulateStepsRequest,
    *,
    on_progress: OnProgress,
    timeout_s: float,
) -> SimulateStepsResponse:
    """Run a goal and tell of its progress, on this thread; the last is told before the return.

    What `on_progress` raises, or an interrupt, cancels the goal; a timeout does not: the same
    request again joins it.

    Raises:
        GoalInterrupted: Instead of KeyboardInterrupt.
        ServiceError: It was refused, canceled or aborted.
        TimeoutError: It is not over in time.
        NoServer: Nothing serves this world.
    """
    progress = bus.subscribe(keys.steps_progress(world), DEPTH)
    try:
        with ThreadPoolExecutor(1) as waiting:
            answer = waiting.submit(
                bus.call, SIMULATE_STEPS, request, world=world, timeout_s=timeout_s
            )
            try:
                _listen(progress, request.goal_id, answer, on_progress)
            except KeyboardInterrupt as interrupt:
                _cancel(bus, world, request.goal_id)
                raise GoalInterrupted(_made(answer)) from interrupt
            except BaseException:
                _cancel(bus, world, request.goal_id)
                raise
            return answer.result()
    finally:
        progress.close()


def _listen(
    progress: Subscription,
    goal_id: str,
    answer: "Future[SimulateStepsResponse]",
    on_progress: OnProgress,
) -> None:
    is_over = False
    while not is_over:
        # Asked before the look, so that what came with the answer is not left behind.
        is_over = answer.done()
        for sample in progress.take():
            try:
                told = decode(StepsProgress, sample.payload, sample.encoding)
            except MalformedPayload:
                continue
            if told.goal_id == goal_id:
                on_progress(told)
        if not is_over:
            time.sleep(POLL_S)


def _cancel(bus: Bus, world: str, goal_id: str) -> None:
    try:
        bus.call(CANCEL_STEPS, CancelStepsRequest(goal_id), world=world, timeout_s=CANCEL_TIMEOUT_S)
    except (ServiceError, TimeoutError, NoServer):
        # Over already, or out of reach: the caller has something better to hear.
        return


def _made(answer: "Future[SimulateStepsResponse]") -> int | None:
    """Tell how far a goal came that was ended."""
    try:
        return answer.result(CANCEL_TIMEOUT_S).completed_steps
    except ServiceError as error:
        found = error.response
        return found.completed_steps if isinstance(found, SimulateStepsResponse) else None
    except (FutureTimeout, TimeoutError, NoServer):
        return None
