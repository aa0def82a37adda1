"""An agent as a process: joins the network, drives, and ends well when it is told to."""

import logging
import signal
import sys
import time
import uuid
from contextlib import suppress

import msgspec

from zensim.proto.bus import BusConfig, open_bus_with_retry
from zensim.proto.stop_signal import STOP_SIGNALS, StopFlag
from zensim.robot_agent.agent import run_agent
from zensim.robot_agent.config import AgentConfig, AgentStart

CHARACTERS_OF_ENTITY = 48
"""Of its name, in a made-up name of an agent."""


def run(start: AgentStart) -> None:
    """Stay until stopped, which is how an agent ends well; one without a name makes one up.

    Raises:
        Unreachable: Nobody listens at the endpoint.
        ServiceError: See `run_agent`, as for the others.
    """
    logging.basicConfig(
        level=logging.WARNING if start.is_quiet else logging.INFO,
        format="%(levelname)s %(name)s %(message)s",
        stream=sys.stderr,
    )
    config = start.config
    # Opening does not return to Python; until there is a token to withdraw, a signal just ends it.
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    deadline_s = time.monotonic() + config.wait_s
    with open_bus_with_retry(BusConfig(connect=(start.endpoint,)), config.wait_s) as bus:
        left_s = max(0.0, deadline_s - time.monotonic())
        name = config.agent or _made_up_name(config)
        # An interrupt in what Python calls by itself is lost: the flag is looked at, too.
        with suppress(KeyboardInterrupt):
            stop = StopFlag(is_armed=False)
            run_agent(bus, msgspec.structs.replace(config, agent=name, wait_s=left_s), stop)


def _made_up_name(config: AgentConfig) -> str:
    entity = config.entities[0] if config.entities else "pool"
    return f"agent_{entity[:CHARACTERS_OF_ENTITY]}_{uuid.uuid4().hex[:4]}"
