"""`zensim token`: create, list, revoke and show join tokens of a secured server on this host."""

import json
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final

import typer

from zensim.proto.bus.bus_config import BusConfig, Credentials
from zensim.proto.bus.zenoh_config import list_client_settings
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.join_tokens import JoinToken
from zensim.proto.options.command_options import JsonOption, WorldNameOption
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.security.roles import ROLES, RefusedUser, User
from zensim.proto.verbosity import print_note
from zensim.sim_server.security.secure_folder import Account, SecureFolder, open_secure_folder

app = make_app("token")

UNITS_S: Final = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86_400.0}
TTL_PATTERN: Final = re.compile(r"(\d{1,9})([smhd])")
FORMS: Final = ("token", "file", "zenoh-config", "rmw")

HostOption = Annotated[
    str,
    typer.Option(
        "--host",
        metavar="HOST",
        help="Name or address of this host for clients, as behind a router with NAT.",
        show_default="as the server listens",
    ),
]
CertificateTtlOption = Annotated[
    str,
    typer.Option(
        "--certificate-ttl",
        metavar="TIME",
        help="How long its certificate is valid, where the server asks for one.",
    ),
]
UserArgument = Annotated[str, typer.Argument(metavar="USER", help="User, as 'list' prints it.")]


@dataclass(frozen=True, kw_only=True)
class CreateOptions:
    """Options of `zensim token create`."""

    role: Annotated[str, typer.Option("--role", metavar="ROLE", help=f"One of {', '.join(ROLES)}.")]
    robot: Annotated[
        list[str] | None,
        typer.Option(
            "--robot",
            metavar="NAME",
            help="Robot that an agent drives; its name is also its namespace. Repeatable.",
        ),
    ] = None
    name: Annotated[
        str,
        typer.Option(
            "--name", metavar="NAME", help="Name of the user.", show_default="robot, or role"
        ),
    ] = ""
    ttl: Annotated[
        str,
        typer.Option(
            "--ttl",
            metavar="TIME",
            help="How long it is valid, as 30m, 1h or 7d.",
            show_default="∞",
        ),
    ] = ""
    certificate_ttl: CertificateTtlOption = "24h"
    host: HostOption = ""
    world_name: WorldNameOption = "default"
    as_json: JsonOption = False


@app.command(
    epilog="""Examples:
  zensim token create --role agent --robot r1 --ttl 1h
  zensim token create --role observer --name anna"""
)
def create(given: CreateOptions) -> None:
    """Create a user, and print its token. Sessions are interrupted for about two seconds."""
    with exit_on_failure("token create"):
        folder = open_secure_folder(given.world_name)
        robots = tuple(given.robot or ())
        user = User(given.name or choose_user_name(folder, given.role, robots), given.role, robots)
        certificate_s = parse_ttl(given.certificate_ttl, "--certificate-ttl")
        account = folder.add([user], parse_ttl(given.ttl))[0]
        await_admission(folder, "token create")
        token = folder.make_token(account, given.host, certificate_s).write()
        facts = {"user": user.name, "role": user.role, "robots": robots, "token": token}
        print_lines(json.dumps(facts) if given.as_json else token)


@app.command(
    name="list",
    epilog="""Examples:
  zensim token list""",
)
def list_users(*, world_name: WorldNameOption = "default", as_json: JsonOption = False) -> None:
    """List the users: role, robots and end; no secrets."""
    with exit_on_failure("token list"):
        accounts = open_secure_folder(world_name).accounts().values()
        if as_json:
            print_lines(json.dumps([_describe(account) for account in accounts]))
            return
        for account in accounts:
            user, robots = account.user, ", ".join(account.user.robots) or "-"
            print_lines(f"{user.name:<20} {user.role:<10} {robots:<20} {_format_end(account)}")


@app.command(
    epilog="""Examples:
  zensim token revoke r1"""
)
def revoke(
    *, user: UserArgument, world_name: WorldNameOption = "default", as_json: JsonOption = False
) -> None:
    """Revoke a user: its sessions end now. Others are interrupted for about two seconds."""
    with exit_on_failure("token revoke"):
        folder = open_secure_folder(world_name)
        folder.revoke(user)
        await_admission(folder, "token revoke")
        if as_json:
            print_lines(json.dumps({"user": user}))


