"""The workbench from Python and in a notebook: `vdmbench.run` runs a study, `vdmbench.read` reads a run."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .machine import usable_processors
from .measures.case import CaseResult, Run

if TYPE_CHECKING:
    from pandas import DataFrame

    from .verdict.verdict import Verdicts
    from .work.run import Event


@dataclass(frozen=True)
class Results:
    """A run: `directory` with its files, `data` with all arrays (SI units), `report` the path of its page."""

    directory: Path
    data: Run
    report: Path

    @property
    def cases(self) -> list[CaseResult]:
        """The finished cases, with arrays: `case.models["fem-linear"].displacement` is (S, N, 3) [m]."""
        return list(self.data.cases)

    @property
    def failed(self) -> list[str]:
        """One line for each failed case."""
        return [f"{failure['label']}: {failure['message']}" for failure in self.data.failed]

    @cached_property
    def verdicts(self) -> Verdicts:
        """Verdicts as on page and terminal, by family: `verdicts["vdm-printed"].word`, `limits` and more."""
        from .verdict.digest import digest_of
        from .verdict.verdict import verdicts

        return verdicts(digest_of(self.data))

    @cached_property
    def metrics(self) -> DataFrame:
        """The frame of the page and the gate: a row for each case, model, load step and metric."""
        from .measures.frame import frame

        return frame(self.data)

    @cached_property
    def meshes(self) -> dict[str, Any]:
        """Label of each case -> its surface as a pyvista.PolyData, with the models' answers at full load.

        Lengths are in metres; for a body from a file they are in the file's unit, so that the mesh lies on the
        scan.
        """
        from .body.remesh import polydata
        from .report.export import mesh_names, surface_fields

        found = {}
        for name, case in mesh_names(self.data.cases):
            points, fields = surface_fields(case)
            found[case.label or Path(name).stem] = polydata(points, case.triangles, fields)
        return found

    def __repr__(self) -> str:
        return (
            f"Results({str(self.directory)!r}: {len(self.data.cases)} cases, {len(self.data.failed)} failed)"
        )

    def _repr_html_(self) -> str:
        """The headline table, the verdicts and a link to the report, for a notebook."""
        import pandas as pd

        from .report.headline import terminal_rows
        from .verdict.digest import digest_of
        from .verdict.words import told

        rows = pd.DataFrame(terminal_rows(digest_of(self.data)))
        title = escape(self.data.study.study.title)
        failed = "".join(f"<p>failed: {escape(line)}</p>" for line in self.failed)
        words = told(self.verdicts)
        rows_told = [{key: escape(str(value)) for key, value in row.items()} for row in words["rows"]]
        lines = [f"<b>{row['title']}: {row['word']}.</b> {row['text']}" for row in rows_told]
        lines += map(escape, (*words["notes"], *words["instead"]))
        answers = "".join(f"<p>{line}</p>" for line in lines)
        return (
            f"<h4>{title}</h4>{answers}{rows.to_html(index=False, border=0)}{failed}"
            f'<p><a href="{escape(self.report.resolve().as_uri())}">report</a></p>'
        )


def run(
    study: str | Path,
    *,
    surface: str | Path | None = None,
    out: str | Path | None = None,
    cache: str | Path | None = None,
    jobs: int | None = None,
    fresh: bool = False,
    watch: Callable[[Event], None] = lambda _: None,
    **overrides: Any,
) -> Results:
    """Run the missing part of a study and write its report.

    Parameters
    ----------
    study : path of a study file, or the name of a shipped one
    surface, out, cache, jobs, fresh : as the options of `vdmbench run`
    watch : called with each event of the run
    overrides : tables of the study with the keys to change: `tissue={"youngs_modulus": "3 kPa"}`,
        `constraints={"finger": {"force": "0.2 N"}}`; None drops a key

    Raises
    ------
    ValueError
        a study with mistakes, with file and line of each; a directory that holds something else.
    OSError
        disk full or read-only.
    """
    from .report.rebuild import rebuild
    from .study.config import load_study
    from .study.files import study_path
    from .work.plan import make_plan
    from .work.run import Options, run_plan

    body = Path(surface) if surface is not None else None
    found = load_study(study_path(study), surface=body, changes=[overrides])
    directory, place = (Path(given) if given is not None else None for given in (out, cache))
    plan = make_plan(found, directory, place, fresh=fresh)
    how = Options(jobs=jobs or usable_processors())
    with _script_left_alone():
        data, report = run_plan(plan, how, watch, rebuild)
    return Results(plan.directory, data, report)


@contextmanager
def _script_left_alone() -> Iterator[None]:
    """Hide the script that calls `run` from workers: they do not need it, and would run it without a main guard."""
    main = sys.modules["__main__"].__dict__
    saved: dict[str, Any] = {key: main[key] for key in ("__file__", "__spec__") if key in main}
    main.pop("__file__", None)
    main["__spec__"] = None
    try:
        yield
    finally:
        main.update(saved)


def read(directory: str | Path) -> Results:
    """Read a run. Raises ValueError for a directory without one, and for damaged results."""
    from .store.cases import read_run

    return Results(Path(directory), read_run(Path(directory)), Path(directory) / "report.html")
