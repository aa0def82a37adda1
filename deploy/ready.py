"""`python -m deploy.ready VERB SETTINGS`: a program whose settings come ready made, as JSON.

To read a command line takes longer than all else that an agent does until it drives.
"""

import os
import sys

import msgspec

from zensim.deploy.parent import die_with_parent
from zensim.proto.exit_codes import exit_on_failure
from zensim.robot_agent.config import AgentStart
from zensim.robot_agent.process import run

AGENT = "agent"


def main(verb: str, settings: str) -> None:
    """Run the program until it is stopped.

    Raises:
        SystemExit: As that of `zensim VERB`.
    """
    die_with_parent(os.environ)
    with exit_on_failure(verb):
        if verb != AGENT:
            raise ValueError(f"verb {verb!r} is unknown here; use '{AGENT}'")
        run(msgspec.json.decode(settings, type=AgentStart))


if __name__ == "__main__":
    main(*sys.argv[1:])
