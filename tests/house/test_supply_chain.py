"""The lock of the development environment, the wheel's bill of materials, and the hosted release."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.house.sbom import LOCK, bill_of_materials, read_lock

ROOT = Path(__file__).parents[2]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())


def development_requirements() -> list[Requirement]:
    """Return what pyproject.toml asks for in the development environment."""
    groups = PROJECT["dependency-groups"]

    def of_group(name: str) -> list[str]:
        entries = groups[name]
        return [
            text
            for entry in entries
            for text in (of_group(entry["include-group"]) if isinstance(entry, dict) else [entry])
        ]

    extras = [text for texts in PROJECT["project"]["optional-dependencies"].values() for text in texts]
    return [Requirement(text) for text in (*PROJECT["project"]["dependencies"], *extras, *of_group("dev"))]


def test_the_lock_has_a_hash_for_each_package_of_the_development_environment() -> None:
    lock = read_lock(LOCK.read_text())
    for wanted in development_requirements():
        locked = lock.get(canonicalize_name(wanted.name))
        assert locked is not None, f"{wanted.name} is not in {LOCK.name}: run make lock"
        assert wanted.specifier.contains(locked.version, prereleases=True), f"{wanted}: run make lock"
    assert all(locked.hashes for locked in lock.values())
    assert "://" not in LOCK.read_text()  # of whatever index, the hashes decide


def test_the_lock_has_what_builds_the_package_without_isolation() -> None:
    program = "import hatchling.build as b; print(*b.get_requires_for_build_editable(), sep='\\n')"
    asked = subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True, capture_output=True, text=True)
    lock = read_lock(LOCK.read_text())
    for wanted in map(Requirement, (*PROJECT["build-system"]["requires"], *asked.stdout.split())):
        locked = lock.get(canonicalize_name(wanted.name))
        assert locked is not None, f"{wanted.name} is not in {LOCK.name}: `make locked` fails"
        assert wanted.specifier.contains(locked.version, prereleases=True), wanted


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder), "-t", "wheel"]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=120)
    (built,) = folder.iterdir()
    return built


def test_the_bill_of_materials_lists_the_wheel_and_its_dependencies(wheel: Path) -> None:
    text = bill_of_materials(wheel, read_lock(LOCK.read_text()))
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None
    bom = json.loads(text)
    this = bom["metadata"]["component"]
    assert (this["name"], this["version"]) == ("eal-actors", PROJECT["project"]["version"])
    assert this["hashes"] == [{"alg": "SHA-256", "content": hashlib.sha256(wheel.read_bytes()).hexdigest()}]
    parts = {part["name"]: part for part in bom["components"]}
    for text in PROJECT["project"]["dependencies"]:
        name = canonicalize_name(Requirement(text).name)
        assert parts[name]["scope"] == "required", name
    assert parts["numpy"]["scope"] == "optional"
    assert parts["pydantic-core"]["scope"] == "required"  # which only another one needs
    assert "pytest" not in parts
    needs = {entry["ref"]: entry.get("dependsOn", []) for entry in bom["dependencies"]}
    assert "pypi/pydantic-core" in needs["pypi/pydantic"]
    assert "pypi/msgpack" in needs["this"]


def test_a_release_is_built_from_the_lock_and_attested() -> None:
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "release.yml").read_text())["jobs"]
    steps = jobs["build"]["steps"]
    commands = "\n".join(step.get("run", "") for step in steps)
    actions = [step["uses"].partition("@")[0] for step in steps if "uses" in step]
    assert "make locked" in commands
    assert "make sbom" in commands
    assert {"actions/attest-build-provenance", "actions/attest-sbom"} <= set(actions)
    assert jobs["build"]["permissions"] == {"attestations": "write", "contents": "read", "id-token": "write"}
    assert jobs["publish"]["permissions"] == {"id-token": "write"}
