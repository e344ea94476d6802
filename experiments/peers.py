"""Other implementations of hyjax's steps: a loop in C, torch, OpenCV's filters and ONNX Runtime.

`bench_peers` compares with them. Each is written from the formula or calls a library; without the library
it is left out with a line on stderr.
"""

import contextlib
import ctypes
import functools
import importlib
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from experiments.peers_report import SMOOTHER
from hyjax.core.schedule import Schedule
from hyjax.util.errors import InputError
from hyjax.util.images import to_bytes

# Eq. 2, one pass over memory a step; what a C programmer writes first, with the compiler told to use the machine.
SOURCE = r"""
#include <stddef.h>

static void rows(const float *restrict y, float *restrict out, const float *restrict cv, const float *restrict ch,
                 int h, int w, int from, int to, float lam) {
  for (int i = from; i < to; i++) {
    const float *s = y + (size_t)i * w, *u = i ? s - w : s, *d = i < h - 1 ? s + w : s;
    const float *vu = cv + (size_t)(i ? i - 1 : 0) * w, *vd = cv + (size_t)(i < h - 1 ? i : h - 2) * w;
    const float *e = ch + (size_t)i * (w - 1);
    float *o = out + (size_t)i * w;
    o[0] = s[0] + lam * (vu[0] * (u[0] - s[0]) + vd[0] * (d[0] - s[0]) + e[0] * (s[1] - s[0]));
    for (int j = 1; j < w - 1; j++)
      o[j] = s[j] + lam * (vu[j] * (u[j] - s[j]) + vd[j] * (d[j] - s[j])
                         + e[j] * (s[j + 1] - s[j]) + e[j - 1] * (s[j - 1] - s[j]));
    int k = w - 1;
    o[k] = s[k] + lam * (vu[k] * (u[k] - s[k]) + vd[k] * (d[k] - s[k]) + e[k - 1] * (s[k - 1] - s[k]));
  }
}

/* n steps, from a to b and back; the result is in a if n is even, else in b. */
void diffuse(float *a, float *b, const float *cv, const float *ch, int channels, int h, int w, int n, float lam) {
#pragma omp parallel
  for (int s = 0; s < n; s++) {
    const float *from = s % 2 ? b : a;
    float *to = s % 2 ? a : b;
#pragma omp for collapse(2) schedule(static)
    for (int c = 0; c < channels; c++)
      for (int block = 0; block < 16; block++)
        rows(from + (size_t)c * h * w, to + (size_t)c * h * w, cv, ch, h, w,
             h * block / 16, h * (block + 1) / 16, lam);
  }
}

/* Copies n floats from a to b and back, so many times. */
void copy(float *a, float *b, long n, int times) {
#pragma omp parallel
  for (int t = 0; t < times; t++) {
    const float *from = t % 2 ? b : a;
    float *to = t % 2 ? a : b;
#pragma omp for simd schedule(static)
    for (long i = 0; i < n; i++) to[i] = from[i];
  }
}
"""
FLAGS = ["-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fopenmp", "-shared", "-fPIC"]
"""Not -ffast-math: a library linked with it makes the process that loads it flush subnormal numbers to zero."""


Steps = Callable[..., Any]


class Floor:
    """The C loop, compiled on the spot.

    Its buffers stay where they are from call to call, where ours are made anew in each: a floor, not a peer.

    Raises:
        InputError: it cannot be compiled here.
    """

    def __init__(self) -> None:
        with tempfile.TemporaryDirectory() as folder:  # what is loaded stays when its file is gone
            source, library = (Path(folder) / name for name in ("floor.c", "floor.so"))
            source.write_text(SOURCE)
            try:
                subprocess.run(["cc", *FLAGS, "-o", str(library), str(source)], check=True, capture_output=True)
                self._library = ctypes.CDLL(str(library))
                self._openmp = ctypes.CDLL("libgomp.so.1")
            except (OSError, subprocess.CalledProcessError) as error:
                raise InputError(
                    f"bench_peers: needs gcc with OpenMP as cc to compile the floor ({error})"
                ) from None

    def diffuse(
        self, y: Float[np.ndarray, "c h w"], edges: Sequence[np.ndarray], steps: int, lam: float, threads: int
    ) -> Callable[[], np.ndarray]:
        """A call that does `steps` steps on `y` in place, so that calls go on where the last one ended."""
        state, other = np.array(y, np.float32, order="C"), np.empty(y.shape, np.float32)
        vertical, horizontal = (np.ascontiguousarray(edge, np.float32) for edge in edges)

        def call() -> np.ndarray:
            self._openmp.omp_set_num_threads(threads)
            pointers = (array.ctypes.data_as(ctypes.c_void_p) for array in (state, other, vertical, horizontal))
            self._library.diffuse(*pointers, *y.shape, steps, ctypes.c_float(lam))
            return state if steps % 2 == 0 else other

        return call

    def copy(self, floats: int, times: int, threads: int) -> Callable[[], None]:
        """A call that copies so many floats, so many times."""
        source, target = np.ones(floats, np.float32), np.zeros(floats, np.float32)

        def call() -> None:
            self._openmp.omp_set_num_threads(threads)
            pointers = (array.ctypes.data_as(ctypes.c_void_p) for array in (source, target))
            self._library.copy(*pointers, ctypes.c_long(floats), times)

        return call


