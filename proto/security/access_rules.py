"""Zenoh's access control of a secured router, made from its users."""

from collections.abc import Iterable
from typing import Final

from zensim.proto.security.roles import SERVER_USER, Operation, User, list_keys

EVERYTHING: Final = ("**", "@ros2_lv/**", "**/@adv/**")
"""Keys of the server; `**` does not include chunks that begin with `@`."""
MESSAGES: Final = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
)
INGRESS: Final[dict[Operation, tuple[str, ...]]] = {
    Operation.PUBLISH: ("put",),
    Operation.SUBSCRIBE: ("declare_subscriber",),
    Operation.QUERY: ("query",),
    Operation.REPLY: ("declare_queryable", "reply"),
    Operation.DECLARE_TOKEN: ("liveliness_token",),
    Operation.WATCH_TOKENS: ("declare_liveliness_subscriber", "liveliness_query"),
}
"""What a client sends to do an operation."""
EGRESS: Final[dict[Operation, tuple[str, ...]]] = {
    Operation.SUBSCRIBE: ("put",),
    Operation.QUERY: ("reply",),
    Operation.REPLY: ("query",),
    Operation.WATCH_TOKENS: ("liveliness_token",),
}
"""Messages that must reach the client for an operation."""
SHARED_RULES: Final = (
    {
        "id": "everything",
        "permission": "allow",
        "flows": ["ingress", "egress"],
        "messages": list(MESSAGES),
        "key_exprs": list(EVERYTHING),
    },
    {
        # A publisher sends nothing unless the declaration of a subscriber reaches it.
        "id": "declarations",
        "permission": "allow",
        "flows": ["egress"],
        "messages": ["declare_subscriber", "declare_queryable"],
        "key_exprs": ["**", "**/@adv/**"],
    },
)


def make_access_rules(
    users: Iterable[User], *, world: str, domain: int | None, uses_certificates: bool = False
) -> dict[str, object]:
    """Make the value of `access_control` of a router that denies what no role allows.

    Args:
        users: All that may join.
        world: Name of the world in keys.
        domain: Of ROS 2; None = no keys of ROS 2.
        uses_certificates: Whether each also has a certificate, with its name as common name.
    """
    rules: list[object] = list(SHARED_RULES)
    subjects: list[object] = [_make_subject(SERVER_USER, uses_certificates=uses_certificates)]
    policies: list[object] = [{"rules": ["everything"], "subjects": [SERVER_USER]}]
    for user in users:
        own = _make_rules(user, world, domain)
        rules += own
        subjects.append(_make_subject(user.name, uses_certificates=uses_certificates))
        ids = [*(rule["id"] for rule in own), "declarations"]
        policies.append({"rules": ids, "subjects": [user.name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _make_subject(name: str, *, uses_certificates: bool) -> dict[str, object]:
    # All kinds that a subject has must match.
    certified = {"cert_common_names": [name]} if uses_certificates else {}
    return {"id": name, "usernames": [name], **certified}


def _make_rules(user: User, world: str, domain: int | None) -> list[dict[str, object]]:
    return [
        {
            "id": f"{user.name}:{operation.value}:{flow}",
            "permission": "allow",
            "flows": [flow],
            "messages": list(messages[operation]),
            "key_exprs": keys,
        }
        for operation in Operation
        if (keys := list_keys(user, operation, world=world, domain=domain))
        for flow, messages in (("ingress", INGRESS), ("egress", EGRESS))
        if operation in messages
    ]
