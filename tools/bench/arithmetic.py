"""The arithmetic of answers in C: what an answer would take if calls cost nothing.

What :func:`imgloc.localize` asks of NumPy and OpenCV is recorded, and asked of ``kernels.c`` again:
the sums of the exhaustive level and of the finer ones, the steps that poses take, and the rays.
That is the same work to the last pose, and the results are compared. The choice among sums, scores,
masses and covariances are not in it.
"""

import ctypes
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import numpy.typing as npt

from imgloc import ConfigError, LaserScan, MapFeatures, Options, localize
from imgloc.features.distance import SLOPE, UNIT, DistanceField
from imgloc.geometry import wrap
from imgloc.likelihoods.slices import cell_offsets, frame_of
from imgloc.model import FloatArray
from imgloc.search import priors, proposals, rescore
from imgloc.search.refine import DAMPING, MAX_STEP

_WHERE = (
    (proposals, "correlate"), (proposals, "sums_under"), (priors, "refine"),
    (rescore, "cast_along"),
)  # fmt: skip
STEPS = tuple(name for _, name in _WHERE)
"""What is recorded: the exhaustive level, the finer levels, the refinement, the rays."""
_FLAGS = ["-O3", "-march=native", "-ffast-math", "-fno-finite-math-only", "-shared", "-fPIC"]
Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Call:
    """A call that was made for an answer, and its result."""

    arguments: tuple[Any, ...]
    more: dict[str, Any]
    result: Array


@dataclass(frozen=True)
class Replay:
    """A step of an answer in C."""

    ms: float  #: milliseconds of a processor
    differs: FloatArray  #: from each number of the product: a sum; metres and radians; metres


@contextmanager
def recording() -> Iterator[dict[str, list[Call]]]:
    """Record the calls of :data:`STEPS` that are made meanwhile, by their names."""
    calls: dict[str, list[Call]] = {name: [] for name in STEPS}

    def kept(name: str, call: Any) -> Any:
        def asked(*arguments: Any, **more: Any) -> Any:
            result = call(*arguments, **more)
            calls[name].append(Call(arguments, more, np.array(result)))
            return result

        return asked

    with ExitStack() as patched:
        for module, name in _WHERE:
            patched.enter_context(patch.object(module, name, kept(name, getattr(module, name))))
        yield calls


