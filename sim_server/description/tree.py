"""Links and joints must make one tree; parents are put before children."""

from collections import Counter
from collections.abc import Iterable, Sequence

from zensim.proto.messages.model_messages import Joint, Link
from zensim.sim_server.description.part_list import Parts
from zensim.sim_server.description.report import Report
from zensim.sim_server.description.wording import listed
from zensim.sim_server.errors import ModelError

MAX_LINKS = 500
WORLD = "world"


def in_tree_order(parts: Parts) -> Parts:
    """Order links and joints so that `joints[i]` moves `links[i + 1]`, depth first from the root.

    Raises:
        ModelError: Not one tree: names used twice, unknown links, two parents, two roots, a cycle.
    """
    _check_names(parts)
    by_name = {link.name: link for link in parts.links}
    _check_ends(parts.joints, by_name)
    _check_single_parents(parts.joints)
    root = _root(parts)
    joints = _depth_first(root, parts.joints)
    if len(joints) < len(parts.joints):
        reached = {root, *(joint.child for joint in joints)}
        lost = [link.name for link in parts.links if link.name not in reached]
        raise ModelError(
            f"links {listed(lost)} are in a cycle; every link must hang from root {root!r}",
            slug="urdf.cycle",
        )
    links = (by_name[root], *(by_name[joint.child] for joint in joints))
    return Parts(parts.name, links, tuple(joints))


def without_world(parts: Parts, report: Report) -> Parts:
    """Drop a root link `world` that holds the robot by a floating joint only: it is free anyway."""
    if parts.links[0].name != WORLD or [j.kind for j in parts.joints if j.parent == WORLD] != [
        "floating"
    ]:
        return parts
    report.applied(f"joint {parts.joints[0].name!r}", "floating in the world: the robot is free")
    return Parts(parts.name, parts.links[1:], parts.joints[1:])


def is_held_by_world(parts: Parts, report: Report) -> bool:
    """Whether the robot's root is a link `world`, which Gazebo takes for the world itself."""
    if parts.links[0].name != WORLD or len(parts.links) == 1:
        return False
    report.applied(f"link {WORLD!r}", "it is the world: the robot does not move from its place")
    return True


def _check_names(parts: Parts) -> None:
    if not parts.links:
        raise ModelError("the robot has no links; it needs at least one", slug="urdf.no_links")
    if len(parts.links) > MAX_LINKS:
        raise ModelError(
            f"the robot has {len(parts.links)} links; at most {MAX_LINKS} are simulated",
            slug="urdf.size",
        )
    for what, names in (
        ("link", [link.name for link in parts.links]),
        ("joint", [joint.name for joint in parts.joints]),
    ):
        twice = _repeated(names)
        if twice:
            raise ModelError(
                f"{what} names {listed(twice)} are used more than once; make them unique",
                slug=f"urdf.duplicate_{what}",
            )


def _check_ends(joints: Iterable[Joint], links: dict[str, Link]) -> None:
    for joint in joints:
        for end, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                raise ModelError(
                    f"joint {joint.name!r} has {end} {name!r}, which is no link of this robot",
                    slug=f"urdf.unknown_{end}",
                )
        if joint.parent == joint.child:
            raise ModelError(
                f"joint {joint.name!r} joins link {joint.child!r} to itself", slug="urdf.cycle"
            )


def _check_single_parents(joints: Iterable[Joint]) -> None:
    twice = _repeated([joint.child for joint in joints])
    if twice:
        raise ModelError(
            f"links {listed(twice)} are the child of more than one joint; a link has one parent",
            slug="urdf.two_parents",
        )


def _root(parts: Parts) -> str:
    children = {joint.child for joint in parts.joints}
    roots = [link.name for link in parts.links if link.name not in children]
    if not roots:
        raise ModelError(
            "the joints make a cycle; one link must be the child of none", slug="urdf.cycle"
        )
    if len(roots) > 1:
        raise ModelError(
            f"links {listed(roots)} are all roots; join them so that one is left",
            slug="urdf.two_roots",
        )
    return roots[0]


def _depth_first(root: str, joints: Sequence[Joint]) -> list[Joint]:
    below: dict[str, list[Joint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)
    ordered: list[Joint] = []
    waiting = below.get(root, [])[::-1]
    while waiting:
        joint = waiting.pop()
        ordered.append(joint)
        waiting.extend(below.get(joint.child, [])[::-1])
    return ordered


def _repeated(names: Iterable[str]) -> list[str]:
    return [name for name, count in Counter(names).items() if count > 1]
