"""`zensim agent`: command line options of a robot agent."""

from dataclasses import dataclass
from typing import Annotated, get_args

import typer

from zensim.proto.bus import DEFAULT_ENDPOINT
from zensim.proto.cli_options import RosTfOptions, options_from
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.agent_messages import OnRelease
from zensim.proto.names import check_name
from zensim.robot_agent.agent import run_agent_process
from zensim.robot_agent.agent_config import AgentConfig, AgentProcessConfig, RateOverrides

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

ConnectOption = Annotated[
    str, typer.Option("--connect", help="Router or server to join.", envvar="ZENSIM_CONNECT")
]
WorldNameOption = Annotated[
    str,
    typer.Option("--world-name", "--world", help="World on the network.", envvar="ZENSIM_WORLD"),
]
ClaimWaitOption = Annotated[
    float, typer.Option(min=0.0, help="Seconds to wait for server and entities at the start.")
]
CmdVelTimeoutOption = Annotated[
    float, typer.Option(min=0.0, help="Simulated seconds that a command holds; 0 = for ever.")
]
OnReleaseOption = Annotated[
    str, typer.Option(help="What becomes of the entities at the end: stop, keep or delete.")
]

PoolOption = Annotated[
    int | None,
    typer.Option(
        "--pool",
        min=0,
        help="Drive a share of all robots that nobody drives by name: this many at most, 0 = any.",
    ),
]
OdomHzOption = Annotated[
    float | None,
    typer.Option(
        "--odom-hz",
        min=0.0,
        help="Odometry, and tf unless told, a simulated second; 0 = at every state.",
        show_default="as described",
    ),
]
TfHzOption = Annotated[
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
    pool: PoolOption = None
    connect: ConnectOption = ""
    world_name: WorldNameOption = "default"
    name: Annotated[str, typer.Option(help="Of this agent; made up unless given.")] = ""
    wait: ClaimWaitOption = 30.0
    cmd_vel_timeout: CmdVelTimeoutOption = 0.5
    odom_hz: OdomHzOption = None
    tf_hz: TfHzOption = None
    on_release: OnReleaseOption = "stop"
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Log warnings only.")] = False


@app.command()
@options_from(AgentOptions)
def agent(given: AgentOptions) -> None:
    """Drive robots: cmd_vel in, odom and tf out."""
    with exit_on_failure("agent"):
        endpoint = given.connect or DEFAULT_ENDPOINT
        run_agent_process(
            AgentProcessConfig(endpoint=endpoint, config=_make_config(given), is_quiet=given.quiet)
        )


def _make_config(given: AgentOptions) -> AgentConfig:
    return AgentConfig(
        world=check_name(given.world_name, "world"),
        agent=check_name(given.name, "agent") if given.name else "",
        entities=_check_entities(given.entities or [], given.pool),
        pool_limit=given.pool,
        rates=RateOverrides(given.odom_hz, given.tf_hz),
        wait_s=given.wait,
        cmd_vel_timeout_s=given.cmd_vel_timeout,
        on_release=_parse_on_release(given.on_release),
        ros=given.ros,
    )


def _check_entities(entities: list[str], pool: int | None) -> tuple[str, ...]:
    if bool(entities) == (pool is not None):
        given = f"{len(entities)} entities and {'a' if pool is not None else 'no'} --pool"
        raise ValueError(f"{given} were given; name entities, or use --pool, one of both")
    return tuple(dict.fromkeys(check_name(entity, "entity") for entity in entities))


def _parse_on_release(on_release: str) -> OnRelease:
    for known in get_args(OnRelease):
        if known == on_release:
            return known  # type: ignore[no-any-return]
    raise ValueError(
        f"--on-release {on_release!r} is unknown; use {', '.join(get_args(OnRelease))}"
    )
