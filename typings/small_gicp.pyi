import numpy as np
import numpy.typing as npt

_Floats = npt.NDArray[np.float64]

class RegistrationResult:
    T_target_source: _Floats

def align(
    target_points: _Floats,
    source_points: _Floats,
    init_T_target_source: _Floats = ...,
    *,
    downsampling_resolution: float = 0.25,
    max_correspondence_distance: float = 1.0,
) -> RegistrationResult: ...
