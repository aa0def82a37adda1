"""Command line of the server: `zensim serve`."""

import sys
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Annotated

import msgspec
import typer

from zensim.proto.bus.bus_errors import BusError
from zensim.proto.bus.bus_session import Bus
from zensim.proto.endpoints import check_exposure, to_client_endpoint, with_free_port
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.names import check_name
from zensim.proto.options.command_options import JsonOption, RosOptions, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.options.option_sources import find_unused_endpoint
from zensim.proto.printable_text import print_lines
from zensim.proto.security.roles import User
from zensim.proto.settings.deployment_settings import USUAL
from zensim.proto.settings.network_settings import NetworkSettings
from zensim.proto.settings.operation_settings import OperationSettings
from zensim.proto.settings.server_settings import ServerSettings
from zensim.proto.stop_signal import StopFlag
from zensim.proto.supervisor import ProgramDied
from zensim.proto.verbosity import configure_logging, print_announcement, print_note
from zensim.sim_server.physics.engine_config import (
    choose_engine,
    explain_default,
    find_installed_engines,
)
from zensim.sim_server.security.router_process import secured_router
from zensim.sim_server.security.secure_folder import (
    DEFAULT_SECURE_ENDPOINT,
    SecureFolder,
    SecureSettings,
    prepare_secure_folder,
    to_secure_endpoint,
)
from zensim.sim_server.server_config import (
    ConfigError,
    ServerConfig,
    WorldAlreadyServed,
    describe_pace,
    make_server_bus_config,
    to_mesh_endpoint,
)
from zensim.sim_server.server_extra import MissingServerExtra, server_extra

app = make_app()


@dataclass(frozen=True, kw_only=True)
class ServeOptions(RosOptions):
    """All options of `zensim serve`."""

    server: ServerSettings = USUAL.server
    network: NetworkSettings = USUAL.network
    operation: OperationSettings = USUAL.operation
    as_json: JsonOption = False
    announce: Annotated[bool, flag("--announce", hidden=True)] = False
    """Whether a program starts this one: prints as JSON what is served, and failures as text."""


@app.command(
    epilog="""Examples:
  zensim serve
  zensim serve --world warehouse --rtf 0 --paused
  zensim serve --secure --listen tls/0.0.0.0:7447 --journal ./journal"""
)
def serve(context: typer.Context, given: ServeOptions) -> None:
    """Start a simulation server, until Ctrl-C."""
    configure_logging()
    given = replace(given, network=_choose_endpoint(context, given.network))
    stop = StopFlag()
    with exit_on_failure("serve", MissingServerExtra, ProgramDied, BusError), ExitStack() as stack:
        config = _make_server_config(given)
        meshes = (to_mesh_endpoint(config.mesh_http),) if config.mesh_http else ()
        check_exposure(
            "zensim serve",
            (*(config.bus.listen if config.bus else ()), *meshes),
            is_secure=given.network.secure,
            is_insecure=given.network.insecure,
        )
        if given.network.client_certificates and not given.network.secure:
            raise ValueError("--client-certificates needs --secure; add it")
        folder = _prepare_folder(given) if given.network.secure else None
        if folder is not None:
            from zensim.sim_server.server import import_served_world

            router = stack.enter_context(secured_router(folder, "serve"))
            import_served_world()  # while the router starts
            config = msgspec.structs.replace(
                config, bus=router.wait(), secure_folder=str(folder.path)
            )
        _run_server(config, stop, folder=folder, given=given)


def _choose_endpoint(context: typer.Context, network: NetworkSettings) -> NetworkSettings:
    """Choose between an endpoint to listen on and one to connect to, by their sources."""
    unused = find_unused_endpoint(context, "serve")
    return msgspec.structs.replace(network, **{unused: ""}) if unused else network


def _prepare_folder(given: ServeOptions) -> SecureFolder:
    network = given.network
    if network.connect:
        raise ValueError("--secure and --connect exclude each other; a secured server has a router")
    listen = with_free_port(to_secure_endpoint(network.listen or DEFAULT_SECURE_ENDPOINT))
    with server_extra():
        return prepare_secure_folder(
            SecureSettings(
                check_name(network.world_name, "world"),
                given.ros.domain,
                listen,
                network.client_certificates,
            )
        )


def _make_server_config(given: ServeOptions) -> ServerConfig:
    network, operation = given.network, given.operation
    if network.listen and network.connect:
        raise ValueError("--listen and --connect exclude each other; give one of them")
    return ServerConfig(
        bus=make_server_bus_config(network.listen, network.connect),
        world_name=network.world_name,
        settings=given.server,
        wait_s=network.wait,
        journal=str(operation.journal or ""),
        keeps_inputs=operation.input_log,
        ros=given.ros,
        mesh_http=network.mesh_http,
        metrics=operation.choose_metrics("zensim serve", is_insecure=network.insecure),
    )


def _run_server(
    config: ServerConfig, stop: StopFlag, *, folder: SecureFolder | None, given: ServeOptions
) -> None:
    def announce(bus: Bus, config: ServerConfig) -> None:
        installed = find_installed_engines()
        engine = choose_engine(config.settings.physics, installed)
        if reason := explain_default(config.settings.physics, installed):
            print_note("serve", reason)
        endpoint = bus.endpoint if folder is None else folder.settings.endpoint
        secured = ", secured" if folder is not None else ""
        facts: dict[str, object] = {
            "world": config.world_name,
            "endpoint": endpoint,
            "connect": to_client_endpoint(endpoint),
            "engine": engine,
        }
        if folder is not None and given.as_json:
            facts["tokens_file"] = folder.write_all_tokens()
        print_announcement(
            "serve",
            f"world '{config.world_name}' at {endpoint} "
            f"({describe_pace(config)}, {engine}{secured})",
            facts,
            as_json=given.as_json or given.announce,
        )
        if folder is not None and not (given.as_json or given.announce):
            print_users(folder)

    # Imported here, with SQLite: `zensim up` shares the options of this command.
    from zensim.sim_server.journal.sqlite_store import JournalError
    from zensim.sim_server.server import run_server

    with exit_on_failure(
        "serve", ConfigError, WorldAlreadyServed, JournalError, MissingServerExtra
    ):
        run_server(config, stop, announce)


def print_users(folder: SecureFolder) -> None:
    """Print who may join, with the tokens the first time that it is on a terminal."""
    accounts = folder.list_active()
    world = folder.settings.world
    named = "" if world == "default" else f" --world-name {world}"
    if sys.stdout.isatty() and folder.note_first_display():
        print_lines("Join tokens, shown once (each is a password for one person or program):")
        for account in accounts:
            print_lines(
                f"  {_describe_user(account.user):<12} {folder.make_token(account).write()}"
            )
        print_lines("Use: zensim list --join TOKEN; a token for the agent of a robot:")
        print_lines(f"  zensim token create --role agent --robot NAME{named}")
        return
    print_lines(f"Users: {', '.join(_describe_user(account.user) for account in accounts)}")
    print_lines(f"On this host, 'zensim token show USER{named}' prints the join token of one.")


def _describe_user(user: User) -> str:
    return user.name if user.role == user.name else f"{user.name} ({user.role})"
