from typing import Literal

import numpy as np
import numpy.typing as npt

class EmbreeScene:
    def __init__(self, device: object = None, robust: bool = False) -> None: ...
    def run(
        self,
        vec_origins: npt.NDArray[np.float32],
        vec_directions: npt.NDArray[np.float32],
        *,
        dists: npt.NDArray[np.float32],
        query: Literal["INTERSECT"],
        output: Literal[True],
    ) -> dict[str, npt.NDArray[np.float32]]: ...
