"""How well a case's inputs are known and what comes of it, as entries of its file."""

from __future__ import annotations

import numpy as np

from ..measures.input_spread import InputSpread, ModelSpread
from .hdf5 import Data, Entry, Group, Stored, Text

_UNIT = {"unit": "1"}


def input_entries(found: InputSpread) -> list[Entry]:
    """The group `inputs` of a case file; see results/FORMAT.md."""
    entries: list[Entry] = [
        Group("inputs", {"method": found.method, "variations": found.variations}),
        Text("inputs/key", list(found.keys)),
        Text("inputs/unit", list(found.units)),
        Data("inputs/value", found.values),
        Data("inputs/deviation", found.deviations),
        Group("inputs/models"),
    ]
    for name, spread in found.models.items():
        path = f"inputs/models/{name}"
        about = {key: getattr(spread, key) for key in ("displacement", "deformation", "bend")}
        entries += [
            Group(path, about),
            Data(f"{path}/parts", spread.parts, _UNIT),
            *(Data(f"{path}/{index}", values, _UNIT) for index, values in spread.indices.items()),
        ]
    return entries


def read_inputs(file: Stored) -> InputSpread:
    """What `input_entries` wrote. Raises ValueError for another shape."""
    keys = file.texts("inputs/key")
    values, deviations = (file.floats(f"inputs/{name}") for name in ("value", "deviation"))
    units = file.texts("inputs/unit")
    models = {name: _read_model(file, f"inputs/models/{name}") for name in file.members("inputs/models")}
    columns = [units, values, deviations, *(m.parts for m in models.values())]
    columns += [index for model in models.values() for index in model.indices.values()]
    if any(np.shape(column) != (len(keys),) for column in columns):
        raise ValueError("its inputs do not fit each other")
    variations = int(file.number("inputs", "variations"))
    return InputSpread(file.text("inputs", "method"), variations, keys, units, values, deviations, models)


def _read_model(file: Stored, path: str) -> ModelSpread:
    displacement, deformation, bend = (
        file.number(path, key) for key in ("displacement", "deformation", "bend")
    )
    indices = {name: file.floats(f"{path}/{name}") for name in file.members(path) if name != "parts"}
    return ModelSpread(displacement, deformation, file.floats(f"{path}/parts"), bend, indices)
