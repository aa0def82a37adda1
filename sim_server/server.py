"""Composition root: connect the bus, the world, the journal and the loop of one server process."""

from __future__ import annotations

import gc
import logging
import time
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.proto import keys
from zensim.proto.bus import (
    Bus,
    BusConfig,
    NoServer,
    open_bus_with_retry,
)
from zensim.proto.json_logs import CONTEXT
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.messages.telemetry_messages import InfoRequest
from zensim.proto.operation_server import served_status
from zensim.proto.process_limits import limit_malloc_arenas
from zensim.proto.program_status import SERVER_TURN_S, ProgramStatus, make_program_status
from zensim.proto.ros2.node_services import NodeParameter, ParameterContent
from zensim.proto.rosout import LogCollector
from zensim.proto.service_catalog import INFO
from zensim.sim_server.initial_world import load_initial_world, make_initial_world, make_parts
from zensim.sim_server.journal.journal_contents import RestoreProgress
from zensim.sim_server.journal.server_journal import count_restorable, open_journal
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.parser_process.mesh_server import MeshServer, PublishedFiles
from zensim.sim_server.parser_process.parser_client import ParserClient
from zensim.sim_server.physics.engine_config import choose_engine, find_installed_engines
from zensim.sim_server.runtime.loop import ServerLoop, request_short_time_slice
from zensim.sim_server.runtime.loop_channels import BusInbox, BusWorldPublisher
from zensim.sim_server.runtime.memory_trimmer import MemoryTrimmer
from zensim.sim_server.runtime.restore_replies import RestoreReplies
from zensim.sim_server.runtime.server_metrics import ServerMetrics
from zensim.sim_server.runtime.step_topics import StepTopics
from zensim.sim_server.security.admitted_users import AdmittedUsers
from zensim.sim_server.security.secure_folder import SecureFolder
from zensim.sim_server.server_config import (
    ConfigError,
    ServerConfig,
    WorldAlreadyServed,
    validate_config,
)
from zensim.sim_server.world_loading.world_loader import LoadedWorld, make_world_engine

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from zensim.proto.network_protocols import ServiceCallSource
    from zensim.proto.stop_signal import StopFlag
    from zensim.sim_server.journal.server_journal import ChangeTracker, Journal
    from zensim.sim_server.service_parts import ServerParts

LOG = logging.getLogger(__name__)
INFO_TIMEOUT_S = 2.0
PARSER_START_TIMEOUT_S, PARSER_POLL_S = 30.0, 0.005


class HostClock:
    """Monotonic clock of the host."""

    def now_ns(self) -> int:
        """See `LoopClock`."""
        return time.monotonic_ns()

    def used_ns(self) -> int:
        """See `LoopClock`."""
        return time.thread_time_ns()

    def sleep(self, seconds: float) -> None:
        """See `LoopClock`."""
        time.sleep(seconds)


@dataclass(frozen=True)
class ServerHooks:
    """What a running server calls, where it notes its status, and what replied before it."""

    stop: StopFlag
    on_ready: Callable[[Bus, ServerConfig], None]
    status: ProgramStatus
    restore_replies: RestoreReplies | None


def run_server(
    config: ServerConfig,
    stop: StopFlag,
    on_ready: Callable[[Bus, ServerConfig], None],
) -> None:
    """Run a server until a signal stops it; it finishes the requests that it has accepted.

    Raises:
        ConfigError: The configuration is not valid.
        WorldAlreadyServed: Another server has this world.
        BusError: The network is not available.
        JournalError: The journal cannot be used.
    """
    config = msgspec.structs.replace(validate_config(config), requested=config)
    limit_malloc_arenas()
    status = make_program_status(config.world, SERVER_TURN_S)
    CONTEXT.world = config.world
    stop.on_stop = status.drain
    with ExitStack() as cleanup:
        collector = LogCollector()
        if config.ros.domain is not None:
            collector.start()
        cleanup.callback(collector.stop)
        cleanup.enter_context(_no_garbage_collection())
        network = _RestoringNetwork(config, cleanup)
        # A process that tests entities is a fork of this one, which must have no other threads.
        if network.progress.total:
            network.open()
        journal = _open_journal(config, network.progress, cleanup)
        loaded, config = load_initial_world(config, journal)
        if journal is not None:
            _exclude_crashing(journal, config, loaded)
            status.phase = "restoring"
        cleanup.enter_context(served_status(config.metrics, status))
        bus = network.open(is_restoring=journal is not None and journal.contents is not None)
        hooks = ServerHooks(stop, on_ready, status, network.replies)
        made = _make_parts(config, loaded, journal, cleanup, stop)
        _run(config, made, bus, collector, hooks)


