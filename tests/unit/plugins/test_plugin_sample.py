"""plugins/sample keeps an int, as in the thesis §4.7."""

from pathlib import Path

import pytest
import yaml

from eal_actors.kernel.errors import ArgumentError
from eal_actors.plugin import EALData, ResourceType
from plugins.sample import plugin as sample


def test_connect_names_what_the_manifest_names() -> None:
    manifest = yaml.safe_load(Path(sample.__file__).with_name("plugin.yaml").read_text(encoding="utf-8"))
    assert list(sample.connect().list_resources()) == manifest["resources"] == ["SampleResource"]


def test_it_keeps_an_int_that_is_0_at_first() -> None:
    resource = sample.create_SampleResource()
    assert resource.get_value() == 0
    resource.set_value(EALData.of(42))
    assert resource.get_value() == 42
    assert sample.create_SampleResource().get_value() == 0


def test_it_says_what_it_is() -> None:
    info = sample.create_SampleResource().info()
    assert info.types == ResourceType.SENSOR | ResourceType.ACTUATOR
    assert info.methods == {"get_value", "set_value"}


@pytest.mark.parametrize("value", [4.2, "42", True, [42], None])
def test_its_information_refuses_all_but_ints(value: object) -> None:
    info = sample.create_SampleResource().info().value
    assert info is not None
    info.check(EALData.of(7), "value")
    with pytest.raises(ArgumentError):
        info.check(EALData.of(value), "value")
