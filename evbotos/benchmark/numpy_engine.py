"""The eight operations of the thesis's benchmark (section 5.2) in numpy, each timed once, and each answer examined.

`python3 numpy_engine.py N` prints a line of JSON for each operation. It needs numpy alone, to run in any image.
The factors L and U are made by solving one system: numpy has no call that returns them.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np


def timed(name: str, work: Callable[[], Any], error_of: Callable[[Any], float]) -> Any:
    """Print how long a piece of work takes, and return its answer; ends the program if the answer is wrong."""
    start_s = perf_counter()
    answer = work()
    seconds = perf_counter() - start_s
    error = error_of(answer)
    if not error < 1e-6:
        sys.exit(f"{name}: the answer is wrong: its error is {error:g}")
    print(json.dumps({"operation": name, "seconds": round(seconds, 6)}), flush=True)  # noqa: T201
    return answer


def main(n: int) -> None:
    """Run the benchmark.

    Args:
        n: rows and columns of the matrix.
    """
    print(json.dumps({"engine": f"numpy {np.__version__}"}), flush=True)  # noqa: T201
    random, norm, solver = np.random.default_rng(1), np.linalg.norm, np.linalg
    a = timed("create", lambda: random.random((n, n)), lambda found: float(abs(found.mean() - 0.5) > 3 / n))
    x = random.random(n)
    image = a @ x
    timed("multiply", lambda: a @ a, lambda b: float(norm(b @ x - a @ image) / norm(b @ x)))
    timed("lu", lambda: solver.solve(a, image), lambda found: float(norm(found - x) / norm(x)))
    timed("inverse", lambda: solver.inv(a), lambda b: float(norm(a @ (b @ x) - x) / norm(x)))
    timed("svd", lambda: solver.svd(a), lambda f: float(norm(f[0] @ (f[1] * (f[2] @ x)) - image) / norm(image)))
    timed("qr", lambda: solver.qr(a), lambda f: float(norm(f[0] @ (f[1] @ x) - image) / norm(image)))
    timed("eigen", lambda: solver.eig(a), lambda f: float(norm(a @ f[1][:, 0] - f[0][0] * f[1][:, 0]) / abs(f[0][0])))
    timed("rank", lambda: solver.matrix_rank(a), lambda rank: float(abs(rank - n)))


if __name__ == "__main__":
    main(int(sys.argv[1]))
