from __future__ import annotations

import pytest

from eal_actors.kernel.errors import ResourceInUseError, ResourceNotFoundError
from eal_actors.managers.resources import EALResourceManager


@pytest.fixture
def manager() -> EALResourceManager[str]:
    return EALResourceManager({"Base": "the base", "Camera": "the camera"})


def test_ids_are_given_when_first_asked_for_and_stay(manager: EALResourceManager[str]) -> None:
    camera, base = manager.find("Camera"), manager.find("Base")
    assert (camera, base) == (camera, camera + 1)
    assert manager.find("Camera") == camera
    assert manager.get(camera) == "the camera"


@pytest.mark.parametrize("bad", [-1, 10**9])
def test_an_id_that_was_never_given_is_refused(manager: EALResourceManager[str], bad: int) -> None:
    with pytest.raises(ResourceNotFoundError, match=f"no resource has the id {bad}"):
        manager.get(bad)


def test_an_id_of_another_connection_is_refused(manager: EALResourceManager[str]) -> None:
    other = EALResourceManager({"Base": "the base of another robot"})
    manager.find("Base")
    with pytest.raises(ResourceNotFoundError, match="in this connection"):
        manager.get(other.find("Base"))


def test_an_unknown_name_is_refused_with_the_nearest(manager: EALResourceManager[str]) -> None:
    with pytest.raises(ResourceNotFoundError, match="did you mean 'Base'"):
        manager.find("Bass")


def test_the_librarian_counts_each_lending(manager: EALResourceManager[str]) -> None:
    base, camera = object(), object()
    manager.check_out("Base", base)
    manager.check_out("Base", base)
    manager.check_out("Camera", camera)
    with pytest.raises(ResourceInUseError, match=r"Base \(2 times\), Camera still checked out"):
        manager.check_all_returned()
    for lent in (base, camera, base):
        manager.check_in(lent)
    manager.check_all_returned()
    with pytest.raises(ResourceInUseError, match="is not checked out"):
        manager.check_in(base)
