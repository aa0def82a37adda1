"""Worlds and bodies of the mechanics benchmark: descriptions written here, read by the service."""

import itertools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import zensim
from benchmarks.figures import Figure, Limit

G = 9.8
"""Gravity [m/s^2] of a world without one, as in SDF."""
MILLIMETRES = 1e3
Vector = tuple[float, float, float]
BLOCK_SIZE: Vector = (0.2, 0.2, 0.2)


def moments_of_box(mass_kg: float, size: Vector) -> Vector:
    """Compute ixx, iyy, izz [kg m^2] of a solid box."""
    x, y, z = (extent * extent for extent in size)
    return (mass_kg * (y + z) / 12.0, mass_kg * (x + z) / 12.0, mass_kg * (x + y) / 12.0)


def write_inertial(mass_kg: float, moments: Vector) -> str:
    """Write an <inertial> of URDF."""
    xx, yy, zz = moments
    return (
        f'<inertial><mass value="{mass_kg!r}"/><inertia ixx="{xx!r}" ixy="0" ixz="0" '
        f'iyy="{yy!r}" iyz="0" izz="{zz!r}"/></inertial>'
    )


def write_box(
    size: Vector = BLOCK_SIZE,
    *,
    mass_kg: float = 1.0,
    tags: str = "",
    moments: Vector | None = None,
    is_static: bool = False,
) -> str:
    """Write a URDF of a box; tags are those of its <gazebo reference>."""
    inertial = write_inertial(mass_kg, moments or moments_of_box(mass_kg, size))
    x, y, z = size
    return (
        f'<robot name="box"><link name="box">{inertial}<collision><geometry>'
        f'<box size="{x!r} {y!r} {z!r}"/></geometry></collision></link>'
        f'<gazebo reference="box">{tags}</gazebo>'
        f"{'<gazebo><static>true</static></gazebo>' if is_static else ''}</robot>"
    )


def write_bounce(restitution: float, threshold: float = 0.0) -> str:
    """Write the <surface> of a rebound."""
    return (
        f"<surface><bounce><restitution_coefficient>{restitution!r}</restitution_coefficient>"
        f"<threshold>{threshold!r}</threshold></bounce></surface>"
    )


def write_ball(radius_m: float, *, bounce: str, kind: str, mass_kg: float = 1.0) -> str:
    """Write a ball with a <surface>, as URDF or SDF."""
    moment = 0.4 * mass_kg * radius_m**2
    if kind == "URDF":
        return (
            f'<robot name="ball"><link name="ball">{write_inertial(mass_kg, (moment,) * 3)}'
            f'<collision><geometry><sphere radius="{radius_m!r}"/></geometry></collision></link>'
            f'<gazebo reference="ball"><collision>{bounce}</collision></gazebo></robot>'
        )
    return (
        f'<sdf version="1.9"><model name="ball"><link name="ball"><inertial><mass>{mass_kg!r}'
        f"</mass><inertia><ixx>{moment!r}</ixx><iyy>{moment!r}</iyy><izz>{moment!r}</izz>"
        f'</inertia></inertial><collision name="c"><geometry><sphere><radius>{radius_m!r}'
        f"</radius></sphere></geometry>{bounce}</collision></link></model></sdf>"
    )


class Scene:
    """A world in process, and a folder for the descriptions of its bodies."""

    def __init__(self, world: zensim.World, folder: Path) -> None:
        self.world = world
        self._folder = folder
        self._numbers = itertools.count()

    def spawn(
        self, text: str, place: Vector = (0.0, 0.0, 0.0), *, rpy: Vector = (0.0, 0.0, 0.0)
    ) -> zensim.Robot:
        """Spawn a description at a pose."""
        number = next(self._numbers)
        kind = "sdf" if text.startswith("<sdf") else "urdf"
        file = self._folder / f"body{number}.{kind}"
        file.write_text(text)
        (x, y, z), (roll, pitch, yaw) = place, rpy
        return self.world.spawn(
            file, name=f"b{number}", x=x, y=y, z=z, roll=roll, pitch=pitch, yaw=yaw
        )

    def push(self, body: zensim.Robot, linear: Vector, angular: Vector = (0.0, 0.0, 0.0)) -> None:
        """Give a body a velocity, in the world's axes."""
        row = self.world.view.names.index(body.name)
        self.world.view.velocities[row] = (*linear, *angular)


@contextmanager
def open_scene(engine: str, **options: float) -> Iterator[Scene]:
    """Open an empty world with a ground."""
    with TemporaryDirectory() as folder, zensim.World(engine=engine, **options) as world:  # type: ignore[arg-type]
        yield Scene(world, Path(folder))


def deviation(engine: str, what: str, unit: str, samples: Sequence[float], most: float) -> Figure:
    """Make the figure of the deviations from an answer of the textbook."""
    limit = Limit("max", "<=", most)
    return Figure(
        what=f"{engine}: {what}", unit=unit, samples=tuple(map(abs, samples)), limit=limit
    )
