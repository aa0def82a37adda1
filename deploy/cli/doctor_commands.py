"""`zensim doctor`: check this host, its connection, the server, robots, and the needs of ROS 2."""

import socket
from collections.abc import Iterator
from importlib.metadata import version
from typing import Annotated

import typer

from zensim.deploy.cli.command_session import complete_robots, data_console, print_json
from zensim.deploy.cli.findings import Finding, choose_exit_status, make_findings_table
from zensim.deploy.cli.host_findings import describe_host
from zensim.deploy.cli.ros_observation import observe_robot
from zensim.deploy.cli.ros_requirements import RosStack, check_stack
from zensim.deploy.cli.sensor_commands import count_sensors_of_processes, fetch_sensor_stats
from zensim.proto import service_catalog
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError, JoinRefused, NoServer
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.endpoints import (
    DEFAULT_ENDPOINT,
    ENDPOINT_PATTERN,
    STREAM_PROTOCOLS,
    check_endpoint,
)
from zensim.proto.exit_codes import ExitCode, exit_on_failure
from zensim.proto.join_tokens import is_join_address, read_join_address
from zensim.proto.messages.telemetry_messages import (
    EntityModel,
    GetModelsResponse,
    Info,
    InfoRequest,
)
from zensim.proto.names import check_name
from zensim.proto.options.command_options import (
    ConnectionOptions,
    JsonOption,
    RosDomainOption,
    flag,
)
from zensim.proto.options.option_groups import make_app
from zensim.proto.ros2.rmw_keys import parse_domain
from zensim.proto.sensor_libraries import find_advice, find_missing_libraries
from zensim.spawner.client.service_client import ServiceClient

CONNECT_TIMEOUT_S = 2.0
REPLY_TIMEOUT_S = 1.0
"""Shorter than the Zenoh lease, so that a suspended server still counts as alive."""
MAX_NAMES_SHOWN = 5


def diagnose(endpoint: str, world: str, version: str) -> Iterator[Finding]:
    """Run the checks from the endpoint to the robots; stop when one makes the next impossible.

    Args:
        endpoint: Expected endpoint of the router or server.
        world: Name on the network.
        version: Version of this command.
    """
    config = BusConfig(connect=(endpoint,), open_timeout_s=CONNECT_TIMEOUT_S)
    if is_join_address(endpoint):
        endpoint = read_join_address(endpoint).endpoint
    listener = _check_listener(endpoint)
    yield listener
    if listener.mark == "wrong":
        return
    try:
        bus = open_bus(config)
    except JoinRefused as error:
        yield _refused_finding(str(error))
        return
    except BusError:
        yield _no_session_finding(endpoint)
        return
    with bus:
        yield Finding("ok", "session", f"connected to the Zenoh network at {endpoint}")
        yield from _check_server(bus, world, version)


def _check_listener(endpoint: str) -> Finding:
    match = ENDPOINT_PATTERN.fullmatch(check_endpoint(endpoint))
    if match is None or match[1] not in STREAM_PROTOCOLS:
        return Finding("note", "endpoint", f"{endpoint} cannot be checked without a session")
    host, port = match["host"].strip("[]"), int(match["port"])
    try:
        socket.create_connection((host, port), CONNECT_TIMEOUT_S).close()
    except socket.gaierror as error:
        return _unreachable_finding(
            endpoint, f"host {host!r} has no address ({error.strerror})", "the name"
        )
    except TimeoutError:
        return _unreachable_finding(
            endpoint,
            f"{host} does not reply within {CONNECT_TIMEOUT_S:g} s",
            "the address and the firewall",
        )
    except OSError as error:
        advice = f"start 'zensim serve' or 'zensim router' there, with --listen {endpoint}"
        found = f"nothing listens at {endpoint} ({error.strerror})"
        return Finding("wrong", "endpoint", found, advice, ExitCode.UNREACHABLE)
    return Finding("ok", "endpoint", f"{endpoint} accepts connections")


def _unreachable_finding(endpoint: str, found: str, check: str) -> Finding:
    advice = f"check {check} in --connect {endpoint}"
    return Finding("wrong", "endpoint", found, advice, ExitCode.UNREACHABLE)


