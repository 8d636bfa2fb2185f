"""Schemas made of models."""

from typing import Annotated, Literal

import pytest
from jsonschema import Draft202012Validator
from pydantic import Field

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.json_schema import json_schema


class Part(StrictModel):
    """A ``part`` of :class:`Whole`,
    on two lines."""

    title: str = Field(default="none", description="a key of the name of a keyword")


class Round(StrictModel):
    """One kind."""

    kind: Literal["round"]
    radius_m: float = Field(gt=0.0, description="radius, m")


class Square(StrictModel):
    """The other kind."""

    kind: Literal["square"]
    side_m: float = Field(gt=0.0, description="side, m")


class Whole(StrictModel):
    """Everything."""

    count: int = Field(ge=1, le=9, description="how many")
    part: Part = Field(default=Part(), description="a section")
    shape: Annotated[Round | Square, Field(discriminator="kind")]


@pytest.fixture
def schema():
    return json_schema(Whole, "a whole")


def test_a_schema_is_one_of_draft_2020_12(schema):
    Draft202012Validator.check_schema(schema)
    assert schema["$schema"].endswith("draft/2020-12/schema")
    assert schema["title"] == "a whole"


def test_a_key_carries_its_meaning_and_its_bounds(schema):
    assert schema["properties"]["count"] == {
        "description": "how many",
        "minimum": 1,
        "maximum": 9,
        "type": "integer",
    }


def test_unknown_keys_are_mistakes_in_every_section(schema):
    assert all(each["additionalProperties"] is False for each in (schema, *schema["$defs"].values()))


def test_a_docstring_reads_as_plain_text(schema):
    assert schema["$defs"]["Part"]["description"] == "A `part` of `Whole`, on two lines."


def test_keys_named_like_keywords_stay(schema):
    assert schema["$defs"]["Part"]["properties"]["title"]["default"] == "none"


def test_names_of_classes_and_sections_as_defaults_are_left_out(schema):
    assert "title" not in schema["$defs"]["Part"]
    assert "default" not in schema["properties"]["part"]
    assert "discriminator" not in schema["properties"]["shape"]


@pytest.mark.parametrize(
    ("document", "is_right"),
    [
        ({"count": 1, "shape": {"kind": "round", "radius_m": 1}}, True),
        ({"count": 0, "shape": {"kind": "round", "radius_m": 1}}, False),
        ({"count": 1, "shape": {"kind": "round", "side_m": 1}}, False),
        ({"count": 1, "shape": {"kind": "square", "side_m": 1}, "part": {"titel": ""}}, False),
    ],
)
def test_a_schema_separates_right_from_wrong(schema, document, is_right):
    assert Draft202012Validator(schema).is_valid(document) == is_right
