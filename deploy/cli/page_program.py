"""`zensim view`: serve the 3D page of a running world, or of a recording."""

import os
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from zensim.deploy.cli.view_commands import (
    MissingViewerExtra,
    PageSource,
    ViewOptions,
    open_world,
    serve_page,
)
from zensim.proto.exit_codes import ExitCode, exit_on_failure
from zensim.proto.options.option_groups import make_app
from zensim.proto.stop_signal import StopFlag
from zensim.proto.verbosity import configure_logging

app = make_app()
_replay = partial(typer.Option, rich_help_panel="Replay")


@dataclass(frozen=True, kw_only=True)
class PageOptions(ViewOptions):
    """All options of `zensim view`."""

    recording: Annotated[
        Path | None,
        _replay(
            "--recording",
            metavar="FILE",
            help="Show a recording, a file or a folder, in place of a running world.",
        ),
    ] = None
    loop: Annotated[
        bool, _replay("--loop", metavar="", help="Begin again at the end of the recording.")
    ] = False


@app.command(
    epilog="""Examples:
  zensim view --open
  zensim view --recording run.mcap --open
  zensim view --host 0.0.0.0 --port 9000 --secure --certificate page.pem --key page.key"""
)
def view(given: PageOptions) -> None:
    """Serve a web page that shows the world in 3D, until Ctrl-C."""
    configure_logging()
    stop = StopFlag()
    with exit_on_failure("view", MissingViewerExtra):
        _check_options(given)
        open_source = partial(open_recording if given.recording else open_world, given)
        serve_page(given, open_source, stop)
    _end_process()


def _end_process() -> NoReturn:
    """End without the clean-up of Python: threads of viser still run, and it aborted at times."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(ExitCode.OK)


def open_recording(given: PageOptions, stack: ExitStack) -> PageSource:
    """Open a recording; its page has a time line, and no controls that change a world.

    Raises:
        OSError: A file cannot be read.
        ValueError: It is not a recording, or lacks what the page draws.
    """
    from zensim.deploy.cli import opened_recording
    from zensim.deploy.recorded_network import RecordedNetwork
    from zensim.spawner.page.replay_panel import ReplayPanel

    del stack  # files are closed after each reading
    assert given.recording is not None
    network = RecordedNetwork(opened_recording.open_recording("view", given.recording))
    network.playback.loops = given.loop
    return PageSource(network, network.world, panels={"Recording": ReplayPanel})


def _check_options(given: PageOptions) -> None:
    if given.recording is not None and given.connect:
        raise ValueError("--recording and --connect exclude each other; give one of them")
    if given.loop and given.recording is None:
        raise ValueError("--loop needs --recording FILE")