@functools.cache
def optional(name: str) -> Any:
    """A module that need not be there; None, and a word on stderr, if it is not."""
    try:
        return importlib.import_module(name)
    except ImportError:
        print(f"bench_peers: {name} is not installed and is left out", file=sys.stderr)
        return None


# ---- torch, written from the formula, channels first with a batch ----


def torch_tensor(torch: Any, values: np.ndarray) -> Any:
    """Values on the kind of device that hyjax runs on, if torch can."""
    return torch.tensor(values, device="cuda" if _both_on_a_gpu(torch) else "cpu")


def _both_on_a_gpu(torch: Any) -> bool:
    return jax.default_backend() == "gpu" and torch.cuda.is_available()


@contextlib.contextmanager
def torch_values(torch: Any) -> Iterator[None]:
    """Context without derivatives, which ends when what was begun in it is done."""
    with torch.inference_mode():
        yield
    if _both_on_a_gpu(torch):
        torch.cuda.synchronize()


def torch_conductance(guide: Any, kappa: float) -> list[Any]:
    """Eq. 3 of a guide B×F×H×W."""
    vertical, horizontal = guide[:, :, 1:] - guide[:, :, :-1], guide[..., 1:] - guide[..., :-1]
    return [kappa**2 / (kappa**2 + (d * d).sum(1, keepdim=True)) for d in (vertical, horizontal)]


def torch_steps(y: Any, vertical: Any, horizontal: Any, steps: int) -> Any:
    """Eq. 2, repeated: fluxes along the edges, added on one side and taken on the other.

    `vertical` and `horizontal` are conductances times λ.
    """
    for _ in range(steps):
        down = vertical * (y[:, :, 1:] - y[:, :, :-1])
        right = horizontal * (y[..., 1:] - y[..., :-1])
        y = y.clone()
        y[:, :, :-1] += down
        y[:, :, 1:] -= down
        y[..., :-1] += right
        y[..., 1:] -= right
    return y


def torch_compiled(torch: Any) -> Steps:
    """`torch_steps`, compiled a step at a time: several it fuses, and computes them again for every neighbour."""
    torch.compiler.reset()
    step = torch.compile(functools.partial(torch_steps, steps=1), dynamic=False)

    def run(y: Any, vertical: Any, horizontal: Any, steps: int) -> Any:
        for _ in range(steps):
            y = step(y, vertical, horizontal)
        return y

    return run


def torch_cascade(y: Any, guide: Any, schedule: Schedule, run: Steps = torch_steps) -> Any:
    """Eq. 4 with conductances by the guide's own coarse pictures, bilinear in between."""
    from torch.nn.functional import avg_pool2d, interpolate

    state = None
    for level in schedule.levels:
        cells = avg_pool2d(guide, level.factor)
        if state is None:
            state = avg_pool2d(y, level.factor)
        else:
            state = interpolate(state, size=cells.shape[-2:], mode="bilinear", align_corners=False)
        lam = float(np.asarray(level.step_sizes)[0])
        edges = [lam * edge for edge in torch_conductance(cells, float(level.kappa))]
        state = run(state, *edges, level.steps)
    return interpolate(state, size=y.shape[-2:], mode="bilinear", align_corners=False)


# ---- OpenCV's edge-aware filters ----


