"""Models as engines get them: one object for all that differ in topics and reports alone."""

from collections import OrderedDict
from typing import Final

import msgspec

from zensim.proto.messages.drive_messages import RosBlock
from zensim.proto.messages.model_messages import Model

MAX_BODY_MODELS: Final = 512


class BodyModels:
    """Finds the model that bodies of equal name and build share.

    Engines prepare, plan and validate each model object once. Robots that are spawned one by one
    have a model each, as their descriptions have their namespaces.
    """

    def __init__(self) -> None:
        self._models: OrderedDict[Model, Model] = OrderedDict()
        self._last: tuple[Model, Model] | None = None

    def find(self, model: Model) -> Model:
        """Find the first model that was built alike; links, joints and motors are the same."""
        if self._last is None or self._last[0] is not model:
            self._last = model, self._models.setdefault(_find_build(model), model)
            if len(self._models) > MAX_BODY_MODELS:
                self._models.popitem(last=False)
        return self._last[1]


def _find_build(model: Model) -> Model:
    """Leave out of a model what no engine reads."""
    drive = model.drive
    if drive is not None:
        drive = msgspec.structs.replace(
            drive, ros=RosBlock(), command_topic="", odometry_topic="", odometry_frame=""
        )
    return msgspec.structs.replace(
        model,
        drive=drive,
        frames=(),
        joint_state=None,
        ground_truths=(),
        sensors=(),
        report=(),
        command_interfaces=(),
    )
