"""`zensim record`: write the topics of a world to MCAP files, with the options of rosbag2."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, get_args

import msgspec
import typer

from zensim.deploy.cli.recording_options import (
    FILES_PANEL,
    TOPICS_PANEL,
    ExcludeRegexOption,
    ExcludeTopicsOption,
    MaxBagDurationOption,
    MaxBagSizeOption,
    RegexOption,
    StorageProfileOption,
    TopicListCommand,
)
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus, receive_in_one_thread
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.json_logs import CONTEXT
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.messages.telemetry_messages import EventKind
from zensim.proto.metric_families import MetricFamily, make_counter, make_gauge, make_labelled
from zensim.proto.names import check_name
from zensim.proto.options.command_options import (
    ConnectionOptions,
    JsonOption,
    LogFormatOption,
    QuietOption,
    RosDomainOption,
    VerboseOption,
    flag,
    parse_choice,
    seconds,
)
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.process_memory import limit_malloc_arenas
from zensim.proto.program_status import CLIENT_TURN_S, ProgramStatus, make_program_status
from zensim.proto.ros2.rmw_keys import parse_domain
from zensim.proto.security.role_checks import require_role
from zensim.proto.security.roles import Operation, User
from zensim.proto.served_status import served_status
from zensim.proto.settings.operation_settings import USUAL_METRICS, MetricsSettings
from zensim.proto.stop_signal import StopFlag
from zensim.proto.topic_catalog import CLOCK
from zensim.proto.verbosity import (
    CURRENT,
    configure_logging,
    print_announcement,
    print_note,
    set_verbosity,
)
from zensim.recording.byte_sizes import parse_size
from zensim.recording.entity_files import EntityFiles
from zensim.recording.fleet_robots import has_large_fleet
from zensim.recording.mcap_writer import DEFAULT_PRESET, PRESETS
from zensim.recording.recorder import MakeFleet, Recorder, RecorderSettings, TimeBase
from zensim.recording.recording_parts import PartSettings
from zensim.recording.recording_session import (
    REPORT_PERIOD_S,
    RecordingFigures,
    RecordingSession,
    SessionSettings,
    make_start,
)
from zensim.recording.topic_selection import TopicFilter, TopicSelection, list_keys

app = make_app()

SECONDS_OF_UNIT = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
PARTS_KEPT = 10
"""Number of files of `--keep-last`, if no size or duration is given."""
TIME_BASES: tuple[TimeBase, ...] = get_args(TimeBase)
STORAGES = ("mcap",)
OPEN_TIMEOUT_S = 2.0
SNAPSHOT_S = 30.0
MAX_NAMES_SHOWN = 5

_topics = {"rich_help_panel": TOPICS_PANEL}
_files = {"rich_help_panel": FILES_PANEL}
_snapshots = {"rich_help_panel": "Snapshots"}


@dataclass(frozen=True, kw_only=True)
class RecordOptions(ConnectionOptions):
    """All options of `zensim record`."""

    topics: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[TOPIC]...",
            help="Topics, such as r1/odom or '*/odom'; '*' is one part of a name, '**' any number.",
        ),
    ] = None
    named_topics: Annotated[
        list[str] | None,
        typer.Option(
            "--topics", metavar="TOPIC...", help="Topics, as the option of rosbag2.", **_topics
        ),
    ] = None
    all_topics: Annotated[
        bool,
        flag("--all", "-a", help="All topics of robots, and clock, events, stats, map.", **_topics),
    ] = False
    regex: RegexOption = ""
    exclude_regex: ExcludeRegexOption = ""
    exclude_topics: ExcludeTopicsOption = None
    topic_types: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TYPE...", help="Topics of types, such as sensor_msgs/msg/LaserScan.", **_topics
        ),
    ] = None
    exclude_topic_types: Annotated[
        list[str] | None,
        typer.Option(metavar="TYPE...", help="Leave out topics of these types.", **_topics),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FOLDER|FILE.mcap",
            help="New folder with metadata.yaml as of rosbag2, or one file.",
            show_default="zensim_ and the time of day",
            **_files,
        ),
    ] = None
    storage: Annotated[
        str, typer.Option("--storage", "-s", metavar="mcap", help="Format of files.", **_files)
    ] = "mcap"
    max_bag_size: MaxBagSizeOption = "0"
    max_bag_duration: MaxBagDurationOption = 0.0
    storage_preset_profile: StorageProfileOption = DEFAULT_PRESET
    keep_last: Annotated[
        str,
        typer.Option(
            metavar="TIME",
            help="Delete files as soon as later ones have this log time, such as 10min or 2h.",
            show_default="all are kept",
            **_files,
        ),
    ] = ""
    max_cache_size: Annotated[
        str,
        typer.Option(
            metavar="BYTES",
            help="Memory for messages that wait for the disk, or for the snapshot.",
            **_files,
        ),
    ] = "100MiB"
    min_free: Annotated[
        str,
        typer.Option(
            metavar="BYTES", help="End the recording before the disk has less than this.", **_files
        ),
    ] = "256MiB"
    sync: Annotated[
        bool, flag("--sync", help="Wait until each chunk is on the disk.", **_files)
    ] = False
    resume: Annotated[
        bool,
        flag(
            "--resume",
            help="Continue a recording that was cut off: its files stay, the next one follows.",
            **_files,
        ),
    ] = False
    custom_data: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=TEXT", help="Keep a text with the recording; may be repeated.", **_files
        ),
    ] = None
    rate: Annotated[
        float,
        typer.Option(
            min=0.0,
            metavar="HZ",
            help="Keep the newest message of each topic in each period; 0 = all.",
            **_topics,
        ),
    ] = 0.0
    duration: Annotated[
        float,
        typer.Option(metavar="SECONDS", help=r"End after this wall time \[s]; 0 = at Ctrl-C."),
    ] = 0.0
    log_time: Annotated[
        str,
        typer.Option(
            metavar="simulation|wall",
            help="Times by which players pace: stamps of messages, or when they were received.",
        ),
    ] = "simulation"
    use_sim_time: Annotated[
        bool, flag("--use-sim-time", help="Same as --log-time simulation, the default.")
    ] = False
    reproducible: Annotated[
        bool,
        flag(
            "--reproducible",
            help="Equal files of equal runs in lockstep, without what is paced by wall time.",
        ),
    ] = False
    snapshot_mode: Annotated[
        bool,
        flag(
            "--snapshot-mode",
            "--snapshot",
            help="Keep messages in memory, and write them at SIGUSR1 or --snapshot-on.",
            **_snapshots,
        ),
    ] = False
    snapshot_duration: Annotated[
        float | None,
        seconds(
            help=r"Log time that is kept \[s]; 0 = as much as fits.",
            show_default="30",
            **_snapshots,
        ),
    ] = None
    snapshot_on: Annotated[
        str,
        typer.Option(
            metavar="EVENTS",
            help="Kinds of events at which the snapshot is written, such as touched,warning.",
            **_snapshots,
        ),
    ] = ""
    ros_domain: RosDomainOption = "0"
    operation: MetricsSettings = USUAL_METRICS
    as_json: JsonOption = False
    quiet: QuietOption = False
    verbose: VerboseOption = False
    log_format: LogFormatOption = ""


@app.command(
    cls=TopicListCommand,
    epilog="""Examples:
  zensim record --all --output run.mcap
  zensim record '*/odom' '*/scan' --output run --max-bag-size 500MB
  zensim record --all --snapshot-mode --snapshot-duration 20 --snapshot-on touched""",
)
def record(given: RecordOptions) -> None:
    """Record topics to MCAP files, until Ctrl-C or for a duration."""
    record_topics(given)


def record_topics(given: RecordOptions) -> None:
    """Record as the options say."""
    with exit_on_failure("record"):
        set_verbosity(
            is_quiet=given.quiet,
            is_verbose=given.verbose,
            is_json=given.as_json,
            log_format=given.log_format,
        )
        configure_logging()
        parse_choice("--storage", given.storage, STORAGES)
        chosen = TopicFilter(make_selection(given))
        settings = make_session_settings(given)
        recorder_settings = make_recorder_settings(given)
        status = make_program_status(given.world_name, CLIENT_TURN_S)
        CONTEXT.world = given.world_name
        stop = StopFlag(is_armed=False, on_stop=status.drain)
        limit_malloc_arenas()
        receive_in_one_thread()
        connect = (given.connect,) if given.connect else ()
        config = BusConfig(connect=connect, open_timeout_s=OPEN_TIMEOUT_S)
        with (
            served_status(given.operation.choose_metrics("zensim record"), status),
            open_bus(config) as bus,
        ):
            stop.arm()
            program = RecordProgram(bus, chosen, recorder_settings, settings)
            program.status = status
            status.sources += [program.list_metrics, bus.traffic.list_metrics]
            path = str(settings.parts.path)
            print_announcement(
                "record", f"recording to {path}", {"recording": path}, as_json=given.as_json
            )
            failure = program.run(stop, given.duration)
        program.print_end(as_json=given.as_json)
        if failure is not None:
            reason = f"{failure.strerror or failure}; what was recorded before is readable"
            raise OSError(failure.errno, reason, str(settings.parts.path)) from failure


def make_recorder_settings(given: RecordOptions) -> RecorderSettings:
    """Make the settings of a recorder.

    Raises:
        ValueError: A name, a domain or a clock is not valid.
    """
    return RecorderSettings(
        world=check_name(given.world_name, "world name"),
        domain=parse_domain(given.ros_domain),
        time_base=choose_time_base(given),
        period_ns=round(NANOSECONDS / given.rate) if given.rate else 0,
        is_reproducible=given.reproducible,
    )


def choose_time_base(given: RecordOptions) -> TimeBase:
    """Choose the clock of log times.

    Raises:
        ValueError: It is not known, or two are given.
    """
    chosen = parse_choice("--log-time", given.log_time, TIME_BASES)
    if given.use_sim_time and chosen == "wall":
        raise ValueError("--use-sim-time and --log-time wall exclude each other; give one of them")
    if given.reproducible and (chosen == "wall" or given.snapshot_mode):
        raise ValueError("--reproducible excludes --log-time wall and --snapshot-mode")
    return chosen


def make_selection(given: RecordOptions) -> TopicSelection:
    """Make the selection of the options."""
    return TopicSelection(
        topics=(*(given.topics or ()), *(given.named_topics or ())),
        wants_all=given.all_topics,
        regex=given.regex,
        exclude_regex=given.exclude_regex,
        exclude_topics=tuple(given.exclude_topics or ()),
        types=tuple(given.topic_types or ()),
        exclude_types=tuple(given.exclude_topic_types or ()),
    )


def make_session_settings(given: RecordOptions) -> SessionSettings:
    """Make the settings of the options.

    Raises:
        ValueError: A size or a kind of event is not valid.
    """
    kinds = tuple(filter(None, (one.strip() for one in given.snapshot_on.split(","))))
    for kind in kinds:
        parse_choice("--snapshot-on", kind, get_args(EventKind))
    if (kinds or given.snapshot_duration is not None) and not given.snapshot_mode:
        raise ValueError("--snapshot-on and --snapshot-duration need --snapshot-mode; add it")
    kept_s = SNAPSHOT_S if given.snapshot_duration is None else given.snapshot_duration
    keep_ns = round(parse_time("--keep-last", given.keep_last) * NANOSECONDS)
    max_bytes = parse_size("--max-bag-size", given.max_bag_size)
    max_duration_ns = round(given.max_bag_duration * NANOSECONDS)
    if keep_ns and not (max_bytes or max_duration_ns):
        max_duration_ns = keep_ns // PARTS_KEPT
    preset = parse_choice("--storage-preset-profile", given.storage_preset_profile, tuple(PRESETS))
    output = given.output or Path(datetime.now().strftime("zensim_%Y_%m_%d-%H_%M_%S"))
    return SessionSettings(
        parts=PartSettings(
            path=output,
            max_bytes=max_bytes,
            max_duration_ns=max_duration_ns,
            min_free_bytes=parse_size("--min-free", given.min_free),
            is_synchronous=given.sync,
            keep_ns=keep_ns,
            chunks=PRESETS[preset],
            custom_data=tuple(map(parse_pair, given.custom_data or ())),
            is_reproducible=given.reproducible,
            continues=given.resume,
        ),
        max_cache_bytes=parse_size("--max-cache-size", given.max_cache_size),
        is_snapshot=given.snapshot_mode,
        snapshot_ns=round(kept_s * NANOSECONDS),
        snapshot_on=frozenset(kinds),
    )


def parse_pair(text: str) -> tuple[str, str]:
    """Read a name and a text, such as `operator=ann`.

    Raises:
        ValueError: It has no name.
    """
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise ValueError(f"--custom-data {text[:60]!r} is no pair; use NAME=TEXT")
    return name, value


def parse_time(option: str, text: str) -> float:
    """Read a time, such as `90`, `30s`, `10min` or `2h`; empty is 0 [s].

    Raises:
        ValueError: It is not one.
    """
    if not text:
        return 0.0
    digits = text.strip().rstrip("smihn")
    unit = SECONDS_OF_UNIT.get(text.strip()[len(digits) :])
    try:
        number = float(digits)
    except ValueError:
        number = 0.0
    if unit is None or not 0 < number < 1e9:  # noqa: PLR2004
        raise ValueError(f"{option} {text[:40]!r} is not a time; use seconds, or 30s, 10min, 2h")
    return number * unit


def choose_fleet(bus: Bus, settings: RecorderSettings) -> MakeFleet | None:
    """Choose whether odometry of many robots is taken from their agents; None if it is not."""
    is_thinned = settings.period_ns and not settings.is_reproducible
    if not is_thinned or not has_large_fleet(bus, settings.world):
        return None
    # numpy takes 0.1 s and 13 MB to load.
    from zensim.recording.fleet_messages import FleetMessages

    return partial(FleetMessages, bus, settings.world)


class RecordProgram:
    """The loop of `zensim record`."""

    def __init__(
        self,
        bus: Bus,
        chosen: TopicFilter,
        recorder_settings: RecorderSettings,
        settings: SessionSettings,
    ) -> None:
        """Subscribe, and create the first file.

        Raises:
            OSError: It exists, or cannot be created.
            BusError, ServiceError: No server replies, or the role may not read what is chosen.
        """
        self._bus = bus
        self._path = settings.parts.path
        self._start = make_start(bus, recorder_settings)
        info, world = self._start.info, recorder_settings.world
        user = User(bus.user, info.role)
        require_role(user, world, Operation.QUERY, CLOCK.key(world))
        wanted = list_keys(chosen, world, recorder_settings.domain)
        require_role(user, world, Operation.SUBSCRIBE, *wanted)
        recorder_settings = msgspec.structs.replace(recorder_settings, step_ns=info.step_ns)
        self._session = RecordingSession(settings, self._start)
        try:
            make_fleet = choose_fleet(bus, recorder_settings)
            self._recorder = Recorder(bus, chosen, recorder_settings, self._session, make_fleet)
        except BaseException:
            self._session.discard()
            raise
        self._files = EntityFiles(
            bus,
            recorder_settings.world,
            self._session.attach,
            lambda reason: print_note("record", reason),
        )
        self._wants_snapshot = self._is_absence_noted = False
        self.status = ProgramStatus()
        self._figures: RecordingFigures | None = None
        if (user_signal := getattr(signal, "SIGUSR1", None)) is not None:
            signal.signal(user_signal, self._ask_for_snapshot)

    def run(self, should_stop: Callable[[], bool], duration_s: float) -> OSError | None:
        """Record until `should_stop`, or for a duration [s]; return the failure that ended it."""
        with closing(self._recorder):
            try:
                self._files.attach_new(has_arrivals=self._recorder.take_arrivals())
                self._take_until(should_stop, duration_s)
                self._recorder.take(is_last=True)
            finally:
                # Whatever ends the loop, what was recorded is whole.
                self._figures = self._session.close(self._recorder)
        return self._session.failure

    def _take_until(self, should_stop: Callable[[], bool], duration_s: float) -> None:
        session, recorder = self._session, self._recorder
        began_s = time.monotonic()
        report_at_s = began_s + REPORT_PERIOD_S
        while not should_stop() and session.failure is None:
            now_s = time.monotonic()
            self.status.note_turn()
            recorder.take()
            if self._wants_snapshot:
                self._wants_snapshot = False
                print_note("record", f"{session.write_snapshot()} messages in the snapshot")
            if now_s >= report_at_s:
                report_at_s = now_s + REPORT_PERIOD_S
                self._report()
                self._files.attach_new(has_arrivals=recorder.take_arrivals())
            if duration_s and now_s - began_s >= duration_s:
                break
            time.sleep(recorder.take_period_s)

    def list_metrics(self) -> Iterator[MetricFamily]:
        """List the metrics of the recording; another thread calls it."""
        figures = self._session.read_figures(self._recorder)
        yield make_counter(
            "zensim_recorder_messages_total",
            "Messages that were written.",
            figures.messages + figures.deleted,
        )
        yield make_gauge("zensim_recorder_bytes", "Size of the files.", figures.bytes)
        yield make_gauge("zensim_recorder_topics", "Recorded topics.", figures.topics)
        yield make_labelled(
            "zensim_dropped_total",
            "counter",
            "Messages that were not written: before they were taken, and before the disk.",
            {("queue",): figures.missing, ("disk",): figures.lost},
            "where",
        )

    def print_end(self, *, as_json: bool) -> None:
        """Print what was recorded."""
        figures = self._figures
        if figures is None:
            return
        self._note_absence(figures)
        if as_json:
            print_lines(encode_figures(figures, self._path))
            return
        print_lines(f"{self._path}: {format_figures(figures)}", err=True)
        if self._recorder.unknown_topics:
            names = ", ".join(self._recorder.unknown_topics[:MAX_NAMES_SHOWN])
            print_note("record", f"topics of unknown types are left out: {names}")

    def _report(self) -> None:
        figures = self._session.read_figures(self._recorder)
        self._note_absence(figures)
        if not CURRENT.is_quiet:
            print_lines(format_figures(figures), err=True)

    def _note_absence(self, figures: RecordingFigures) -> None:
        if not (self._is_absence_noted or figures.topics or figures.held):
            self._is_absence_noted = True
            what_to_do = "'zensim topic list' lists topics; expressions see them with a leading '/'"
            print_note("record", f"no message of the chosen topics has come; {what_to_do}")

    def _ask_for_snapshot(self, _number: int, _frame: object) -> None:
        self._wants_snapshot = True


def format_figures(figures: RecordingFigures) -> str:
    """Write the counts in one line."""
    lost = f"{figures.lost} lost"
    if figures.overflows:
        lost += f", and about {figures.missing} that came faster than they could be taken"
    if figures.held:
        lost += f"; {figures.held} held for a snapshot"
    return (
        f"{figures.duration_s:.0f} s: {figures.messages} messages, {figures.bytes / 1e6:.1f} MB, "
        f"{figures.topics} topics, {lost}"
    )


def encode_figures(figures: RecordingFigures, path: Path) -> str:
    """Write the counts as JSON."""
    return msgspec.json.encode({"path": str(path), **msgspec.to_builtins(figures)}).decode()
