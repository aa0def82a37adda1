"""Composition root: the world, the journal and the loop of one server process on its network."""

from __future__ import annotations

import gc
import logging
import time
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy.ma  # noqa: F401  # else the first np.unique in the loop imports it: 60 ms

from zensim.proto import keys
from zensim.proto.json_logs import CONTEXT
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.ros2.node_services import NodeParameter, NodeParameters, ParameterContent
from zensim.proto.served_status import served_status
from zensim.proto.settings.setting import read_settings
from zensim.sim_server.initial_world import load_initial_world, make_initial_world, make_parts
from zensim.sim_server.journal.server_journal import open_journal
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.parser_process.mesh_server import MeshServer, PublishedFiles
from zensim.sim_server.parser_process.parser_client import ParserClient
from zensim.sim_server.physics.engine_config import choose_engine, find_installed_engines
from zensim.sim_server.ros2_node.server_node import start_server_node
from zensim.sim_server.runtime.loop import ServerLoop
from zensim.sim_server.runtime.loop_channels import BusInbox, BusWorldPublisher
from zensim.sim_server.runtime.memory_trimmer import MemoryTrimmer
from zensim.sim_server.runtime.node_answers import NodeAnswers
from zensim.sim_server.runtime.server_metrics import ServerMetrics
from zensim.sim_server.runtime.step_topics import StepTopics
from zensim.sim_server.runtime.time_slice import request_short_time_slice
from zensim.sim_server.security.admitted_users import AdmittedUsers
from zensim.sim_server.security.secure_folder import SecureFolder
from zensim.sim_server.server_config import ConfigError, ServerConfig
from zensim.sim_server.world_loading.world_loader import LoadedWorld, make_world_engine

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from zensim.proto.bus.bus_session import Bus
    from zensim.proto.network_protocols import ServiceCallSource
    from zensim.proto.program_status import ProgramStatus
    from zensim.proto.rosout import LogCollector
    from zensim.proto.stop_signal import StopFlag
    from zensim.sim_server.journal.restore_progress import RestoreProgress
    from zensim.sim_server.journal.server_journal import ChangeTracker, Journal
    from zensim.sim_server.server_network import RestoringNetwork
    from zensim.sim_server.service_parts import ServerParts

LOG = logging.getLogger(__name__)
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
    """What a running server calls, where it notes its status, and what was there before it."""

    stop: StopFlag
    on_ready: Callable[[Bus, ServerConfig], None]
    status: ProgramStatus
    network: RestoringNetwork
    collector: LogCollector


def serve_world(config: ServerConfig, hooks: ServerHooks, cleanup: ExitStack) -> None:
    """Make the world, or restore it, and run its loop.

    Args:
        config: Valid, of a world that no other server has.
        hooks: Of the process.
        cleanup: Closes at its end what is opened here.

    Raises:
        ConfigError: A part of the configuration cannot be used.
        WorldAlreadyServed: Another server has this world.
        BusError: The network is not available.
        JournalError: The journal cannot be used.
    """
    network, status = hooks.network, hooks.status
    journal = _open_journal(config, network.progress, cleanup)
    loaded, config = load_initial_world(config, journal)
    if journal is not None:
        _exclude_crashing(journal, config, loaded)
        status.phase = "restoring"
    cleanup.enter_context(served_status(config.metrics, status))
    bus = network.open(is_restoring=journal is not None and journal.contents is not None)
    made = _make_parts(config, loaded, journal, cleanup, hooks.stop)
    _run(config, made, bus, hooks)


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
    physics = config.settings.physics.limit_workers(0)
    settings = msgspec.structs.replace(config.settings, physics=physics)
    return msgspec.structs.replace(config, settings=settings)


def list_server_parameters(config: ServerConfig) -> tuple[NodeParameter, ...]:
    """List the parameters of the server's ROS 2 node."""
    pace: dict[str, Any] = read_settings(config.settings.pace)
    found: dict[str, ParameterContent] = {
        "world": config.world_name,
        "world_file": config.settings.start.world,
        **{name: value for name, value in pace.items() if name != "rtf"},
        "engine": config.settings.physics.engine or "",
        "seed": config.settings.start.seed,
    }
    return tuple(
        NodeParameter(name, value, reason="it is an option of 'zensim serve'")
        for name, value in found.items()
    )


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
            f"`mesh_http` {config.mesh_http} cannot be used: {error.strerror}; use another port, "
            "or 0 for any free one"
        ) from error
    cleanup.callback(server.close)
    return server.files


def _run(
    config: ServerConfig,
    made: tuple[ServerParts, ChangeTracker | None],
    bus: Bus,
    hooks: ServerHooks,
) -> None:
    _start_garbage_collection()
    request_short_time_slice()
    parts, tracker = made
    with ExitStack() as cleanup:
        answers, parameters = _offer_lockstep(config, parts, bus)
        CONTEXT.read_time_ns = read_time_ns = lambda: parts.world.clock.time_ns
        node = start_server_node(bus, config.ros, read_time_ns, parameters, hooks.collector)
        cleanup.callback(node.close)
        users = None
        if config.secure_folder:
            users = AdmittedUsers(SecureFolder(Path(config.secure_folder)), bus, config.world_name)
            cleanup.callback(users.close)
        inbox = _make_inbox(config, bus, node.sources, hooks)
        publisher = BusWorldPublisher(bus, config.world_name, node.topics, node.on_progress)
        status = hooks.status
        loop = ServerLoop(parts, inbox, publisher, HostClock(), tracker, users)
        loop.status, loop.node_answers = status, answers
        engine = choose_engine(config.settings.physics, find_installed_engines())
        metrics = ServerMetrics(parts, engine, loop.request_counts, tracker, config.journal)
        status.sources += [metrics.list_metrics, bus.traffic.list_metrics]
        cleanup.callback(loop.close)
        cleanup.callback(bus.token(keys.alive_server(config.world_name)).close)
        trimmer = MemoryTrimmer()
        trimmer.start()
        cleanup.callback(trimmer.close)
        LOG.info("serving world=%s endpoint=%s", config.world_name, bus.endpoint)
        hooks.on_ready(bus, config)
        loop.run(hooks.stop)
        loop.drain(lambda: hooks.stop.is_urgent)


def _offer_lockstep(
    config: ServerConfig, parts: ServerParts, bus: Bus
) -> tuple[NodeAnswers | None, NodeParameters]:
    """Let ROS nodes set parameters by which time waits for them, if there is ROS."""
    own = list_server_parameters(config)
    if config.ros.domain is None:
        return None, NodeParameters(lambda: own)
    answers = NodeAnswers(parts, bus, config.ros.domain)
    return answers, NodeParameters(lambda: (*own, *answers.list_parameters()), answers.change)


def _make_inbox(
    config: ServerConfig, bus: Bus, sources: Sequence[ServiceCallSource], hooks: ServerHooks
) -> BusInbox:
    """Declare what the loop receives; take over the services of a restore."""
    replies = hooks.network.replies
    if replies is not None:
        replies.close()
    return BusInbox(
        bus,
        config.world_name,
        (*sources, StepTopics(bus, config.world_name)),
        is_secured=bool(config.secure_folder),
        declared=replies,
    )


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
