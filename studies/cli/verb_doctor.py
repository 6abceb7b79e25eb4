"""`vdmbench doctor`: what the machine has and lacks, with the line that mends it."""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import os
import shutil
import sys
from pathlib import Path
from typing import NamedTuple

from ..machine.processors import usable_processors
from .output import MACHINE, OK, print_json

SUMMARY = "say what the machine has and lacks"

# shared libraries that the gmsh and VTK wheels load from the system, and Debian's packages of them
LIBRARIES = {
    "libgomp.so.1": "libgomp1",
    "libGLU.so.1": "libglu1-mesa",
    "libXft.so.2": "libxft2",
    "libXcursor.so.1": "libxcursor1",
    "libXinerama.so.1": "libxinerama1",
    "libGL.so.1": "libgl1",
}
# what the project requires, and a module of each that needs all of it
PACKAGES = {
    "numpy": "numpy",
    "scipy": "scipy",
    "scikit-fem": "skfem",
    "gmsh": "gmsh",
    "meshio": "meshio",
    "pyvista": "pyvista",
    "vtk": "vtkmodules.vtkIOXML",
    "h5py": "h5py",
    "pyacvd": "pyacvd",
    "cholespy": "cholespy",
    "numba": "numba",
    "pyamg": "pyamg",
    "rslab": "rslab",
    "pint": "pint",
    "pydantic": "pydantic",
    "jinja2": "jinja2",
    "matplotlib": "matplotlib.figure",
    "rich": "rich",
    "tomli-w": "tomli_w",
    "threadpoolctl": "threadpoolctl",
    "pebble": "pebble",
}
# packages that are not needed, and what is done without them
_FALLBACKS = {"rslab": "finite elements factorise with SciPy's SuperLU instead, slower and in more memory"}


class Finding(NamedTuple):
    """One thing looked at. What is not `needed` only costs a convenience."""

    what: str
    ok: bool
    needed: bool
    detail: str
    remedy: str


def arguments(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    parser.set_defaults(solves=False)


def run(options: argparse.Namespace) -> int:
    """Print what the machine has and lacks."""
    findings = examine()
    if options.json:
        print_json([finding._asdict() for finding in findings])
    else:
        for finding in findings:
            print(f"{'ok  ' if finding.ok else 'LACKS'} {finding.what}: {finding.detail}")
            if not finding.ok and finding.remedy:
                print(f"      {finding.remedy}")
    return OK if all(finding.ok or not finding.needed for finding in findings) else MACHINE


def examine() -> list[Finding]:
    """Look at Python, shared libraries, packages, cores, memory and the place for results."""
    findings = [
        Finding(
            "python",
            sys.version_info >= (3, 11),
            True,
            sys.version.split()[0],
            "vdmbench needs Python 3.11 or newer",
        )
    ]
    missing = [name for name in LIBRARIES if not _loads(name)]
    line = f"apt-get install {' '.join(LIBRARIES[name] for name in missing)}"
    findings.append(
        Finding(
            "shared libraries",
            not missing,
            True,
            ", ".join(missing) or "all there",
            line if missing else "",
        )
    )
    findings += [_package(name, module) for name, module in PACKAGES.items()]
    findings.append(Finding("cores", True, False, _cores(), ""))
    findings.append(_memory())
    directory = Path()
    free = shutil.disk_usage(directory).free
    writable = os.access(directory, os.W_OK)
    findings.append(
        Finding(
            "disk",
            writable and free > 200e6,
            True,
            f"{free / 1e9:.1f} GB free" + ("" if writable else f", {directory.resolve()} is read-only"),
            "" if writable and free > 200e6 else "free some space, or run in another folder",
        )
    )
    return findings


def _cores() -> str:
    usable, there = usable_processors(), os.cpu_count() or 1
    return str(there) if usable == there else f"{usable} of {there} may be used"


def _package(name: str, module: str) -> Finding:
    remedy = f"pip install --constraint constraints.txt {name}"
    needed = name not in _FALLBACKS
    without = "" if needed else f": {_FALLBACKS[name]}"
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return Finding(name, False, needed, f"not installed{without}", remedy)
    try:
        importlib.import_module(module)
    except (ImportError, OSError) as error:  # a wheel whose shared library is missing raises OSError
        return Finding(name, False, needed, f"{version}, but it cannot be loaded ({error}){without}", remedy)
    return Finding(name, True, needed, version, "")


def _memory() -> Finding:
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return Finding(
        "memory", total > 2e9, False, f"{total / 1e9:.1f} GB", "" if total > 2e9 else "use coarse meshes"
    )


def _loads(library: str) -> bool:
    import ctypes  # no other verb needs it

    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
