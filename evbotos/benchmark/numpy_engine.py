"""The eight operations of the thesis's benchmark (section 5.2) in numpy, each timed once and verified.

`python3 numpy_engine.py N` prints a line of JSON per operation. It needs only numpy, so it runs in any image.
It computes the factors L and U by solving one system, because numpy does not return them.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np


def timed(name: str, work: Callable[[], Any], error_of: Callable[[Any], float]) -> Any:
    """Print the duration of an operation and return its result; exit if the result is wrong."""
    start_s = perf_counter()
    answer = work()
    seconds = perf_counter() - start_s
    error = error_of(answer)
    if not error < 1e-6:
        sys.exit(f"{name}: wrong result, error {error:g}")
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
