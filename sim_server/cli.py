"""Command line of the server: `zensim serve`."""

import sys
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from zensim.proto.bus.bus_errors import BusError
from zensim.proto.bus.bus_session import Bus
from zensim.proto.cli_options import (
    ClientCertificatesOption,
    InsecureOption,
    JsonOption,
    MetricsOptions,
    RosOptions,
    SecureOption,
    WorldNameOption,
    expand_options,
    flag,
    is_exported_for_clients,
    make_app,
    takes_precedence,
)
from zensim.proto.endpoints import (
    DEFAULT_ENDPOINT,
    check_exposure,
    to_client_endpoint,
    with_free_port,
)
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.names import check_name
from zensim.proto.printable_text import print_lines
from zensim.proto.security.roles import User
from zensim.proto.settings.server_settings import USUAL_SERVER, ServerSettings
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


_connection = partial(typer.Option, rich_help_panel="Connection")


@dataclass(frozen=True, kw_only=True)
class ServeOptions(RosOptions, MetricsOptions):
    """All options of `zensim serve`."""

    server: ServerSettings = USUAL_SERVER
    journal: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Record changes in this folder, and restore the world that it contains.",
            show_default="no journal",
            envvar="ZENSIM_JOURNAL",
        ),
    ] = None
    input_log: Annotated[
        bool,
        flag("--input-log", help="Keep all inputs from the start for 'zensim record' and 'resim'."),
    ] = False
    as_json: JsonOption = False
    announce: Annotated[bool, flag("--announce", hidden=True)] = False
    """Whether a program starts this one: prints as JSON what is served, and failures as text."""
    listen: Annotated[
        str,
        _connection(
            metavar="ENDPOINT",
            help="Zenoh endpoint to listen on; the server is its own router.",
            show_default=DEFAULT_ENDPOINT,
        ),
    ] = ""
    connect: Annotated[
        str,
        _connection(
            metavar="ENDPOINT",
            help="Connect to this Zenoh router instead of listening.",
            envvar="ZENSIM_CONNECT",
        ),
    ] = ""
    secure: SecureOption = False
    client_certificates: ClientCertificatesOption = False
    insecure: InsecureOption = False
    mesh_http: Annotated[
        str,
        _connection(
            metavar="HOST:PORT",
            help="Offer meshes of robots by http here, and name them so in descriptions for RViz.",
            show_default="descriptions name them as given",
        ),
    ] = ""
    wait: Annotated[
        float,
        _connection(min=0.0, metavar="SECONDS", help=r"Timeout of connecting to the router \[s]."),
    ] = 30.0
    world_name: WorldNameOption = "default"


@app.command(
    epilog="""Examples:
  zensim serve
  zensim serve --world warehouse --rtf 0 --paused
  zensim serve --secure --listen tls/0.0.0.0:7447 --journal ./journal"""
)
@expand_options
def serve(context: typer.Context, given: ServeOptions) -> None:
    """Start a simulation server, until Ctrl-C."""
    configure_logging()
    is_for_clients = is_exported_for_clients(context, "ZENSIM_SERVE_CONNECT")
    if given.listen and (is_for_clients or takes_precedence(context, "listen", over="connect")):
        given = replace(given, connect="")
    elif given.connect and takes_precedence(context, "connect", over="listen"):
        given = replace(given, listen="")
    stop = StopFlag()
    with exit_on_failure("serve", MissingServerExtra, ProgramDied, BusError), ExitStack() as stack:
        config = _make_server_config(given)
        meshes = (to_mesh_endpoint(config.mesh_http),) if config.mesh_http else ()
        check_exposure(
            "zensim serve",
            (*(config.bus.listen if config.bus else ()), *meshes),
            is_secure=given.secure,
            is_insecure=given.insecure,
        )
        if given.client_certificates and not given.secure:
            raise ValueError("--client-certificates needs --secure; add it")
        folder = _prepare_folder(given) if given.secure else None
        if folder is not None:
            from zensim.sim_server.server import import_served_world

            router = stack.enter_context(secured_router(folder, "serve"))
            import_served_world()  # while the router starts
            config = msgspec.structs.replace(
                config, bus=router.wait(), secure_folder=str(folder.path)
            )
        _run_server(config, stop, folder=folder, given=given)


def _prepare_folder(given: ServeOptions) -> SecureFolder:
    if given.connect:
        raise ValueError("--secure and --connect exclude each other; a secured server has a router")
    listen = with_free_port(to_secure_endpoint(given.listen or DEFAULT_SECURE_ENDPOINT))
    with server_extra():
        return prepare_secure_folder(
            SecureSettings(
                check_name(given.world_name, "world"),
                given.ros.domain,
                listen,
                given.client_certificates,
            )
        )


def _make_server_config(given: ServeOptions) -> ServerConfig:
    if given.listen and given.connect:
        raise ValueError("--listen and --connect exclude each other; give one of them")
    return ServerConfig(
        bus=make_server_bus_config(given.listen, given.connect),
        world_name=given.world_name,
        settings=given.server,
        wait_s=given.wait,
        journal=str(given.journal or ""),
        keeps_inputs=given.input_log,
        ros=given.ros,
        mesh_http=given.mesh_http,
        metrics=given.choose_metrics("zensim serve", is_insecure=given.insecure),
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
