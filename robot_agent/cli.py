"""`zensim agent`."""

import logging
import signal
import sys
import time
import uuid
from dataclasses import dataclass
from types import FrameType
from typing import Annotated, NoReturn, get_args

import msgspec
import typer

from proto.bus import BusConfig
from proto.claims import OnRelease
from proto.cli import RosTfOptions
from proto.endpoint import DEFAULT_ENDPOINT
from proto.exits import one_line_failures
from proto.joining import join
from proto.names import check_name
from proto.option_fields import takes
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


@dataclass(frozen=True, kw_only=True)
class AgentOptions(RosTfOptions):
    """What is driven, and how."""

    entities: Annotated[
        list[str] | None, typer.Argument(help="Entities to drive; none with --pool.")
    ] = None
    pool: Pool = None
    connect: Connect = ""
    world_name: WorldName = "default"
    name: Annotated[str, typer.Option(help="Of this agent; made up unless given.")] = ""
    wait: Wait = 30.0
    cmd_vel_timeout: CmdVelTimeout = 0.5
    odom_hz: OdomHz = None
    tf_hz: TfHz = None
    on_release: OnReleaseWord = "stop"
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Log warnings only.")] = False


@app.command()
@takes(AgentOptions)
def agent(given: AgentOptions) -> None:
    """Drive robots: cmd_vel in, odom and tf out."""
    logging.basicConfig(
        level=logging.WARNING if given.quiet else logging.INFO,
        format="%(levelname)s %(name)s %(message)s",
        stream=sys.stderr,
    )
    with one_line_failures("agent"):
        _run(given.connect or DEFAULT_ENDPOINT, _config(given))


def _config(given: AgentOptions) -> AgentConfig:
    names = _checked_names(given.entities or [], given.pool)
    made_up = _made_up_name(names[0] if names else "pool")
    return AgentConfig(
        world=check_name(given.world_name, "world"),
        agent=check_name(given.name or made_up, "agent"),
        entities=names,
        pool_limit=given.pool,
        rates=Rates(given.odom_hz, given.tf_hz),
        wait_s=given.wait,
        cmd_vel_timeout_s=given.cmd_vel_timeout,
        on_release=_checked(given.on_release),
        ros=given.ros,
    )


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
