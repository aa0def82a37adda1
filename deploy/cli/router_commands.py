"""`zensim router`: the router alone, with the same settings as the one inside `zensim serve`."""

import time
from typing import Annotated

import typer

from zensim.proto.bus import DEFAULT_ENDPOINT, BusConfig, open_bus, to_zenoh_json
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.stop_signal import StopFlag

POLL_S = 0.05

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def router(
    *,
    listen: Annotated[
        list[str] | None, typer.Option(help="Endpoint to listen at; may be repeated.")
    ] = None,
    connect: Annotated[
        list[str] | None, typer.Option(help="Another router to join; may be repeated.")
    ] = None,
    print_config: Annotated[
        bool, typer.Option("--print-config", help="Print the settings as zenohd -c takes them.")
    ] = False,
) -> None:
    """Run the router alone: servers and agents join it with --connect, in any order."""
    config = BusConfig(
        mode="router", listen=tuple(listen or (DEFAULT_ENDPOINT,)), connect=tuple(connect or ())
    )
    with exit_on_failure("router"):
        if print_config:
            typer.echo(to_zenoh_json(config))
            return
        stop = StopFlag()
        with open_bus(config) as bus:
            typer.echo(f"zensim router: at {', '.join(bus.config.listen)}", err=True)
            while not stop():
                time.sleep(POLL_S)
