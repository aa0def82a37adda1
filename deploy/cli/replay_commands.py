"""`zensim replay`: publish a recording again, with the options of `ros2 bag play`."""

import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import msgspec
import typer
from typer.core import TyperCommand

from zensim.deploy.cli.opened_recording import note_damage, open_recording
from zensim.deploy.cli.recording_options import (
    TIME_PANEL,
    TOPIC_LISTS,
    TOPICS_PANEL,
    ExcludeRegexOption,
    ExcludeTopicsOption,
    RegexOption,
    SpanOption,
    StartOffsetOption,
    find_span,
    repeat_options,
)
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import EndpointUnreachable
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.options.command_options import (
    ConnectOption,
    JsonOption,
    RosOptions,
    WorldNameOption,
    flag,
    seconds,
)
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.raw_terminal import NoTerminal, RawTerminal
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.stop_signal import StopFlag
from zensim.proto.topic_catalog import CLOCK
from zensim.proto.topic_endpoints import make_topic_factory
from zensim.proto.verbosity import CURRENT, print_announcement, print_note
from zensim.recording.recording_reader import RecordingReader
from zensim.recording.replay.living_topics import require_unused
from zensim.recording.replay.replay_keyboard import ReplayKeyboard
from zensim.recording.replay.replay_program import (
    SleepingWait,
    Waiting,
    open_terminal_wait,
    run_replay,
)
from zensim.recording.replay.replay_publishers import ReplayPublishers
from zensim.recording.replay.replay_requests import ReplayRequests
from zensim.recording.replay.replay_timeline import ReplayTimeline
from zensim.recording.replay.replayed_names import NameSettings, ReplayedNames
from zensim.recording.replay.replayer import Replayer, ReplaySettings
from zensim.recording.topic_selection import TopicSelection

app = make_app()

NODE: Final = "zensim_replay"
MAX_NAMES_SHOWN: Final = 5
DEFAULT_CLOCK_HZ: Final = 40.0
OPEN_TIMEOUT_S: Final = 2.0
MATCH_S: Final = 0.1
"""Wait until publishers have the declarations of subscribers behind other routers."""
SETTLE_S: Final = 0.3
"""Wait until what was sent last has left."""
REMAP_OPTIONS: Final = ("--remap", "-m")
CLOCK_OPTION: Final = "--clock"

_time = {"rich_help_panel": TIME_PANEL}
_topics = {"rich_help_panel": TOPICS_PANEL}


class ReplayCommand(TyperCommand):
    """Takes `--clock` without a value, and several values after `--topics`, as rosbag2 does."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Parse the words after the name of the command."""
        return super().parse_args(ctx, expand_words(args))


def expand_words(words: list[str]) -> list[str]:
    """Write `--clock` with its value, and an option with several values once for each."""
    expanded: list[str] = []
    rest = list(words)
    while rest:
        word = rest.pop(0)
        if word == CLOCK_OPTION and not (rest and _is_number(rest[0])):
            expanded += [word, f"{DEFAULT_CLOCK_HZ:g}"]
        elif word in REMAP_OPTIONS:
            while rest and ":=" in rest[0]:
                expanded += [word, rest.pop(0)]
        else:
            expanded.append(word)
    return list(repeat_options(expanded, TOPIC_LISTS))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