def _no_session_finding(endpoint: str) -> Finding:
    return Finding(
        "wrong",
        "session",
        f"{endpoint} accepts connections, but no Zenoh session: it is not a Zenoh router, "
        "or it denies access",
        "check the port, and the credentials and certificates of the router",
        ExitCode.UNREACHABLE,
    )


def _refused_finding(message: str) -> Finding:
    found, _, advice = message.partition("; ")
    return Finding("wrong", "session", found, advice, ExitCode.UNREACHABLE)


def _check_server(bus: Bus, world: str, version: str) -> Iterator[Finding]:
    worlds = bus.list_worlds()
    try:
        info = bus.call(service_catalog.INFO, InfoRequest(), world=world, timeout_s=REPLY_TIMEOUT_S)
    except TimeoutError:
        yield _silent_server_finding(world)
        return
    except NoServer:
        has_gone = world in worlds and world not in bus.list_worlds()
        yield _silent_server_finding(world) if has_gone else _no_server_finding(world, worlds)
        return
    yield Finding(
        "ok", "server", f"world '{world}' is served by zensim {info.version} on {info.engine}"
    )
    yield _check_versions(info, version)
    yield _check_time(info)
    models = ServiceClient(bus, world).models()
    yield _check_robots(models)
    yield from _check_sensors(bus, world, models)


def _silent_server_finding(world: str) -> Finding:
    return Finding(
        "wrong",
        "server",
        f"the server of world '{world}' is alive, but does not reply within {REPLY_TIMEOUT_S:g} s",
        "it is suspended or overloaded: check its process, or restart it",
        ExitCode.TIMEOUT,
    )


def _no_server_finding(world: str, worlds: list[str]) -> Finding:
    if world in worlds:
        return Finding(
            "wrong",
            "server",
            f"the server of world '{world}' is alive, but queries to it are denied",
            "allow queries on sim/* in the access control of the router",
            ExitCode.UNREACHABLE,
        )
    if worlds:
        named = ", ".join(f"'{name}'" for name in worlds[:MAX_NAMES_SHOWN])
        found = f"no server of world '{world}'; worlds on this network: {named}"
        return Finding(
            "wrong", "server", found, f"use --world-name {worlds[0]}", ExitCode.UNREACHABLE
        )
    return Finding(
        "wrong",
        "server",
        "the router has no server",
        "start one: 'zensim serve --connect' with the endpoint of the router",
        ExitCode.UNREACHABLE,
    )


def _check_versions(info: Info, version: str) -> Finding:
    if info.version == version:
        return Finding("ok", "version", f"server and command are version {version}")
    ours, theirs = (text.split(".")[:2] for text in (version, info.version))
    found = f"the server is version {info.version}, this command {version}"
    if ours == theirs:
        return Finding("note", "version", found)
    return Finding("wrong", "version", found, f"install zensim {info.version}", ExitCode.FAILED)


def _check_time(info: Info) -> Finding:
    if info.state != "playing":
        is_empty = info.state == "no_world"
        advice = "load a world: 'zensim world load NAME'" if is_empty else "start it: 'zensim play'"
        return Finding("note", "time", f"the simulation is {info.state}", advice)
    target, factor = info.target_real_time_factor, info.real_time_factor
    running = f"real-time factor {factor:.2f}"
    if target > 0.0 and factor < 0.9 * target:
        advice = "the host is too slow for this world: use fewer robots or a smaller --rtf"
        return Finding("note", "time", f"{running}, target {target:g}", advice)
    return Finding("ok", "time", running)


def _check_robots(models: GetModelsResponse) -> Finding:

    def is_idle(one: EntityModel) -> bool:
        return models.models[one.model].drive is not None and not one.agent

    idle = [one.entity for one in models.entities if is_idle(one)]
    found = f"{len(models.entities)} entities, {len(idle)} of them robots without an agent"
    if not idle:
        return Finding("ok", "robots", found)
    named = " ".join(idle[:MAX_NAMES_SHOWN])
    return Finding("note", "robots", found, f"start one: 'zensim agent {named}'")


