"""`python -m zensim.deploy.prepared_start VERB SETTINGS`: run a program with JSON settings.

An agent would spend most of its start on the command line parser.
"""

import os
import sys

import msgspec

from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.process_limits import die_with_supervisor
from zensim.robot_agent.agent import run_agent_process
from zensim.robot_agent.agent_config import AgentProcessConfig

AGENT_VERB = "agent"


def main(verb: str, settings: str) -> None:
    """Run the program until it is stopped.

    Raises:
        SystemExit: With the status of `zensim VERB`.
    """
    die_with_supervisor(os.environ)
    with exit_on_failure(verb):
        if verb != AGENT_VERB:
            raise ValueError(f"verb must be '{AGENT_VERB}', got {verb!r}")
        run_agent_process(msgspec.json.decode(settings, type=AgentProcessConfig))


if __name__ == "__main__":
    main(*sys.argv[1:])
