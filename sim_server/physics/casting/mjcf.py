"""A cast as MJCF text, the language that MuJoCo reads. Frames and units as the model's."""

from collections.abc import Callable, Iterable, Iterator, Sequence

from zensim.proto.messages.model_messages import Origin, Shape
from zensim.sim_server.physics.blueprint import Part
from zensim.sim_server.physics.casting.contact import Yield, grip, grip_of, motor, rigid
from zensim.sim_server.physics.casting.hulls import Points
from zensim.sim_server.physics.casting.make import Make, followers
from zensim.sim_server.physics.engine import MIN_INERTIA, MIN_MASS_KG, EngineConfig

Pieces = Callable[[Shape, bool], Sequence[Points]]
"""Convex pieces of a mesh, scaled; the flag says that it never moves."""
SLIP = 10.0
"""How much less a contact slips than it sinks."""
LEAST_RANGE = 1e-6
"""Between the limits of a joint that has both in one place [rad or m]."""
SLOT = "@"
"""Stands for the number of a slot in its text."""
JOINTS = ("revolute", "continuous", "prismatic", "fixed")
SHAPES = ("box", "sphere", "cylinder", "capsule", "mesh")
MAX_PARTS = 256
CYLINDRICAL = ("cylinder", "capsule")


def mjcf_of(slots: Iterable[tuple[Make, int]], config: EngineConfig, pieces: Pieces) -> str:
    """Write a world with a ground, if it has one, and so many slots of each make."""
    slots = list(slots)
    assets, names = _meshes([make for make, _ in slots], pieces)
    world, rules, gears = [_ground(config)], [""], [""]
    number = 0
    for make, count in slots:
        texts = (
            _body(make, 0, names, config.step_ns * 1e-9),
            "".join(_exclusions(make)),
            "".join(_gears(make, config.step_ns * 1e-9)),
        )
        for _ in range(count):
            for written, text in zip((world, rules, gears), texts, strict=True):
                written.append(text.replace(SLOT, str(number)))
            number += 1
    return (
        '<mujoco><compiler angle="radian" balanceinertia="true" boundmass="0"/>'
        f'<option timestep="{config.step_ns * 1e-9!r}" gravity="{_row(config.gravity)}" '
        f'integrator="implicitfast" cone="elliptic" jacobian="sparse" impratio="{SLIP}">'
        # Whether a step begins where the last one ended is chosen for all islands together.
        '<flag autoreset="disable" warmstart="disable"/></option>'
        f"<asset>{''.join(assets)}</asset><worldbody>{''.join(world)}</worldbody>"
        f"<contact>{''.join(rules)}</contact><equality>{''.join(gears)}</equality></mujoco>"
    )


Meshes = dict[tuple[Shape, bool], list[str]]


def _meshes(makes: Iterable[Make], pieces: Pieces) -> tuple[list[str], Meshes]:
    """Write each mesh once; name the pieces of each."""
    texts: list[str] = []
    names: Meshes = {}
    for make in makes:
        for shape in (shape for part in make.parts for shape in part.shapes if shape.mesh):
            key = shape, make.is_static
            if key in names:
                continue
            names[key] = []
            for points in pieces(shape, make.is_static):
                names[key].append(name := f"m{len(texts)}")
                texts.append(
                    f'<mesh name="{name}" inertia="convex" vertex="{_row(points.ravel())}"/>'
                )
    return texts, names


def geometries_of(make: Make, pieces: Pieces) -> list[Part]:
    """List the part that each geometry of a slot belongs to, in MuJoCo's order."""
    found: list[Part] = []

    def visit(link: int) -> None:
        for part, shape in make.shapes(link):
            found.extend([part] * (len(pieces(shape, make.is_static)) if shape.mesh else 1))
        for child in make.children(link):
            visit(child)

    visit(0)
    return found


def _ground(config: EngineConfig) -> str:
    if not config.has_ground:
        return ""
    found = grip(config.ground_friction, is_static=True)
    touch = _touch(found.friction, found.rank, found.rows, rigid(config.step_ns * 1e-9))
    return f'<geom type="plane" size="0 0 1" {touch}/>'


