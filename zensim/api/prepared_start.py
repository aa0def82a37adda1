"""`python -m zensim.api.prepared_start VERB SETTINGS`: run a program with JSON settings.

A program would spend most of its start on the command line parser. The verb `agents` takes a list
of settings, and makes a copy of this process for each.
"""

import gc
import os
import sys

import msgspec

from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.parent_death import die_with_supervisor
from zensim.proto.process_copies import copy_process, name_process

AGENT_VERB, AGENTS_VERB, SENSORS_VERB, ROUTER_VERB = "agent", "agents", "sensors", "router"


def main(verb: str, settings: str) -> None:
    """Run the program until it is stopped.

    Raises:
        SystemExit: With the status of `zensim VERB`.
    """
    die_with_supervisor(os.environ)
    with exit_on_failure(verb):
        if verb == AGENT_VERB:
            _run_agent(settings)
        elif verb == AGENTS_VERB:
            _run_agents(settings)
        elif verb == SENSORS_VERB:
            _run_sensors(settings)
        elif verb == ROUTER_VERB:
            _run_router(settings)
        else:
            raise ValueError(f"verb must be agent, agents, sensors or router, got {verb!r}")


def _run_agent(settings: str) -> None:
    from zensim.robot_agent.agent import run_agent_process  # noqa: PLC0415
    from zensim.robot_agent.agent_config import AgentProcessConfig  # noqa: PLC0415

    run_agent_process(msgspec.json.decode(settings, type=AgentProcessConfig))


def _run_agents(settings: str) -> None:
    # What all need is imported before the copies are made.
    from zensim.robot_agent.agent import run_agent_process  # noqa: PLC0415
    from zensim.robot_agent.agent_config import AgentProcessConfig  # noqa: PLC0415

    texts = msgspec.json.decode(settings, type=tuple[msgspec.Raw, ...])
    starts = [msgspec.json.decode(text, type=AgentProcessConfig) for text in texts]
    # A collection writes to all objects, which copies their memory.
    gc.collect()
    gc.freeze()
    if (number := copy_process(len(starts), os.environ)) is None:
        return
    die_with_supervisor(os.environ)
    own = bytes(texts[number]).decode()
    name_process([sys.executable, "-m", "zensim.api.prepared_start", AGENT_VERB, own])
    run_agent_process(starts[number])


def _run_sensors(settings: str) -> None:
    from zensim.sim_server.sensors.sensor_config import SensorProcessConfig  # noqa: PLC0415
    from zensim.sim_server.sensors.sensor_process import start_sensor_process  # noqa: PLC0415

    start_sensor_process(msgspec.json.decode(settings, type=SensorProcessConfig))


def _run_router(settings: str) -> None:
    from zensim.sim_server.security.router_process import run_router_process  # noqa: PLC0415

    run_router_process(msgspec.json.decode(settings, type=str))


if __name__ == "__main__":
    main(*sys.argv[1:])
