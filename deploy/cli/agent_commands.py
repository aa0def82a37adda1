"""`zensim agent`: run a robot agent."""

from dataclasses import dataclass
from typing import Annotated, get_args

import typer

from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.join_tokens import hide_token
from zensim.proto.messages.agent_messages import OnRelease
from zensim.proto.names import check_name
from zensim.proto.options.command_options import (
    ConnectOption,
    JsonOption,
    RosTfOptions,
    WorldNameOption,
    flag,
    parse_choice,
    seconds,
)
from zensim.proto.options.option_groups import make_app
from zensim.proto.settings.operation_settings import USUAL_METRICS, MetricsSettings
from zensim.proto.settings.rate_settings import RateOverrides
from zensim.proto.verbosity import print_announcement
from zensim.robot_agent.agent import run_agent_process
from zensim.robot_agent.agent_config import AS_DESCRIBED, AgentConfig, AgentProcessConfig

app = make_app()

ON_RELEASE: tuple[OnRelease, ...] = get_args(OnRelease)


@dataclass(frozen=True, kw_only=True)
class AgentOptions(RosTfOptions):
    """All options of `zensim agent`."""

    entities: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="Names of the robots to drive; none with --pool."),
    ] = None
    pool: Annotated[
        int | None,
        typer.Option(
            "--pool",
            min=0,
            metavar="N",
            help="Drive a share of all robots that no other agent claims by name: "
            "at most N robots, 0 = all; `--pool 1` drives one.",
        ),
    ] = None
    name: Annotated[
        str, typer.Option(metavar="NAME", help="Name of this agent.", show_default="generated")
    ] = ""
    cmd_vel_timeout: Annotated[
        float,
        seconds(
            help=r"Stop a robot this long after its last cmd_vel \[s, simulation time]; 0 = never."
        ),
    ] = 0.5
    rates: RateOverrides = AS_DESCRIBED
    operation: MetricsSettings = USUAL_METRICS
    on_release: Annotated[
        str,
        typer.Option(
            metavar="stop|keep|delete",
            help="At exit, stop the robots, keep their last command, or delete them.",
        ),
    ] = "stop"
    as_json: JsonOption = False
    quiet: Annotated[bool, flag("--quiet", "-q", help="Log at level WARNING.")] = False
    connect: ConnectOption = ""
    world_name: WorldNameOption = "default"
    wait: Annotated[
        float,
        seconds(
            help=r"Timeout of waiting for the server and the robots at start \[s].",
            rich_help_panel="Connection",
        ),
    ] = 30.0


@app.command(
    epilog="""Examples:
  zensim agent r1 r2
  zensim agent --pool 0 --odom-hz 10"""
)
def agent(given: AgentOptions) -> None:
    """Drive robots: subscribe to cmd_vel, publish odom and tf."""
    with exit_on_failure("agent"):
        endpoint = given.connect or DEFAULT_ENDPOINT
        if given.as_json:
            facts = {
                "endpoint": hide_token(endpoint),
                "world": given.world_name,
                "robots": given.entities or [],
            }
            print_announcement("agent", "", facts, as_json=True)
        run_agent_process(
            AgentProcessConfig(
                endpoint=endpoint,
                config=_make_config(given),
                is_quiet=given.quiet,
                metrics=given.operation.choose_metrics("zensim agent"),
            )
        )


def _make_config(given: AgentOptions) -> AgentConfig:
    return AgentConfig(
        world=check_name(given.world_name, "world"),
        agent=check_name(given.name, "agent") if given.name else "",
        entities=_check_entities(given.entities or [], given.pool),
        pool_limit=given.pool,
        rates=given.rates,
        wait_s=given.wait,
        cmd_vel_timeout_s=given.cmd_vel_timeout,
        on_release=parse_choice("--on-release", given.on_release, ON_RELEASE),
        ros=given.ros,
    )


def _check_entities(entities: list[str], pool: int | None) -> tuple[str, ...]:
    if bool(entities) == (pool is not None):
        raise ValueError(
            f"give robot names or --pool, one of them; got {len(entities)} names and "
            f"--pool {'unset' if pool is None else pool}"
        )
    return tuple(dict.fromkeys(check_name(entity, "entity") for entity in entities))