def _check_sensors(bus: Bus, world: str, models: GetModelsResponse) -> Iterator[Finding]:
    """Check what measures lidars and cameras, and which optional libraries it lacks."""
    count = count_sensors_of_processes(models)
    processes = fetch_sensor_stats(bus, world)
    if count and not processes:
        found = f"{count} lidars and cameras, and no sensor process publishes them"
        yield Finding("note", "sensors", found, "start one: 'zensim sensors run'")
    elif count:
        named = ", ".join(one.process for one in processes[:MAX_NAMES_SHOWN])
        yield Finding("ok", "sensors", f"{count} lidars and cameras, published by {named}")
    for one in processes:
        for library, fault in one.missing.items():
            what = f"the host of {one.process} has no {library}: {fault}"
            yield Finding("note", "libraries", what, find_advice(library))
    if not processes:
        yield from _check_own_libraries()


def _check_own_libraries() -> Iterator[Finding]:
    """Check what a sensor process on this host would lack."""
    for library, fault in find_missing_libraries().items():
        what = f"a sensor process on this host would have no {library}: {fault}"
        yield Finding("note", "libraries", what, find_advice(library))


def diagnose_robot(
    endpoint: str, world: str, robot: str, stack: RosStack, domain: int
) -> Iterator[Finding]:
    """Check what a ROS 2 stack asks of a robot; the server must be reachable.

    Args:
        endpoint: Of the router or server.
        world: Name on the network.
        robot: Name or namespace.
        stack: Whose needs are checked.
        domain: ROS domain id.
    """
    with open_bus(BusConfig(connect=(endpoint,), open_timeout_s=CONNECT_TIMEOUT_S)) as bus:
        models = ServiceClient(bus, world).models()
        entity = next(
            (one for one in models.entities if robot in (one.entity, one.namespace)), None
        )
        if entity is None:
            named = ", ".join(one.entity for one in models.entities[:MAX_NAMES_SHOWN]) or "none"
            found = f"no robot '{robot}'; the world has {named}"
            yield Finding("wrong", "robot", found, "'zensim list' lists all", ExitCode.NOT_FOUND)
            return
        yield from check_stack(observe_robot(bus, domain, entity, models), stack)


app = make_app()


@app.command(
    epilog="""Examples:
  zensim doctor
  zensim doctor --ros nav2 box_bot0"""
)
def doctor(
    robot: Annotated[
        str,
        typer.Argument(
            metavar="ROBOT", help="Robot to check for --ros.", autocompletion=complete_robots
        ),
    ] = "",
    *,
    ros: Annotated[
        RosStack | None,
        typer.Option("--ros", help="Check what a ROS 2 stack asks of the topics of ROBOT."),
    ] = None,
    ros_domain: RosDomainOption = "0",
    as_json: JsonOption = False,
    quiet: Annotated[bool, flag("--quiet", "-q", help="Print only what is wrong.")] = False,
    server: ConnectionOptions,
) -> None:
    """Diagnose problems: check this host and its engines, the network, server, robots, sensors."""
    with exit_on_failure("doctor"):
        check_name(server.world_name, "world name")
        domain = _check_arguments(robot, ros, ros_domain)
        endpoint = server.connect or DEFAULT_ENDPOINT
        findings = [*describe_host(), *diagnose(endpoint, server.world_name, version("zensim"))]
        if ros is not None and choose_exit_status(findings) is ExitCode.OK:
            findings += diagnose_robot(endpoint, server.world_name, robot, ros, domain)
    shown = [one for one in findings if one.mark == "wrong"] if quiet else findings
    if as_json:
        print_json(shown)
    elif shown:
        data_console.print(make_findings_table(shown))
    if (status := choose_exit_status(findings)) is not ExitCode.OK:
        raise typer.Exit(int(status))


def _check_arguments(robot: str, stack: RosStack | None, domain: str) -> int:
    """Return the ROS domain id; 0 if no stack is checked."""
    if bool(robot) != (stack is not None):
        raise ValueError("a robot is checked for one stack: use --ros nav2 ROBOT, or neither")
    number = parse_domain(domain) if stack is not None else 0
    if number is None:
        raise ValueError("--ros-domain off has no ROS 2 topics to check; use 0 to 232")
    return number
