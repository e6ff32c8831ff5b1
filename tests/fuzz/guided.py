"""Fuzz one target guided by coverage, with atheris: `python -m tests.fuzz.guided TARGET SECONDS`."""

from __future__ import annotations

import sys
import tempfile

import atheris

with atheris.instrument_imports(include=["eal_actors", "plugins"]):
    from tests.fuzz.corpus import CORPUS, MOST_BYTES, TARGETS, seeds


def main() -> None:
    """Search until the time is over, or a finding ends the process."""
    target, seconds = sys.argv[1:]
    with tempfile.TemporaryDirectory(prefix="eal-fuzz-seeds-") as folder:
        for number, seed in enumerate(seeds(target)):
            with open(f"{folder}/{number}", "wb") as file:  # noqa: PTH123  # pathlib is instrumented no less
                file.write(seed)
        options = [
            f"-max_total_time={seconds}",
            f"-max_len={MOST_BYTES}",
            "-timeout=60",
            "-report_slow_units=60",
            "-rss_limit_mb=2048",
            "-print_final_stats=1",
        ]
        findings = f"-artifact_prefix={CORPUS / target}/finding-"
        atheris.Setup([sys.argv[0], *options, findings, "-verbosity=0", folder], TARGETS[target])
        atheris.Fuzz()


if __name__ == "__main__":
    main()
