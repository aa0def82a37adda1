"""The pose graph of an SDF model: frames by scoped name, such as `arm::hand`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.model_messages import Origin
from zensim.proto.rigid_transforms import compose, invert
from zensim.sim_server.description.strict_parsing import quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from zensim.sim_server.description.sdf.sdf_values import RelativePose

MODEL_FRAME = "__model__"
SCOPE_SEPARATOR = "::"


def to_scoped_name(scope: str, name: str) -> str:
    """Write a name of a scope as the top model knows it."""
    return f"{scope}{SCOPE_SEPARATOR}{name}" if scope else name


class PoseGraph:
    """Frames by scoped name; the top model's own is `__model__`, at the identity."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Origin]] = {}
        self._placements: dict[str, str] = {}
        self._poses: dict[str, Origin] = {MODEL_FRAME: Origin()}

    def add(self, name: str, pose: RelativePose, *, scope: str, implied: str) -> None:
        """Place a frame; of two with one name the first counts.

        Args:
            name: Without its scope.
            pose: As written; its frame is looked for in the scope.
            scope: Scoped name of the model that it is in; empty for the top one.
            implied: The frame, in the scope, that an unnamed one means.
        """
        parent = self.full_name(scope, pose.frame or implied)
        self._parents.setdefault(to_scoped_name(scope, name), (parent, pose.origin))

    def set_placement_frame(self, model: str, frame: str) -> None:
        """Let the pose of a nested model say where one of its frames is, rather than itself."""
        self._placements.setdefault(model, self.full_name(model, frame))

    @staticmethod
    def full_name(scope: str, name: str) -> str:
        """Name a frame of a scope as the top model knows it."""
        if name.endswith(MODEL_FRAME):
            inside = name.removesuffix(MODEL_FRAME).removesuffix(SCOPE_SEPARATOR)
            return (to_scoped_name(scope, inside) if inside else scope) or MODEL_FRAME
        return to_scoped_name(scope, name)

    def has(self, name: str) -> bool:
        """Whether a scoped name is a frame."""
        return name in self._parents or name == MODEL_FRAME

    def parent_of(self, name: str) -> str:
        """Name the frame that a frame is placed in."""
        return self._parents[name][0]

    def pose(self, name: str) -> Origin:
        """Find where a frame is in the top model.

        Raises:
            ModelError: There is none, or frames are placed relative to each other in a circle.
        """
        chain = self._chain_to(name, stop=MODEL_FRAME)
        for link in reversed(chain):
            parent, _ = self._parents[link]
            self._poses[link] = compose(self._poses[parent], self._pose_in_parent(link))
        return self._poses[name]

    def _pose_in_parent(self, name: str) -> Origin:
        origin = self._parents[name][1]
        if name not in self._placements:
            return origin
        inner = Origin()
        for link in reversed(self._chain_to(self._placements[name], stop=name)):
            inner = compose(inner, self._pose_in_parent(link))
        return compose(origin, invert(inner))

    def _chain_to(self, name: str, *, stop: str) -> list[str]:
        chain: dict[str, None] = {}
        at = name
        while at != stop and (at not in self._poses or stop != MODEL_FRAME):
            if at in chain:
                raise ModelError(
                    f"frame {quote(at)} is placed relative to itself; "
                    "one of its chain must be relative to the model",
                    slug="sdf.pose_cycle",
                )
            if at not in self._parents:
                raise _unknown_frame_error(at)
            chain[at] = None
            at = self._parents[at][0]
        return list(chain)


def _unknown_frame_error(name: str) -> ModelError:
    return ModelError(
        f"frame {quote(name)} does not exist; name a link, joint, frame or nested model",
        slug="sdf.unknown_frame",
    )