class _RestoringNetwork:
    """The network of a server, and replies while its journal is read and restored.

    A large world takes seconds, and to read the journal of 10,000 entities a fifth of one.
    """

    def __init__(self, config: ServerConfig, cleanup: ExitStack) -> None:
        self.progress = RestoreProgress(total=count_restorable(config.journal))
        self.replies: RestoreReplies | None = None
        self._config = config
        self._cleanup = cleanup
        self._bus: Bus | None = None

    def open(self, *, is_restoring: bool = True) -> Bus:
        """Open it if it is not open; reply if there is something to restore."""
        config, cleanup = self._config, self._cleanup
        if self._bus is None:
            self._bus = _open_network(config, cleanup)
        if is_restoring and self.replies is None:
            is_secured = bool(config.secure_folder)
            replies = RestoreReplies(self._bus, config.world, self.progress, is_secured=is_secured)
            replies.start()
            cleanup.callback(replies.close)
            self.replies = replies
        return self._bus


def _open_journal(
    config: ServerConfig, progress: RestoreProgress, cleanup: ExitStack
) -> Journal | None:
    """Open the journal that is configured, until the end."""
    if not config.journal:
        return None
    journal = open_journal(config.journal)
    cleanup.callback(journal.close)
    journal.progress = progress
    if journal.contents is not None:
        progress.total = len(journal.contents.entities)
    return journal


def _exclude_crashing(journal: Journal, config: ServerConfig, loaded: LoadedWorld) -> None:
    """Set aside entities of a journal with which an engine crashes."""
    files = str(journal.files)
    journal.exclude_crashing(
        partial(make_world_engine, _in_one_process(config), loaded.model, files)
    )


def _in_one_process(config: ServerConfig) -> ServerConfig:
    """Make no workers: what ends one must end the process that tests it."""
    physics = msgspec.structs.replace(config.physics, workers=0)
    return msgspec.structs.replace(config, physics=physics)


def _open_network(config: ServerConfig, cleanup: ExitStack) -> Bus:
    bus = cleanup.enter_context(open_bus_with_retry(config.bus or BusConfig(), config.wait_s))
    # A secured server has a router of its own.
    if not config.secure_folder and _has_server(bus, config.world):
        raise WorldAlreadyServed(
            f"world '{config.world}' already has a server at {bus.endpoint}; "
            "stop it, or use --world-name with another"
        )
    bus.prepare_reply_threads(request_short_time_slice)
    return bus


def list_server_parameters(config: ServerConfig) -> tuple[NodeParameter, ...]:
    """List the parameters of the server's ROS 2 node."""
    found: dict[str, ParameterContent] = {
        "world": config.world,
        "world_file": config.world_file,
        "engine": config.physics.engine or "",
        "step_hz": NANOSECONDS / config.step_ns,
        "control_hz": config.control_hz,
        "seed": config.seed,
    }
    return tuple(
        NodeParameter(name, value, reason="it is an option of 'zensim serve'")
        for name, value in found.items()
    )


def _has_server(bus: Bus, world: str) -> bool:
    """Whether another server serves the world; our own new router has no other server."""
    if bus.config.mode == "router":
        return False
    try:
        bus.call(INFO, InfoRequest(), world=world, timeout_s=INFO_TIMEOUT_S)
    except NoServer:
        return bool(bus.list_tokens(keys.alive_server(world)))
    except TimeoutError:
        return True
    return True