@dataclass(frozen=True, kw_only=True)
class ReplayOptions(RosOptions):
    """All options of `zensim replay`."""

    path: Annotated[
        Path, typer.Argument(metavar="FILE|FOLDER", help="Recording: an .mcap file, or its folder.")
    ]
    rate: Annotated[
        float,
        typer.Option(
            "--rate", "-r", metavar="RATE", help="Factor of speed; 0 = as fast as it goes.", **_time
        ),
    ] = 1.0
    loop: Annotated[
        bool, flag("--loop", "-l", help="Begin again at the end, until Ctrl-C.", **_time)
    ] = False
    start_offset: StartOffsetOption = 0.0
    playback_duration: SpanOption = None
    delay: Annotated[
        float,
        seconds(
            "--delay", "-d", help=r"Wait before the start \[s]; latched topics are there.", **_time
        ),
    ] = 0.0
    start_paused: Annotated[
        bool, flag("--start-paused", "-p", help="Start paused; latched topics are there.", **_time)
    ] = False
    clock: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1000.0,
            metavar="[HZ]",
            help=r"Rate of /clock \[Hz of wall time]; 0 = no clock. The recorded one is left out.",
            **_time,
        ),
    ] = DEFAULT_CLOCK_HZ
    topics: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TOPIC...",
            help="Only these topics, such as /r1/odom or '*/odom'; '*' is one part of a name.",
            **_topics,
        ),
    ] = None
    regex: RegexOption = ""
    exclude_regex: ExcludeRegexOption = ""
    exclude_topics: ExcludeTopicsOption = None
    remap: Annotated[
        list[str] | None,
        typer.Option(
            "--remap",
            "-m",
            metavar="/OLD:=/NEW...",
            help="Rename a topic, or all topics below a name; frames keep their names.",
            **_topics,
        ),
    ] = None
    namespace: Annotated[
        str,
        typer.Option(metavar="NAME", help="Put this before all names, such as replay.", **_topics),
    ] = ""
    force: Annotated[
        bool,
        flag("--force", help="Publish also where a world, replay or node publishes.", **_topics),
    ] = False
    disable_keyboard_controls: Annotated[
        bool, flag("--disable-keyboard-controls", help="Read no keys from the terminal.")
    ] = False
    connect: ConnectOption = ""
    world_name: WorldNameOption = ""
    as_json: JsonOption = False


@app.command(
    cls=ReplayCommand,
    epilog="""Examples:
  zensim replay run.mcap
  zensim replay run --rate 2 --loop --start-offset 30
  zensim replay run.mcap --topics /r1/odom /tf --remap /r1:=/ghost
  zensim replay run.mcap --namespace replay

Keys: space pauses, right publishes the next message, up and down change the rate by 10 %,
left goes back 5 s.""",
)
def replay(given: ReplayOptions) -> None:
    """Publish the messages of a recording again, with a clock, until its end."""
    with exit_on_failure("replay"):
        settings = make_replay_settings(given)
        reader = open_recording("replay", given.path)
        names = ReplayedNames(make_name_settings(given), reader.topics)
        note_left_out(names)
        stop = StopFlag(is_armed=False)
        with open_replay_bus(given.connect) as bus:
            if not given.force:
                clocks = [names.clock_key, CLOCK.key(names.world)] if given.clock else []
                wanted = [*names.keys.values(), *clocks]
                require_unused(bus, wanted, names.world, given.ros.domain)
            stop.arm()
            replayer = run_program(bus, given, reader, names, settings, stop)
        print_end(given, replayer, reader)


def note_left_out(names: ReplayedNames) -> None:
    """Name the topics that cannot be published, and rules without effect."""
    if names.left_out:
        shown = ", ".join(repr(one[:60]) for one in names.left_out[:MAX_NAMES_SHOWN])
        print_note("replay", f"{len(names.left_out)} names are not of topics, left out: {shown}")
    if names.unused_rules:
        unused = ", ".join(f"/{one}" for one in sorted(names.unused_rules)[:MAX_NAMES_SHOWN])
        print_note("replay", f"no chosen topic begins with {unused} of --remap")


def make_replay_settings(given: ReplayOptions) -> ReplaySettings:
    """Make the settings of the options.

    Raises:
        ValueError: The duration is not more than 0.
    """
    start_ns, end_ns = find_span("--playback-duration", given.start_offset, given.playback_duration)
    return ReplaySettings(
        start_ns=start_ns,
        end_ns=end_ns,
        rate=given.rate,
        is_paused=given.start_paused,
        is_loop=given.loop,
        clock_hz=given.clock,
        delay_s=given.delay,
    )


def make_name_settings(given: ReplayOptions) -> NameSettings:
    """Make the settings of names of the options."""
    return NameSettings(
        selection=TopicSelection(
            topics=tuple(given.topics or ()),
            regex=given.regex,
            exclude_regex=given.exclude_regex,
            exclude_topics=tuple(given.exclude_topics or ()),
        ),
        remaps=tuple(given.remap or ()),
        namespace=given.namespace,
        world=given.world_name,
    )


