"""`zensim join`: check a join token, and keep it for later connections to its endpoint."""

import json
import sys
from typing import Annotated

import typer

from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus
from zensim.proto.endpoints import check_endpoint
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.join_tokens import (
    forget_token,
    is_join_address,
    parse_join_file,
    read_join_address,
    store_token,
)
from zensim.proto.options.command_options import JsonOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines

STANDARD_INPUT = "-"

app = make_app()


@app.command(
    epilog="""Examples:
  zensim join - < operator.token
  zensim list --connect tls/sim.example.org:7447
  zensim join --forget tls/sim.example.org:7447"""
)
def join(
    *,
    token: Annotated[
        str,
        typer.Argument(
            metavar="TOKEN|@FILE|-",
            help="Join token, a file with it, or '-' for standard input; with --forget, an "
            "endpoint.",
        ),
    ],
    forget: Annotated[
        bool, flag("--forget", help="Remove the token that is kept for an endpoint.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Keep a join token, so that '--connect ENDPOINT' of its server needs no other."""
    with exit_on_failure("join"):
        facts = _forget(token) if forget else _keep(token)
        if as_json:
            print_lines(json.dumps(facts))
        elif forget:
            print_lines(f"forgot the token for {facts['endpoint']}")
        else:
            print_lines(
                f"user '{facts['user']}' is kept for this endpoint; use --connect "
                f"{facts['endpoint']}"
            )


def _keep(address: str) -> dict[str, str]:
    """Store a token that its server admits."""
    if address == STANDARD_INPUT:
        found = parse_join_file(sys.stdin.read(), "")
    elif is_join_address(address):
        found = read_join_address(address)
    else:
        raise ValueError(
            "give a join token, @FILE with one, or - for standard input; "
            "'zensim token create' on the host of the server makes one"
        )
    open_bus(BusConfig(connect=(found.write(),))).close()
    return {"endpoint": found.endpoint, "user": found.user, "file": str(store_token(found))}


def _forget(endpoint: str) -> dict[str, str]:
    return {"endpoint": endpoint, "file": str(forget_token(check_endpoint(endpoint)))}
