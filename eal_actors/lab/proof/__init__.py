"""Proofs: run a scenario in simulation under every fault at every step of every robot, and judge each run.

`matrix` plans the cases, `trial` runs one, `invariants` judges it, `shrinking` reduces a finding to the least fleet
file that shows it, and `page` shows the result. `prove` does all of it in worker processes.
"""

from eal_actors.lab.proof.invariants import Violation
from eal_actors.lab.proof.proof import Finding, Proof, ProofRequest, ProvenCase, prove

__all__ = ["Finding", "Proof", "ProofRequest", "ProvenCase", "Violation", "prove"]
