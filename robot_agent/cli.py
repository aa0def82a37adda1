"""`zensim agent`."""

import logging
import signal
import sys
import time
import uuid
from types import FrameType
from typing import Annotated, NoReturn, get_args

import msgspec
import typer

from proto.bus import BusConfig
from proto.claims import OnRelease
from proto.endpoint import DEFAULT_ENDPOINT
from proto.exits import one_line_failures
from proto.joining import join
from proto.names import check_name
from proto.ros2.settings import ros_settings
from robot_agent.agent import AgentConfig, run_agent
from robot_agent.rates import Rates

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
CHARACTERS_OF_ENTITY = 48
"""Of its name, in a made-up name of an agent."""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

Connect = Annotated[
    str, typer.Option("--connect", help="Router or server to join.", envvar="ZENSIM_CONNECT")
]
WorldName = Annotated[
    str,
    typer.Option("--world-name", "--world", help="World on the network.", envvar="ZENSIM_WORLD"),
]
Wait = Annotated[
    float, typer.Option(min=0.0, help="Seconds to wait for server and entities at the start.")
]
CmdVelTimeout = Annotated[
    float, typer.Option(min=0.0, help="Simulated seconds that a command holds; 0 = for ever.")
]
OnReleaseWord = Annotated[
    str, typer.Option(help="What becomes of the entities at the end: stop, keep or delete.")
]

Pool = Annotated[
    int | None,
    typer.Option(
        "--pool",
        min=0,
        help="Drive a share of all robots that nobody drives by name: this many at most, 0 = any.",
    ),
]
OdomHz = Annotated[
    float | None,
    typer.Option(
        "--odom-hz",
        min=0.0,
        help="Odometry, and tf unless told, a simulated second; 0 = at every state.",
        show_default="as described",
    ),
]
TfHz = Annotated[
    float | None,
    typer.Option(
        "--tf-hz",
        min=0.0,
        help="tf a simulated second; 0 = at every state.",
        show_default="as described, or with odometry",
    ),
]
RosDomain = Annotated[
    str,
    typer.Option(
        help="ROS 2 domain to be seen in, 0 to 232, or 'off'.",
        envvar=["ZENSIM_ROS_DOMAIN", "ROS_DOMAIN_ID"],
    ),
]
RosDistro = Annotated[
    str, typer.Option(help="ROS 2 distribution to talk to; only humble is unlike the others.")
]
TfScope = Annotated[
    str, typer.Option("--tf", help="Transforms on /tf (global), on /NS/tf (namespaced), or both.")
]
RosBridge = Annotated[
    bool, typer.Option("--ros-bridge", help="Announce topics to zenoh-bridge-ros2dds too.")
]


@app.command()
def agent(
    entities: Annotated[
        list[str] | None, typer.Argument(help="Entities to drive; none with --pool.")
    ] = None,
    *,
    pool: Pool = None,
    connect: Connect = "",
    world_name: WorldName = "default",
    name: Annotated[str, typer.Option(help="Of this agent; made up unless given.")] = "",
    wait: Wait = 30.0,
    cmd_vel_timeout: CmdVelTimeout = 0.5,
    odom_hz: OdomHz = None,
    tf_hz: TfHz = None,
    on_release: OnReleaseWord = "stop",
    ros_domain: RosDomain = "0",
    ros_distro: RosDistro = "jazzy",
    tf: TfScope = "both",
    ros_bridge: RosBridge = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Log warnings only.")] = False,
) -> None:
    """Drive robots: cmd_vel in, odom and tf out."""
    logging.basicConfig(
        level=logging.WARNING if quiet else logging.INFO,
        format="%(levelname)s %(name)s %(message)s",
        stream=sys.stderr,
    )
    with one_line_failures("agent"):
        names = _checked_names(entities or [], pool)
        config = AgentConfig(
            world=check_name(world_name, "world"),
            agent=check_name(name or _made_up_name(names[0] if names else "pool"), "agent"),
            entities=names,
            pool_limit=pool,
            rates=Rates(odom_hz, tf_hz),
            wait_s=wait,
            cmd_vel_timeout_s=cmd_vel_timeout,
            on_release=_checked(on_release),
            ros=ros_settings(ros_domain, ros_distro, tf, is_bridged=ros_bridge),
        )
        _run(connect or DEFAULT_ENDPOINT, config)


def _checked_names(entities: list[str], pool: int | None) -> tuple[str, ...]:
    if bool(entities) == (pool is not None):
        given = f"{len(entities)} entities and {'a' if pool is not None else 'no'} --pool"
        raise ValueError(f"{given} were given; name entities, or use --pool, one of both")
    return tuple(dict.fromkeys(check_name(entity, "entity") for entity in entities))


def _run(endpoint: str, config: AgentConfig) -> None:
    """Join the network and stay until stopped, which is how an agent ends well."""
    # Opening does not return to Python; until there is a token to withdraw, a signal just ends it.
    _on_stop(signal.SIG_DFL)
    deadline_s = time.monotonic() + config.wait_s
    with join(BusConfig(connect=(endpoint,)), config.wait_s) as bus:
        left_s = max(0.0, deadline_s - time.monotonic())
        try:
            _on_stop(_interrupt)
            run_agent(bus, msgspec.structs.replace(config, wait_s=left_s))
        except KeyboardInterrupt:
            _on_stop(signal.SIG_IGN)


def _interrupt(_number: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def _on_stop(handler: "signal._HANDLER") -> None:
    for number in STOP_SIGNALS:
        signal.signal(number, handler)


def _made_up_name(entity: str) -> str:
    return f"agent_{entity[:CHARACTERS_OF_ENTITY]}_{uuid.uuid4().hex[:4]}"


def _checked(on_release: str) -> OnRelease:
    for known in get_args(OnRelease):
        if known == on_release:
            return known  # type: ignore[no-any-return]
    raise ValueError(
        f"--on-release {on_release!r} is unknown; use {', '.join(get_args(OnRelease))}"
    )