def _make_parts(
    config: ServerConfig,
    loaded: LoadedWorld,
    journal: Journal | None,
    cleanup: ExitStack,
    should_stop: Callable[[], bool],
) -> tuple[ServerParts, ChangeTracker | None]:
    """Make the world, and what its services act on; both need no network."""
    clock = HostClock()
    store = AssetStore(folder=None if journal is None else journal.assets)
    cleanup.callback(store.close)
    make_world = partial(make_initial_world, config, loaded, store, journal)
    is_restored = journal is not None and journal.contents is not None
    # A restore needs all cores: its parser starts later, any other beside the making of the world.
    world = cleanup.enter_context(closing(make_world())) if is_restored else None
    parser = cleanup.enter_context(closing(ParserClient(store, clock.now_ns)))
    if world is None:
        world = cleanup.enter_context(closing(make_world()))
    parts = make_parts(config, loaded, world, parser, store=store, now_ns=clock.now_ns)
    if config.mesh_http:
        parts.descriptions.published = _offer_meshes(config, store, cleanup)
    tracker = None if journal is None else journal.record(parts)
    if tracker is not None:
        cleanup.callback(tracker.close)
    if not is_restored:
        _wait_for_parser(parser, clock, should_stop)
    return parts, tracker


def _offer_meshes(config: ServerConfig, store: AssetStore, cleanup: ExitStack) -> PublishedFiles:
    try:
        server = MeshServer(config.mesh_http, store.folder, has_secret=bool(config.secure_folder))
    except OSError as error:
        raise ConfigError(
            f"--mesh-http {config.mesh_http} cannot be used: {error.strerror}; use another port, "
            "or 0 for any free one"
        ) from error
    cleanup.callback(server.close)
    return server.files


def _run(
    config: ServerConfig,
    made: tuple[ServerParts, ChangeTracker | None],
    bus: Bus,
    collector: LogCollector,
    hooks: ServerHooks,
) -> None:
    # Imported here: replies during a restore need neither.
    import numpy.ma  # noqa: F401  # else the first np.unique in the loop imports it: 60 ms

    from zensim.sim_server.ros2_node.server_node import start_server_node

    _start_garbage_collection()
    request_short_time_slice()
    parts, tracker = made
    with ExitStack() as cleanup:
        node = start_server_node(bus, config.ros, list_server_parameters(config), collector)
        cleanup.callback(node.close)
        users = None
        if config.secure_folder:
            users = AdmittedUsers(SecureFolder(Path(config.secure_folder)), bus, config.world)
            cleanup.callback(users.close)
        inbox = _make_inbox(config, bus, node.sources, hooks)
        publisher = BusWorldPublisher(bus, config.world, node.topics, node.on_progress)
        status = hooks.status
        loop = ServerLoop(parts, inbox, publisher, HostClock(), tracker, users)
        loop.status = status
        CONTEXT.read_time_ns = lambda: parts.world.clock.time_ns
        engine = choose_engine(config.physics, find_installed_engines())
        metrics = ServerMetrics(parts, engine, loop.request_counts, tracker, config.journal)
        status.sources += [metrics.list_metrics, bus.traffic.list_metrics]
        cleanup.callback(loop.close)
        cleanup.callback(bus.token(keys.alive_server(config.world)).close)
        trimmer = MemoryTrimmer()
        trimmer.start()
        cleanup.callback(trimmer.close)
        LOG.info("serving world=%s endpoint=%s", config.world, bus.endpoint)
        hooks.on_ready(bus, config)
        loop.run(hooks.stop)
        loop.drain(lambda: hooks.stop.is_urgent)


def _make_inbox(
    config: ServerConfig, bus: Bus, sources: Sequence[ServiceCallSource], hooks: ServerHooks
) -> BusInbox:
    """Declare what the loop receives; take over the services of a restore."""
    if hooks.restore_replies is not None:
        hooks.restore_replies.close()
    return BusInbox(
        bus,
        config.world,
        (*sources, StepTopics(bus, config.world)),
        is_secured=bool(config.secure_folder),
        declared=hooks.restore_replies,
    )


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Disable garbage collection: the objects of a start stay, and it takes a fifth of its time."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def _start_garbage_collection() -> None:
    """Collect garbage from now on, except present objects, which would delay steps."""
    gc.collect()
    gc.freeze()
    gc.enable()


def _wait_for_parser(
    parser: ParserClient, clock: HostClock, should_stop: Callable[[], bool]
) -> None:
    """Wait until the parser process is ready, so that the first spawn does not wait for it."""
    timeout_ns = clock.now_ns() + round(PARSER_START_TIMEOUT_S * NANOSECONDS)
    while not (parser.is_ready or should_stop() or clock.now_ns() > timeout_ns):
        parser.poll()
        clock.sleep(PARSER_POLL_S)
