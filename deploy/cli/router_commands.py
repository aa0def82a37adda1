"""`zensim router`: a Zenoh router with the settings of the one in `zensim serve`."""

import time
from typing import Annotated

import typer

from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus
from zensim.proto.bus.zenoh_config import to_zenoh_json
from zensim.proto.endpoints import DEFAULT_ENDPOINT, check_exposure
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.options.command_options import InsecureOption, JsonOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.stop_signal import StopFlag
from zensim.proto.verbosity import configure_logging, print_announcement

POLL_S = 0.05

app = make_app()


@app.command(
    epilog="""Examples:
  zensim router
  zensim router --listen tcp/0.0.0.0:7447 --insecure
  zensim router --print-config > router.json"""
)
def router(
    *,
    listen: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENDPOINT",
            help="Zenoh endpoint to listen on; repeatable.",
            show_default=DEFAULT_ENDPOINT,
        ),
    ] = None,
    connect: Annotated[
        list[str] | None,
        typer.Option(metavar="ENDPOINT", help="Another router to connect to; repeatable."),
    ] = None,
    print_config: Annotated[
        bool, flag("--print-config", help="Print the configuration for 'zenohd -c', and exit.")
    ] = False,
    insecure: InsecureOption = False,
    as_json: JsonOption = False,
) -> None:
    """Start a Zenoh router, until Ctrl-C; servers and agents connect with --connect."""
    config = BusConfig(
        mode="router", listen=tuple(listen or (DEFAULT_ENDPOINT,)), connect=tuple(connect or ())
    )
    with exit_on_failure("router"):
        check_exposure("zensim serve", config.listen, is_secure=False, is_insecure=insecure)
        if print_config:
            print_lines(to_zenoh_json(config))
            return
        configure_logging()
        stop = StopFlag()
        with open_bus(config) as bus:
            at = bus.config.listen
            print_announcement("router", f"at {', '.join(at)}", {"endpoints": at}, as_json=as_json)
            while not stop():
                time.sleep(POLL_S)
