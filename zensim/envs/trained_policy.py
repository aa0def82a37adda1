"""Policy: a trained network that makes actions from observations; and those that are shipped."""

import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import IO, Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Invalid

Numbers = npt.NDArray[np.float32]
Layer = tuple[Numbers, Numbers]
"""Weights (inputs, outputs) and bias (outputs,)."""
File = str | Path | IO[bytes]
ACTIONS = (2,)


class Policy:
    """Layers with tanh between them, on observations that are scaled to mean 0 and deviation 1.

    Attributes:
        task: Name of the task that it was trained for.
        settings: Those of the environments in which it was trained; see `EnvKeywords`.
    """

    def __init__(
        self,
        task: str,
        settings: Mapping[str, Any],
        *,
        scale: tuple[Numbers, Numbers],
        layers: Sequence[Layer],
    ) -> None:
        """Make a policy.

        Args:
            task: See the class.
            settings: See the class; values of JSON.
            scale: Mean and deviation of each number of an observation, (d,).
            layers: From d inputs to 2 outputs.

        Raises:
            Invalid: Sizes do not match, or a number is not finite.
        """
        self.task, self.settings, self._scale, self._layers = task, dict(settings), scale, layers
        shapes = [one.shape for one in scale] + [bias.shape for _, bias in layers]
        wanted = [before + after for before, after in pairwise(shapes[1:])]
        found = [weights.shape for weights, _ in layers]
        numbers = [*scale, *(array for layer in layers for array in layer)]
        fits = found == wanted and shapes[0] == shapes[1] and shapes[-1] == ACTIONS
        if not fits or not all(np.isfinite(one).all() for one in numbers):
            raise Invalid(f"the numbers of a policy for '{task}' do not fit each other: {shapes}")

    @classmethod
    def load(cls, file: File) -> "Policy":
        """Read what `save` wrote; code in the file is not run.

        Raises:
            OSError: It cannot be read.
            Invalid: It is no policy.
        """
        try:
            with np.load(file, allow_pickle=False) as found:
                facts, count = json.loads(str(found["facts"])), len(found.files) // 2 - 1
                layers = [(found[f"weights{i}"], found[f"bias{i}"]) for i in range(count)]
                scale = found["mean"], found["deviation"]
            return cls(facts["task"], facts["settings"], scale=scale, layers=layers)
        except (ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
            hint = "use a file that Policy.save wrote"
            raise Invalid(f"{file} is no policy: {error}", hint=hint) from error

    def save(self, file: File) -> None:
        """Write a file; raises OSError."""
        facts = json.dumps({"task": self.task, "settings": self.settings})
        arrays: dict[str, Any] = dict(zip(("mean", "deviation"), self._scale, strict=True))
        for number, (weights, bias) in enumerate(self._layers):
            arrays |= {f"weights{number}": weights, f"bias{number}": bias}
        np.savez_compressed(file, facts=np.array(facts), **arrays)

    def act(self, observations: npt.ArrayLike) -> Numbers:
        """Find the actions (..., 2) for observations (..., d), without noise, from -1 to 1.

        Raises:
            Invalid: The observations are of another task.
        """
        mean, deviation = self._scale
        rows: Numbers = np.asarray(observations, np.float32)
        if rows.shape[-1:] != mean.shape:
            raise Invalid(
                f"observations have shape {rows.shape}",
                slug="wrong_shape",
                hint=f"a policy for '{self.task}' takes {mean.shape} of each robot",
            )
        rows = (rows - mean) / deviation
        for weights, bias in self._layers[:-1]:
            rows = np.tanh(rows @ weights + bias)
        weights, bias = self._layers[-1]
        return np.asarray(np.clip(rows @ weights + bias, -1.0, 1.0))


def load_baseline(task: str) -> Policy:
    """Load the policy that is shipped for a task; docs/learning.md says how well it does.

    Raises:
        Invalid: There is none.
    """
    folder = files("zensim.envs") / "baselines"
    known = sorted(one.name.removesuffix(".npz") for one in folder.iterdir())
    if task not in known:
        raise Invalid(f"task '{task}' has no baseline", hint=f"use {', '.join(known)}")
    with (folder / f"{task}.npz").open("rb") as stream:
        return Policy.load(stream)
