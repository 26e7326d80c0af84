"""The methods that the front serves are those of the interface that it ships."""

from twind.front.interface_methods import METHODS
from twind.protocol import CONTROL, load


def test_the_front_serves_every_method_of_the_interface_and_no_other() -> None:
    assert METHODS.keys() == load(CONTROL).methods.keys()