class Kernels:
    """``kernels.c``, compiled for this machine.

    Raises
    ------
    ConfigError
        If there is no C compiler, or it refuses the file.
    """

    def __init__(self) -> None:
        compiler = shutil.which("cc")
        if compiler is None:
            raise ConfigError("no C compiler (cc) is there, so the arithmetic is not measured")
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / "kernels.so"
            source = Path(__file__).with_name("kernels.c")
            words: tuple[str | Path, ...] = (compiler, *_FLAGS, source, "-o", made, "-lm")
            done = subprocess.run(words, check=False, capture_output=True, text=True)  # noqa: S603
            if done.returncode:
                why = done.stderr.strip().splitlines()[-1]
                raise ConfigError(f"{source.name} is not compiled: {why}")
            self._library = ctypes.CDLL(str(made))

    def replay(
        self, features: MapFeatures, scan: LaserScan, options: Options | None = None
    ) -> dict[str, Replay]:
        """Locate a scan, and do in C again what was asked for, by the names of :data:`STEPS`."""
        with recording() as calls:
            localize(features, scan, options)
        found = dict[str, Replay]()
        for name, each in calls.items():
            again = getattr(self, f"_{name}")
            done = [again(*call.arguments, result=call.result, **call.more) for call in each]
            off = [_differs(c, call.result) for (_, c), call in zip(done, each, strict=True)]
            found[name] = Replay(1e3 * sum(s for s, _ in done), np.concatenate([np.empty(0), *off]))
        return found

    def _ask(self, name: str, *arguments: Array | float) -> float:
        """Call a kernel; the seconds of the processor that it takes."""
        held = [np.ascontiguousarray(v) if isinstance(v, np.ndarray) else v for v in arguments]
        given = [_as_c(one) for one in held]
        start = time.thread_time()
        getattr(self._library, name)(*given)
        return time.thread_time() - start

    def _correlate(
        self, image: Array, xy: Array, thetas: Array, resolution: float, *, where: Array,
        result: Array, **_: Any,
    ) -> tuple[float, Array]:  # fmt: skip
        view = frame_of(image != 0, len(thetas), where, None)
        image = np.ascontiguousarray(image[view.window])
        shifts = cell_offsets(xy, thetas, resolution).clip(-max(image.shape), max(image.shape))
        few = result.dtype == np.uint8
        sums = np.empty((len(thetas), *image.shape), np.uint8 if few else np.uint16)
        seconds = self._ask(
            "correlate_bytes" if few else "correlate_words", image, *image.shape,
            shifts.astype(np.int32), len(thetas), len(xy), sums,
        )  # fmt: skip
        out = np.zeros(result.shape)
        out[(slice(None), *view.window)] = sums if view.where is None else sums * view.where
        return seconds, out

    def _sums_under(
        self, images: Sequence[Array], offsets: Array, k: Array, base: Array, *, result: Array
    ) -> tuple[float, Array]:
        quads, first = len(images) == 1, [image.ctypes.data for image in images]
        if quads:  # the bytes of four cells stand side by side
            first = [first[0] + j for j in range(4)]
        out = np.empty(result.shape, np.int32)
        offsets, k, base = (np.ascontiguousarray(v, np.int64) for v in (offsets, k, base))
        seconds = self._ask(
            "sums_under", np.array(first, np.uintp), 4 if quads else 1, offsets, offsets.shape[1],
            k, base, len(k), out,
        )  # fmt: skip
        return seconds, out

    def _refine(
        self, poses: Array, xy: Array, field: DistanceField, *, sigmas: Sequence[float],
        iterations: int = 2, result: Array,
    ) -> tuple[float, Array]:  # fmt: skip
        out = np.array(poses, np.float64)
        seconds = self._ask(
            "refine", out, len(out), xy.astype(np.float32), len(xy), field.table, field.height,
            field.width, field.resolution, UNIT, SLOPE, np.array(sigmas, np.float64), len(sigmas),
            iterations, MAX_STEP.astype(np.float64), DAMPING,
        )  # fmt: skip
        out[:, 2] = result[:, 2] + wrap(out[:, 2] - result[:, 2])
        return seconds, out

    def _cast_along(
        self, distance: Array, origins: Array, cosines: Array, sines: Array, reach: Array,
        resolution: float, **_: Any,
    ) -> tuple[float, Array]:  # fmt: skip
        x, y, u, v, far = np.broadcast_arrays(
            origins[..., 0] / resolution, origins[..., 1] / resolution, cosines, sines,
            np.asarray(reach) / resolution,
        )  # fmt: skip
        start, along = (np.stack(of, -1).astype(np.float32) for of in ((x, y), (u, v)))
        out = np.empty(x.shape, np.float32)
        seconds = self._ask(
            "cast", distance, *distance.shape, start, along, far.astype(np.float32), x.size, out
        )
        return seconds, out * resolution


def _differs(one: Array, other: Array) -> FloatArray:
    """How much two results differ; a ray that ends at its very reach may meet nothing in one."""
    both = np.isfinite(one) & np.isfinite(other)
    return np.asarray(np.abs(one[both] - other[both]), np.float64)


def _as_c(value: Array | float) -> Any:
    """An argument for a kernel: a pointer, a double or a long."""
    if isinstance(value, np.ndarray):
        return ctypes.c_void_p(value.ctypes.data)
    return ctypes.c_double(value) if isinstance(value, float) else ctypes.c_long(value)