@contextmanager
def open_replay_bus(connect: str) -> Iterator[Bus]:
    """Open a session; where no router runs and none is named, this process is the router.

    Raises:
        BusError: The router that is named does not reply.
    """
    given = (connect,) if connect else ()
    try:
        bus = open_bus(BusConfig(connect=given, open_timeout_s=OPEN_TIMEOUT_S))
    except EndpointUnreachable:
        if connect:
            raise
        bus = open_bus(BusConfig(mode="router", listen=(DEFAULT_ENDPOINT,)))
        print_note("replay", f"no router runs, so this replay is one, at {DEFAULT_ENDPOINT}")
    with bus:
        yield bus


def run_program(
    bus: Bus,
    given: ReplayOptions,
    reader: RecordingReader,
    names: ReplayedNames,
    settings: ReplaySettings,
    stop: StopFlag,
) -> Replayer:
    """Declare topics and services, and replay."""
    step_ns = reader.metadata.get("zensim", {}).get("step_ns", "")
    timeline = ReplayTimeline(reader.runs, names.accepts)
    with open_graph(bus, given.ros) as graph, closing(bus.token(keys.alive_replay(names.world))):
        topics = make_topic_factory(bus, graph, "", NODE)
        steps = int(step_ns) if step_ns.isdecimal() else 0
        publishers = ReplayPublishers(bus, topics, names, steps)
        facts = {"replaying": str(given.path), "world": names.world, "topics": len(names.keys)}
        text = f"replaying {len(names.keys)} topics of {given.path}"
        print_announcement("replay", text, facts, as_json=given.as_json)
        publishers.prepare()
        # The reply follows the declarations of subscribers that the router sends.
        bus.list_tokens(keys.alive_replay(names.world))
        time.sleep(MATCH_S)
        replayer = Replayer(timeline, publishers, settings)
        requests = ReplayRequests(bus, names.world, replayer)
        with closing(requests), open_wait(given, replayer, settings, stop) as waiting:
            run_replay(replayer, publishers, requests, waiting)
        time.sleep(SETTLE_S)
        publishers.serve()
    return replayer


@contextmanager
def open_graph(bus: Bus, settings: RosSettings) -> Iterator[RosGraph | None]:
    """Open a ROS 2 graph, unless that is off."""
    if settings.domain is None:
        yield None
        return
    with closing(RosGraph(bus, settings)) as graph:
        yield graph


@contextmanager
def open_wait(
    given: ReplayOptions, replayer: Replayer, settings: ReplaySettings, stop: StopFlag
) -> Iterator[Waiting]:
    """Choose how to wait: for keys, where standard input is a terminal."""
    terminal = None if given.disable_keyboard_controls or given.as_json else find_terminal()
    if terminal is None:
        yield SleepingWait(stop)
        return
    keyboard = ReplayKeyboard(replayer, settings.start_ns)
    with open_terminal_wait(terminal, keyboard, replayer) as waiting:
        yield waiting


def find_terminal() -> RawTerminal | None:
    """Find the terminal; None without one, or where this process is in the background."""
    try:
        return RawTerminal() if sys.stderr.isatty() else None
    except NoTerminal:
        return None


class ReplayFigures(msgspec.Struct, frozen=True, kw_only=True):
    """What was replayed."""

    path: str
    messages: int
    latched: int
    """Messages on latched topics; `messages` counts them, too."""
    wall_s: float
    """Wall time from the first message to the last."""
    position_s: float
    """Position at the end, since the start of the recording."""
    late_p50_s: float
    late_p99_s: float
    """Later than due; 0 at rate 0."""
    damaged: int
    """Number of places of the files that could not be read."""


def print_end(given: ReplayOptions, replayer: Replayer, reader: RecordingReader) -> None:
    """Print what was replayed."""
    figures = ReplayFigures(
        path=str(given.path),
        messages=replayer.published,
        latched=replayer.latched,
        wall_s=round(replayer.wall_s, 3),
        position_s=round(replayer.find_position() / NANOSECONDS, 3),
        late_p50_s=replayer.lateness.quantile_s(0.5),
        late_p99_s=replayer.lateness.quantile_s(0.99),
        damaged=reader.damaged,
    )
    if given.as_json:
        print_lines(msgspec.json.encode(figures).decode())
        return
    note_damage("replay", figures.damaged)
    if not CURRENT.is_quiet:
        print_lines(
            f"{figures.path}: {figures.messages} messages up to {figures.position_s:.2f} s, "
            f"99 % at most {figures.late_p99_s * 1e3:.1f} ms late",
            err=True,
        )
