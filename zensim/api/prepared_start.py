"""`python -m zensim.api.prepared_start VERB SETTINGS`: run a program with JSON settings.

A program would spend most of its start on the command line parser.
"""

import os
import sys

import msgspec

from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.process_limits import die_with_supervisor

AGENT_VERB, SENSORS_VERB, ROUTER_VERB = "agent", "sensors", "router"


def main(verb: str, settings: str) -> None:
    """Run the program until it is stopped.

    Raises:
        SystemExit: With the status of `zensim VERB`.
    """
    die_with_supervisor(os.environ)
    with exit_on_failure(verb):
        if verb == AGENT_VERB:
            _run_agent(settings)
        elif verb == SENSORS_VERB:
            _run_sensors(settings)
        elif verb == ROUTER_VERB:
            _run_router(settings)
        else:
            raise ValueError(f"verb must be agent, sensors or router, got {verb!r}")


def _run_agent(settings: str) -> None:
    from zensim.robot_agent.agent import run_agent_process  # noqa: PLC0415
    from zensim.robot_agent.agent_config import AgentProcessConfig  # noqa: PLC0415

    run_agent_process(msgspec.json.decode(settings, type=AgentProcessConfig))


def _run_sensors(settings: str) -> None:
    from zensim.sim_server.sensors.sensor_config import SensorProcessConfig  # noqa: PLC0415
    from zensim.sim_server.sensors.sensor_process import start_sensor_process  # noqa: PLC0415

    start_sensor_process(msgspec.json.decode(settings, type=SensorProcessConfig))


def _run_router(settings: str) -> None:
    from zensim.sim_server.security.router_process import run_router_process  # noqa: PLC0415

    run_router_process(msgspec.json.decode(settings, type=str))


if __name__ == "__main__":
    main(*sys.argv[1:])
