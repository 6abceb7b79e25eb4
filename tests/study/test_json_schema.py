"""The JSON schema of study files takes every shipped study and tells mistakes as the program does."""

import tomllib
from typing import Any

import jsonschema
import pytest

from vdmbench.cli.verbs_of_a_study import TEMPLATE
from vdmbench.study.fields import study_schema
from vdmbench.study.files import shipped_studies

from .study_texts import FULL


@pytest.fixture(scope="module")
def schema() -> jsonschema.Draft202012Validator:
    found = study_schema()
    jsonschema.Draft202012Validator.check_schema(found)
    return jsonschema.Draft202012Validator(found)


def _places(schema: jsonschema.Draft202012Validator, data: Any) -> list[str]:
    return [".".join(map(str, error.absolute_path)) for error in schema.iter_errors(data)]


def test_every_shipped_study_is_sound(schema: jsonschema.Draft202012Validator) -> None:
    texts = {name: path.read_text() for name, path in shipped_studies().items()}
    texts |= {"new": TEMPLATE.read_text(), "full": FULL}
    for name, text in texts.items():
        assert _places(schema, tomllib.loads(text)) == [], name


@pytest.mark.parametrize(
    ("place", "value", "told"),
    [
        (("geometry", "shape"), "egg", "geometry.shape"),
        (("geometry", "radius"), [1, 2], "geometry.radius"),
        (("constraints", 0, "kind"), "glued", "constraints.0.kind"),
        (("regions", "base"), {"under": 1}, "regions.base"),
        (("sweep", "tissue.density"), 1060, "sweep.tissue.density"),
        (("models", "vdm-paper"), {"foundatoin": 1}, "models.vdm-paper"),
    ],
)
def test_a_mistake_is_told_at_its_place(
    schema: jsonschema.Draft202012Validator, place: tuple[Any, ...], value: Any, told: str
) -> None:
    data = tomllib.loads(FULL)
    table = data
    for key in place[:-1]:
        table = table.setdefault(key, {}) if isinstance(table, dict) else table[key]
    table[place[-1]] = value
    assert _places(schema, data) == [told]