Filter = Callable[[Float[np.ndarray, "h w c"], float, float], Float[np.ndarray, "h w c"]]
STRENGTHS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)


def opencv_filters(guide: Float[np.ndarray, "h w 3"]) -> dict[str, tuple[Filter, tuple[float, ...]]]:
    """Filters of `cv2.ximgproc` under a display-encoded guide by name, each with the reaches to try.

    A filter takes channels, a strength (how far apart two colours of the guide are that are kept apart, on its
    scale of 0 to 1, see `STRENGTHS`) and a reach, which means something else for each.
    """
    cv2 = optional("cv2")
    if cv2 is None or not hasattr(cv2, "ximgproc"):
        return {}
    eight_bits = to_bytes(guide)
    floats = np.ascontiguousarray(guide, np.float32)

    def global_smoother(y: np.ndarray, strength: float, smoothness: float) -> np.ndarray:
        return cv2.ximgproc.createFastGlobalSmootherFilter(eight_bits, smoothness, 255 * strength).filter(y)

    def guided(y: np.ndarray, strength: float, radius: float) -> np.ndarray:
        return cv2.ximgproc.createGuidedFilter(floats, int(radius), strength**2).filter(y)

    def bilateral_solver(y: np.ndarray, strength: float, spatial: float) -> np.ndarray:
        """Filter with confidences, taken from the last channel; its result is divided by them already."""
        sigma = max(255 * strength, 1.0)
        made = cv2.ximgproc.createFastBilateralSolverFilter(eight_bits, spatial, sigma, sigma)
        confidence, largest = np.ascontiguousarray(y[..., -1]), max(float(y[..., :-1].max()), 1e-6)
        values = np.moveaxis(y[..., :-1], -1, 0) / largest  # it wants values in [0, 1]
        solved = [made.filter(np.ascontiguousarray(channel), confidence) * largest for channel in values]
        return np.stack([*solved, np.ones_like(confidence)], axis=-1)

    filters: dict[str, tuple[Filter, tuple[float, ...]]] = {
        SMOOTHER: (global_smoother, (3.0, 10.0, 30.0, 100.0, 1_000.0, 10_000.0)),
        "OpenCV guidedFilter": (guided, (8.0, 16.0, 32.0, 64.0)),
    }
    if _has_bilateral_solver():
        filters["OpenCV fastBilateralSolverFilter"] = (bilateral_solver, (8.0, 16.0, 32.0))
    return filters


@functools.cache
def _has_bilateral_solver() -> bool:
    """OpenCV's own wheels come without it."""
    cv2 = optional("cv2")
    try:
        cv2.ximgproc.createFastBilateralSolverFilter(np.zeros((8, 8, 3), np.uint8), 4.0, 8.0, 8.0)
    except cv2.error:
        print("bench_peers: this OpenCV was built without the fast bilateral solver", file=sys.stderr)
        return False
    return True


def opencv_diffusion(picture: Float[np.ndarray, "h w 3"], steps: int) -> Callable[[], np.ndarray] | None:
    """A call of `cv2.ximgproc.anisotropicDiffusion`, which takes 8 bits, three channels and no guide but itself."""
    cv2 = optional("cv2")
    if cv2 is None or not hasattr(cv2, "ximgproc"):
        return None
    eight_bits = to_bytes(picture)
    return lambda: cv2.ximgproc.anisotropicDiffusion(eight_bits, 0.2, 0.1, steps)


# ---- ONNX Runtime ----


def onnx_session(
    network: Any, normalised: Float[np.ndarray, "h w 3"], threads: int
) -> Callable[[], np.ndarray] | None:
    """A torch network exported to ONNX Runtime, as a call on one picture."""
    runtime = optional("onnxruntime")
    if runtime is None or optional("onnxscript") is None:
        return None
    import torch

    picture = torch.tensor(normalised).permute(2, 0, 1)[None].contiguous()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(), contextlib.redirect_stdout(None):
        warnings.simplefilter("ignore")
        path = Path(folder) / "network.onnx"
        torch.onnx.export(network, (picture,), str(path), dynamo=True, external_data=False, verbose=False)
        options = runtime.SessionOptions()
        options.intra_op_num_threads = threads
        session = runtime.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])
    inputs = {session.get_inputs()[0].name: picture.numpy()}
    return lambda: session.run(None, inputs)[0]