def _body(make: Make, link: int, names: Meshes, dt_s: float) -> str:
    part = make.bones[link]
    inside = [_inertial(part)]
    if link:
        inside.append(_joint(part, link, dt_s))
    elif not make.is_static:
        inside.append("<freejoint/>")
    inside.extend(_geometries(make, link, names, dt_s))
    inside.extend(_body(make, child, names, dt_s) for child in make.children(link))
    # Compiled in, as MuJoCo else passes over what is written into the model later.
    return (
        f'<body name="b{SLOT}.{link}" gravcomp="1" {_place(part.origin)}>{"".join(inside)}</body>'
    )


def _inertial(part: Part) -> str:
    moments = [max(moment, MIN_INERTIA) for moment in part.inertia]
    place = _place(Origin(part.com, part.principal))
    mass = max(part.mass_kg, MIN_MASS_KG)
    return f'<inertial {place} mass="{mass!r}" diaginertia="{_row(moments)}"/>'


def _joint(part: Part, link: int, dt_s: float) -> str:
    joint = part.joint
    if joint is None or joint.kind == "fixed":
        return ""
    kind = "slide" if joint.kind == "prismatic" else "hinge"
    limits = ""
    if joint.kind != "continuous" and joint.lower <= joint.upper:
        high = max(joint.upper, joint.lower + LEAST_RANGE)
        limits = f'limited="true" range="{joint.lower!r} {high!r}" {_how("limit", rigid(dt_s))} '
    return (
        f'<joint name="j{SLOT}.{link}" type="{kind}" axis="{_row(joint.axis)}" {limits}'
        f'damping="{joint.damping!r}" frictionloss="{joint.friction!r}" '
        f"{_how('friction', motor(dt_s))}/>"
    )


def _geometries(make: Make, link: int, names: Meshes, dt_s: float) -> Iterator[str]:
    for part, shape in make.shapes(link):
        found = grip_of(part, is_static=make.is_static)
        touch = _touch(found.friction, found.rank, found.rows, rigid(dt_s))
        rest = f"{_place(shape.origin)} {touch}/>"
        if shape.mesh:
            for name in names[shape, make.is_static]:
                yield f'<geom type="mesh" mesh="{name}" {rest}'
        else:
            yield f'<geom type="{shape.kind}" size="{_row(_size(shape))}" {rest}'


def _size(shape: Shape) -> tuple[float, ...]:
    if shape.kind == "box":
        return tuple(extent / 2.0 for extent in shape.size)
    radius, length, _ = shape.size
    return (radius, length / 2.0) if shape.kind in CYLINDRICAL else (radius,)


def _touch(friction: float, rank: int, rows: int, how: Yield) -> str:
    return f'friction="{friction!r} 0 0" priority="{rank}" condim="{rows}" mass="0" {_how("", how)}'


def _how(what: str, how: Yield) -> str:
    d = how.impedance
    return (
        f'solref{what}="{how.stiffness!r} {how.damping!r}" solimp{what}="{d!r} {d!r} 0.001 0.5 2"'
    )


def _place(origin: Origin) -> str:
    x, y, z, w = origin.orientation
    return f'pos="{_row(origin.position)}" quat="{_row((w, x, y, z))}"'


def _row(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _exclusions(make: Make) -> Iterator[str]:
    """Keep the links of a slot apart that do not touch each other."""
    solid = [link for link in range(len(make.bones)) if any(True for _ in make.shapes(link))]
    for i, one in enumerate(solid):
        for other in solid[i + 1 :]:
            asks = make.self_collides[one] or make.self_collides[other]
            if not asks or one == make.bones[other].parent or other == make.bones[one].parent:
                yield f'<exclude body1="b{SLOT}.{one}" body2="b{SLOT}.{other}"/>'


def _gears(make: Make, dt_s: float) -> Iterator[str]:
    index = {part.joint.name: link for link, part in enumerate(make.bones) if part.joint}
    for link in followers(make):
        joint = make.bones[link].joint
        if joint is not None and joint.mimic is not None:
            yield (
                f'<joint joint1="j{SLOT}.{link}" joint2="j{SLOT}.{index[joint.mimic.joint]}" '
                f'polycoef="{joint.mimic.offset!r} {joint.mimic.multiplier!r} 0 0 0" '
                f"{_how('', rigid(dt_s))}/>"
            )
