"""Forty small faults, one at a time in a copy: which of them the tests of their neighbourhood catch.

`make evidence WHAT=mutants` writes docs/evidence/mutants.md, each row as it is known; ARGS are numbers of rows, by
default all, and the others stay. It ends with an error where one survives: such a fault needs a test, or was none.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue
from typing import NamedTuple

from tools import marked
from tools.runs import ROOT

DOCUMENT, PART = ROOT / "docs" / "evidence" / "mutants.md", "mutants"
SURVIVES = "**survives**"
COPIED = ("vdm", "fem_reference", "studies", "tests", "tools", "docs", "pyproject.toml")
COPIED_TOO = ("results/baselines", "results/FORMAT.md")
JOBS = 2


class Mutant(NamedTuple):
    """`old`, which stands once in the file, becomes `new`; of `tests` one should fail, the likeliest come first."""

    file: str
    old: str
    new: str
    tests: str


U = "tests/unit/test_"
V, B, S = "tests/vdm/test_vdm_", "tests/body/test_", "tests/scene/test_"
MUTANTS = (
    # the surface models
    Mutant("vdm/material.py", "mu = youngs_modulus / 3.0", "mu = youngs_modulus / 2.0", f"{V}model.py"),
    Mutant(
        "vdm/formulations/paper.py",
        "force * (rest_height / current_height)",
        "force * (current_height / rest_height)",
        f"{V}formulations.py {V}energy.py {V}solvers.py",
    ),
    Mutant(
        "vdm/formulations/vector.py",
        "second - np.trace(second)",
        "second + np.trace(second)",
        f"{V}formulations.py {V}model.py",
    ),
    Mutant(
        "vdm/formulations/vector.py",
        "energy += 0.5 * float(self.stretch @",
        "energy += float(self.stretch @",
        f"{V}energy.py {V}formulations.py",
    ),
    Mutant(
        "vdm/solvers/quasi_linear.py",
        "target[0] -= float(np.vdot(row[~free]",
        "target[0] += float(np.vdot(row[~free]",
        f"{V}solvers.py {V}steps.py",
    ),
    Mutant(
        "vdm/solvers/quasi_linear.py",
        "1.0 + float(change_of_row @ z)",
        "1.0 - float(change_of_row @ z)",
        f"{V}solvers.py",
    ),
    Mutant("vdm/bending.py", "moved[k, c] = -nu *", "moved[k, c] = nu *", f"{V}bending.py"),
    Mutant(
        "vdm/reservations.py", "if bending > LIMIT:", "if bending > 2.0 * LIMIT:", f"{V}mesh_error.py"
    ),
    Mutant("vdm/solvers/anderson.py", "step - mix @", "step + mix @", f"{V}steps.py {V}solvers.py"),
    Mutant(
        "vdm/boundary/kernels.py", "total[9 + i[1]] += f1", "total[9 + i[1]] -= f1", f"{U}boundary_operators.py"
    ),
    # the reference
    Mutant(
        "fem_reference/materials.py", "+ 0.125 * self.fibre_modulus", "+ 0.25 * self.fibre_modulus",
        f"{U}fem_materials.py",
    ),
    Mutant(
        "fem_reference/materials.py", "np.full_like(tension, self.fibre_modulus)",
        "np.full_like(tension, 0.5 * self.fibre_modulus)", f"{U}fem_materials.py",
    ),
    Mutant(
        "fem_reference/kinematics.py", "(1 / 2 + near * (1 / 6", "(1 / 2 - near * (1 / 6", f"{U}fem_materials.py"
    ),
    Mutant(
        "fem_reference/recovery.py", "np.where(nodes.T > 0.0, 1.0, _BORROWED)",
        "np.where(nodes.T > 0.0, _BORROWED, 1.0)", f"{U}fem_recovery.py",
    ),
    Mutant("fem_reference/follower.py", "0.5 * weights  #", "weights  #", f"{U}fem_finite_strain.py"),
    Mutant("fem_reference/follower.py", "(0, 2, 1, -1)", "(0, 2, 1, 1)", f"{U}fem_finite_strain.py"),
    Mutant("fem_reference/moduli.py", "(nu <= 0.5))", "(nu < 0.5))", f"{U}fem_linear.py"),
    Mutant(
        "fem_reference/moduli.py", "float(v @ share)", "float(v.mean())",
        f"{U}fem_linear.py {U}fem_assembly.py tests/verification/test_fem_regions.py",
    ),
    # bodies and scenes
    Mutant("studies/body/surface_measures.py", "ax * (by * cz - bz * cy)", "ax * (by * cz + bz * cy)",
           f"{U}metrics.py"),
    Mutant("studies/body/surface_measures.py", "/ np.sqrt(weights.sum())", "/ weights.sum()",
           f"{U}metrics.py {U}metric_weights.py"),
    Mutant("studies/body/repair.py", "copies[order] > 1", "copies[order] > 2",
           f"{B}mesh_files.py {B}mesh.py"),
    Mutant("studies/body/refine.py", "out, end, 0.5 * values", "out, end, 1.0 * values", f"{B}refine.py"),
    Mutant("studies/body/refine.py", "mask[first], middle)", "mask[first], mask[first] & mask[second])",
           f"{B}refine.py"),
    Mutant("studies/scene/contact_profile.py", "_FROM_RIM = 3.0", "_FROM_RIM = 0.0", f"{S}scene.py"),
    Mutant("studies/scene/placed.py", "resultant < _LEAST_RESULTANT * total", "resultant < 0.0 * total",
           f"{S}scene.py {S}scene_warnings.py"),
    Mutant("studies/scene/warnings.py", "if path > extent", "if path > 10.0 * extent", f"{S}scene_warnings.py"),
    # how far off, and what it means
    Mutant("studies/measures/uncertainty.py", "bar <= RESOLUTION * abs", "bar < RESOLUTION * abs",
           f"{U}uncertainty.py"),
    Mutant("studies/measures/uncertainty.py", "min(order, FORMAL_ORDER)", "order", f"{U}uncertainty.py"),
    Mutant("studies/measures/limits.py", "or largest > MOST_STRAIN", "", f"{U}limits.py"),
    Mutant("studies/measures/metrics.py", "_unless_lost(norm, of_nodes))", "norm)", f"{U}metrics.py"),
    Mutant("studies/verdict/acceptance.py", "values + bar <= self.allowed", "values <= self.allowed",
           "tests/verdict/test_acceptance.py tests/verdict/test_verdict.py"),
    Mutant("studies/verdict/acceptance.py", "values - bar > self.allowed", "values > self.allowed",
           "tests/verdict/test_acceptance.py tests/verdict/test_verdict.py"),
    Mutant("studies/gate.py", "max(RELATIVE * abs(value), least)", "min(RELATIVE * abs(value), least)",
           "tests/gate/test_gate.py"),
    # the work and its files
    Mutant("studies/work/keys.py", '        "gravity": gravity if weighs else None,\n', "",
           "tests/work/test_keys.py tests/work/test_graph.py"),
    Mutant("studies/work/keys.py", '        "anisotropy": inputs.get("anisotropy"),\n', "",
           "tests/work/test_keys.py tests/work/test_graph.py"),
    Mutant("studies/work/keys.py", "_touched(inputs) if model.contact_in_setup else None", "None",
           "tests/work/test_keys.py tests/work/test_graph.py"),
    Mutant("studies/work/engine.py", "timeout * max(1, len(node.items))", "timeout",
           "tests/work/test_graph.py"),
    Mutant("studies/store/case_checks.py", "facets.max() >= n_nodes", "facets.max() > n_nodes",
           f"{U}store.py {U}hostile_case.py"),
    Mutant("studies/store/hdf5.py", "if found > schema:", "if found > schema + 1:", f"{U}hdf5.py {U}store.py"),
    Mutant("studies/models/costs.py", "own.setup + mesh_seconds(size.refined(-1))", "own.setup",
           f"{U}estimate.py {U}coarse.py"),
)  # fmt: skip


def copied(directory: Path, root: Path = ROOT) -> Path:
    """A copy of what is tested and of its tests."""
    ignored = shutil.ignore_patterns("__pycache__")
    for name in (*COPIED, *COPIED_TOO):
        if (root / name).is_dir():
            shutil.copytree(root / name, directory / name, ignore=ignored)
        else:
            shutil.copy(root / name, directory / name)
    (directory / "build" / "typed").mkdir(parents=True)
    (directory / "build" / "typed" / "vdmbench").symlink_to("../../studies")
    return directory


def changed(text: str, mutant: Mutant) -> str:
    """The file with the fault. Raises ValueError where the place is not there once."""
    if text.count(mutant.old) != 1:
        raise ValueError(f"{mutant.file}: {mutant.old!r} stands there {text.count(mutant.old)} times")
    return text.replace(mutant.old, mutant.new)


def failed(mutant: Mutant, place: Path) -> str:
    """The first test that fails with the fault in a copy, and nothing where all pass."""
    path = place / mutant.file
    text = path.read_text()
    path.write_text(changed(text, mutant))
    try:
        return first_failure(mutant.tests.split(), place)
    finally:
        path.write_text(text)


def first_failure(tests: Iterable[str], place: Path) -> str:
    """The first of the tests of a copy that fails, and nothing where all pass."""
    code = os.pathsep.join((str(place / "build" / "typed"), str(place)))
    options = ("-q", "-x", "-m", "not slow", "-p", "no:cacheprovider", "--basetemp", str(place / "tmp"))
    ended = subprocess.run(
        [sys.executable, "-B", "-m", "pytest", *options, *tests],
        cwd=place,
        env={
            **os.environ,
            "PYTHONPATH": code,
            "OMP_NUM_THREADS": "1",
            "NUMBA_CACHE_DIR": str(place / "numba"),
        },
        capture_output=True,
        text=True,
    )
    if ended.returncode == 0:
        return ""
    words = [line for line in ended.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return words[0].split()[1] if words else f"pytest ends with {ended.returncode}"


def row(mutant: Mutant) -> list[str]:
    """What was done, as cells of the table."""
    return [mutant.file, *(f"`{text.strip()}`" if text else "(nothing)" for text in (mutant.old, mutant.new))]


def caught_of(text: str) -> dict[Mutant, str]:
    """Of a table, what caught each fault that is still of the list."""
    found = {tuple(cells[1:4]): cells[4] for cells in marked.cells(text)[1:]}
    return {mutant: found[key] for mutant in MUTANTS if (key := tuple(row(mutant))) in found}


def table_of(caught: Mapping[Mutant, str]) -> str:
    """The table of the faults that were tried, and how many of them are caught."""
    rows = [
        (f"{number}", *row(mutant), caught[mutant])
        for number, mutant in enumerate(MUTANTS, 1)
        if mutant in caught
    ]
    survived = sum(cells[-1] == SURVIVES for cells in rows)
    return (
        marked.table(("no.", "file", "was", "became", "caught by"), rows)
        + f"\n{len(rows) - survived} of {len(rows)} are caught.\n"
    )


def main() -> None:
    """Writes each row as it is known, in the order of the list."""
    numbers = [int(word) for word in sys.argv[1:]] or range(1, len(MUTANTS) + 1)
    tried = [MUTANTS[number - 1] for number in numbers]
    caught = caught_of(marked.shown(DOCUMENT, PART))
    with tempfile.TemporaryDirectory() as name:
        places: Queue[Path] = Queue()
        for number in range(JOBS):
            (Path(name) / f"{number}").mkdir()
            places.put(copied(Path(name) / f"{number}"))
        tests = sorted({test for mutant in tried for test in mutant.tests.split()})
        if broken := first_failure(tests, Path(name) / "0"):
            sys.exit(f"{broken} fails without a fault: mend it first")

        def catch(mutant: Mutant) -> str:
            place = places.get()
            found = failed(mutant, place)
            places.put(place)
            return found.partition("[")[0] or SURVIVES

        with ThreadPoolExecutor(JOBS) as pool:
            for mutant, found in zip(tried, pool.map(catch, tried), strict=True):
                caught[mutant] = found
                marked.show(DOCUMENT, PART, table_of(caught))
                print(MUTANTS.index(mutant) + 1, mutant.file, found, flush=True)
    sys.exit(any(caught[mutant] == SURVIVES for mutant in tried))


if __name__ == "__main__":
    main()
