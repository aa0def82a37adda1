"""Why the server refuses: one root, one class for each kind of refusal."""

from proto.result import ResultCode, SpawnCode


class SimError(Exception):
    """A request is refused; turned into a Result in one place."""

    code: int = ResultCode.OPERATION_FAILED

    def __init__(self, message: str) -> None:
        super().__init__(message)
        self.message = message


class ModelError(SimError):
    """A robot or world description cannot be used.

    `slug` names the fault for programs, such as `urdf.cycle`; the message is for people.
    """

    def __init__(
        self, message: str, *, code: int = SpawnCode.RESOURCE_PARSE_ERROR, slug: str
    ) -> None:
        super().__init__(message)
        self.code = code
        self.slug = slug
