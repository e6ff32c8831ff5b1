"""The pytest plugin `--eal-prove`: the proof of each scenario file as a test case.

pytest imports this module in every run of every project with the framework installed. So heavy modules are imported
lazily.
"""

from __future__ import annotations

from pathlib import Path

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("eal_actors", "simulated fleets of eal_actors")
    group.addoption("--eal-prove", action="store_true", help="with --eal: prove each scenario file as well")
    group.addoption(
        "--eal-prove-runs", type=int, default=250, metavar="N", help="largest number of runs of a proof (default: 250)"
    )


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Collect scenario files as proofs, with --eal and --eal-prove."""
    options = parent.config.option
    if not (options.eal_prove and getattr(options, "eal", False)) or file_path.suffix not in (".yaml", ".yml"):
        return None
    from eal_actors.lab.proof.proof_cases import collect_proof

    return collect_proof(file_path, parent)
