"""The pose graph of an SDF model: frames by scoped name, such as `arm::hand`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.model_messages import Origin
from zensim.proto.rigid_transforms import compose, invert
from zensim.sim_server.description.parsed_model import MODEL_FRAME
from zensim.sim_server.description.strict_parsing import quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from zensim.sim_server.description.sdf.sdf_values import RelativePose

SCOPE_SEPARATOR = "::"


def to_scoped_name(scope: str, name: str) -> str:
    """Make the name, in the top model, of an element in a scope."""
    return f"{scope}{SCOPE_SEPARATOR}{name}" if scope else name


class PoseGraph:
    """Frames by scoped name; the top model's frame is `__model__`, at the identity."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Origin]] = {}
        self._placements: dict[str, str] = {}
        self._poses: dict[str, Origin] = {MODEL_FRAME: Origin()}

    def add(self, name: str, pose: RelativePose, *, scope: str, implied: str) -> None:
        """Add a frame; a frame with a known name is ignored.

        Args:
            name: Without its scope.
            pose: Relative to a frame of the scope.
            scope: Scoped name of the model that contains the frame; empty for the top model.
            implied: The reference frame, in the scope, of a pose that names none.
        """
        parent = self.full_name(scope, pose.frame or implied)
        self._parents.setdefault(to_scoped_name(scope, name), (parent, pose.origin))

    def set_placement_frame(self, model: str, frame: str) -> None:
        """Make the pose of a nested or merged model that of one of its frames, by scoped name."""
        self._placements.setdefault(model, frame)

    @staticmethod
    def full_name(scope: str, name: str) -> str:
        """Make the name, in the top model, of a frame in a scope."""
        if name.endswith(MODEL_FRAME):
            inside = name.removesuffix(MODEL_FRAME).removesuffix(SCOPE_SEPARATOR)
            return (to_scoped_name(scope, inside) if inside else scope) or MODEL_FRAME
        return to_scoped_name(scope, name)

    def has(self, name: str) -> bool:
        """Whether a scoped name is a frame."""
        return name in self._parents or name == MODEL_FRAME

    def pose(self, name: str) -> Origin:
        """Find the pose of a frame in the top model.

        Raises:
            ModelError: The frame does not exist, or poses are relative to each other in a cycle.
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
                    f"the pose of frame {quote(at)} is relative to itself; "
                    "make one pose of its chain relative to the model",
                    slug="sdf.pose_cycle",
                )
            if at not in self._parents:
                raise ModelError(
                    f"frame {quote(at)} does not exist; use a link, joint, frame or nested model",
                    slug="sdf.unknown_frame",
                )
            chain[at] = None
            at = self._parents[at][0]
        return list(chain)