@app.command(
    epilog="""Examples:
  zensim token show r1
  zensim token show observer --as zenoh-config > session.json5"""
)
def show(
    *,
    user: UserArgument,
    form: Annotated[
        str,
        typer.Option(
            "--as",
            metavar="token|file|zenoh-config|rmw",
            help="The token, a file for '--join @FILE', a session configuration of Zenoh, or the "
            "variable of rmw_zenoh.",
        ),
    ] = "token",
    certificate_ttl: CertificateTtlOption = "24h",
    host: HostOption = "",
    world_name: WorldNameOption = "default",
    as_json: JsonOption = False,
) -> None:
    """Print the token of a user, or its settings for another Zenoh client."""
    with exit_on_failure("token show"):
        folder = open_secure_folder(world_name)
        if form not in FORMS:
            raise ValueError(f"--as must be one of {', '.join(FORMS)}; got {form[:40]!r}")
        account = folder.accounts().get(user)
        if account is None:
            raise RefusedUser(f"user {user[:64]!r} does not exist; 'zensim token list' lists all")
        certificate_s = parse_ttl(certificate_ttl, "--certificate-ttl")
        text = write_settings(folder.make_token(account, host, certificate_s), form, folder)
        print_lines(json.dumps({"user": user, form: text}) if as_json else text)


def await_admission(folder: SecureFolder, command: str) -> None:
    """Wait until a running router admits the users that the folder has now."""
    if not folder.wait_until_admitted():
        print_note(command, "the server has not admitted the change yet; try again in a moment")


def choose_user_name(folder: SecureFolder, role: str, robots: tuple[str, ...]) -> str:
    """Choose the name of a new user: its robot's or role's, with a number if that is taken."""
    first = robots[0].replace("/", "_") if robots else role
    names = (first, *(f"{first}_{number}" for number in range(2, 10_000)))
    return next(name for name in names if name not in folder.accounts())


def parse_ttl(text: str, option: str = "--ttl") -> float:
    """Parse a duration such as 1h, in seconds; 0 for none.

    Raises:
        ValueError: It is not a number with a unit.
    """
    if not text:
        return 0.0
    if (match := TTL_PATTERN.fullmatch(text)) is None or not int(match[1]):
        raise ValueError(
            f"{option} {text[:20]!r} is not valid; use a number with s, m, h or d, as 1h"
        )
    return int(match[1]) * UNITS_S[match[2]]


def write_settings(token: JoinToken, form: str, folder: SecureFolder) -> str:
    """Write a token, or the same as a file or as a configuration of a Zenoh session."""
    if form == "token":
        return token.write()
    if form == "file":
        return token.write_file().rstrip()
    credentials = Credentials(
        user=token.user,
        password=token.password_text,
        authority=folder.authority,
        certificate=token.certificate_text,
    )
    settings = list_client_settings(BusConfig(connect=(token.endpoint,), credentials=credentials))
    if form == "rmw":
        words = ";".join(f"{path}={json.dumps(value)}" for path, value in settings.items())
        return f"export ZENOH_CONFIG_OVERRIDE='{words}'"
    return json.dumps(nest_settings(settings), indent=2)


def nest_settings(settings: Mapping[str, object]) -> dict[str, Any]:
    """Make the nested form of settings that are given by path."""
    nested: dict[str, Any] = {}
    for path, value in settings.items():
        *before, last = path.split("/")
        place = nested
        for part in before:
            place = place.setdefault(part, {})
        place[last] = value
    return nested


def _describe(account: Account) -> dict[str, object]:
    user = account.user
    return {
        "user": user.name,
        "role": user.role,
        "robots": user.robots,
        "expires_s": account.expires_s or None,
        "is_active": account.is_active(time.time()),
    }


def _format_end(account: Account) -> str:
    if not account.expires_s:
        return "never expires"
    when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(account.expires_s))
    return f"until {when}" if account.is_active(time.time()) else f"expired {when}"
