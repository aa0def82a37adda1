"""docs/security.md has the table of roles that the code has."""

from tests.contract.repository import ROOT, text_of
from zensim.proto.security.roles import (
    CLAIMING,
    CONTROLLING,
    READING,
    ROLES,
    SPAWNING,
    Operation,
    Role,
)
from zensim.proto.service_catalog import SERVICES

PAGE = ROOT / "docs" / "security.md"
BEGIN, END = "<!-- roles -->\n", "<!-- /roles -->"
GROUPS = {
    "that read": READING,
    "that spawn": SPAWNING,
    "that control": CONTROLLING,
    "that claim": CLAIMING,
}
NAMES = {
    "{world}": "WORLD",
    "{user}": "USER",
    "{domain}": "DOMAIN",
    "{robot}": "ROBOT",
    "{mangled}": "%ROBOT",
}


def write_table() -> str:
    rows = [
        f"| `{name}` | {role.summary} | {write_services(role)} |" for name, role in ROLES.items()
    ]
    parts = ["| role | may | services |\n|---|---|---|\n" + "\n".join(rows)]
    parts += [f"### `{name}`\n\n{write_keys(role)}" for name, role in ROLES.items()]
    return "\n\n".join(parts) + "\n"


def write_services(role: Role) -> str:
    return ", ".join(name for name, group in GROUPS.items() if group <= role.services)


def write_keys(role: Role) -> str:
    found: dict[str, str] = {}
    for grant in role.grants:
        for key in grant.keys:
            found[key] = found.get(key, "") + grant.operations
    letters = [one.value for one in Operation]
    by_operations: dict[str, list[str]] = {}
    for key, operations in found.items():
        ordered = "".join(letter for letter in letters if letter in operations)
        for template, name in NAMES.items():
            key = key.replace(template, name)  # noqa: PLW2901
        by_operations.setdefault(ordered, []).append(f"`{key}`")
    rows = [
        f"| {operations} | {', '.join(_join_topics(keys))} |"
        for operations, keys in by_operations.items()
    ]
    return "| | keys |\n|---|---|\n" + "\n".join(rows)


def _join_topics(keys: list[str]) -> list[str]:
    """Write the topics of any robot as one key, and leave out those of ROS 2 of the same name."""
    suffixes = [key[1:-1].removeprefix("**/") for key in keys if key.startswith("`**/")]
    others = [key for key in keys if not key.startswith(("`**/", "`DOMAIN/**/"))]
    plain = [key for key in keys if key.startswith("`DOMAIN/**/@")]
    if not suffixes:
        services = [key for key in keys if key.startswith("`DOMAIN/**/") and key not in plain]
        return others + plain + services
    return [*others, *plain, f"`**/TOPIC` and the same in ROS 2: {' '.join(suffixes)}"]


def test_page_has_the_roles_of_the_code() -> None:
    text = text_of(PAGE)

    assert text[text.index(BEGIN) + len(BEGIN) : text.index(END)] == f"\n{write_table()}\n"


def test_each_service_is_in_one_group() -> None:
    groups = list(GROUPS.values())

    assert sum(map(len, groups)) == len(SERVICES)
    assert frozenset().union(*groups) == set(SERVICES)
