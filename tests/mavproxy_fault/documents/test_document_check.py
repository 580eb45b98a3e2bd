from typing import Annotated, Literal

import msgspec
import pytest
from msgspec import Meta

from mavproxy_fault.documents.document_check import NotFinite, decode
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import read_yaml


class Wheel(msgspec.Struct, frozen=True, kw_only=True):
    size_m: Annotated[float, Meta(gt=0)]
    load: NotFinite = 0.0

    def __post_init__(self) -> None:
        if self.size_m > 2.0:
            raise ValueError(f"size_m = {self.size_m} is too large; up to 2")


class Cart(msgspec.Struct, frozen=True, kw_only=True):
    name: str = ""
    colour: Literal["red", "green"] = "red"
    wheels: Wheel | list[Wheel] = []
    pair: tuple[float, float] | float = 0.0
    spare: dict[str, Wheel] = {}
    places: tuple[tuple[float, float, float], ...] = ()


def errors(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        decode(read_yaml(text, "cart.yaml"), Cart)
    return str(caught.value).splitlines()


def test_nested_structs_lists_and_mappings_are_built() -> None:
    text = "wheels: [{size_m: 1, load: .inf}]\npair: [1, 2]\nspare: {a: {size_m: 2}}\n"
    cart = decode(read_yaml(text + "places: [[1, 2, 3]]\n", "cart.yaml"), Cart)
    assert cart == Cart(
        wheels=[Wheel(size_m=1.0, load=float("inf"))],
        pair=(1.0, 2.0),
        spare={"a": Wheel(size_m=2.0)},
        places=((1.0, 2.0, 3.0),),
    )
    assert decode(read_yaml("wheels: {size_m: 1}", "a"), Cart).wheels == Wheel(size_m=1.0)


def test_all_errors_are_reported_at_once_with_their_lines() -> None:
    assert errors("""\
nme: x
colour: blue
wheels:
  - {size_m: 0}
  - {load: 1}
  - size_m: 3
pair: [1, .nan]
spare:
  a: {size_m: x}
places: [[1, 2]]
""") == [
        "cart.yaml:1: nme is unknown; did you mean name?",
        "cart.yaml:2: colour = 'blue' is unknown; known: green, red",
        "cart.yaml:4: wheels[0].size_m = 0 is out of range; above 0 is allowed",
        "cart.yaml:5: wheels[1] lacks size_m, which is required; add it",
        "cart.yaml:6: wheels[2].size_m = 3.0 is too large; up to 2",
        "cart.yaml:7: pair[1] = nan is not finite; give a finite number",
        "cart.yaml:9: spare.a.size_m = 'x' does not fit: expected `float`, got `str`",
        "cart.yaml:10: places[0] = [1, 2] does not fit: expected `array` of length 3, got 2",
    ]


def test_a_part_of_a_document_is_decoded_with_its_lines() -> None:
    document = read_yaml("a: 1\nb:\n  size_m: -1\n", "cart.yaml")
    with pytest.raises(ConfigError, match=r"cart.yaml:3: b.size_m = -1"):
        decode(document, Wheel, ("b",))


def test_a_flood_of_errors_is_cut() -> None:
    found = errors("wheels: [" + "{}, " * 1000 + "]")
    assert len(found) == 31
    assert found[-1] == "cart.yaml: 970 more errors"
    assert len(errors(f"name: [{'x, ' * 10_000}]")[0]) < 200


@pytest.mark.parametrize("text", ["", "5", "[1]", "text"])
def test_a_document_that_is_not_a_mapping_is_refused(text: str) -> None:
    assert "does not fit: expected `object`" in errors(text)[0]
