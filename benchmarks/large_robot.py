"""A large robot with mesh files: a hundred links, twenty fine meshes."""

import numpy as np
import trimesh

from tests.hostile.case import BODY, joint, link, solid

LINKS = 100
MESHES = 20
RINGS = 71
"""Segments of a ball of 20,160 triangles."""
ENDINGS = ("stl", "obj", "dae", "glb")
ROUGHNESS = 0.05
RADIUS_M = 0.1
ROW, APART_M = 10, 0.3


def meshes(seed: int, count: int = MESHES) -> dict[str, bytes]:
    """Make different rough balls, by the names used in `text`."""
    rng = np.random.default_rng(seed)
    return {_name(i): _exported(a_ball(rng), _name(i)) for i in range(count)}


def a_ball(rng: np.random.Generator) -> trimesh.Trimesh:
    """Make a ball with a rough surface."""
    ball = trimesh.creation.uv_sphere(radius=RADIUS_M, count=[RINGS, RINGS])
    ball.vertices *= 1.0 + ROUGHNESS * rng.standard_normal((len(ball.vertices), 1))
    return ball


def text(links: int = LINKS, count: int = MESHES, *, is_held: bool = False) -> str:
    """Write links around a root, with collision and visual meshes; every fifth joint turns.

    Args:
        links: Number of links.
        count: Number of meshes, which links use in turn.
        is_held: Whether the model is static: triangles collide without approximation.
    """
    world = link("world", "") + joint("held", "world", "l0", "fixed") if is_held else ""
    bodies = "".join(link(f"l{i}", BODY + _shape(i % count)) for i in range(links))
    joints = "".join(
        joint(f"j{i}", "l0", f"l{i}", "fixed" if i % 5 or is_held else "continuous", _place(i))
        for i in range(1, links)
    )
    return f'<robot name="huge">{world}{bodies}{joints}</robot>'


def _place(number: int) -> str:
    return f'<origin xyz="{number % ROW * APART_M} {number // ROW * APART_M} 0"/>'


def _shape(number: int) -> str:
    mesh = f'<mesh filename="{_name(number)}"/>'
    return solid(mesh, "visual") + solid(mesh)


def _name(number: int) -> str:
    return f"{number}.{ENDINGS[number % len(ENDINGS)]}"


def _exported(mesh: trimesh.Trimesh, name: str) -> bytes:
    data = mesh.export(file_type=name.rpartition(".")[2])
    return data.encode() if isinstance(data, str) else bytes(data)
