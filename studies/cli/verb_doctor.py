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
# of what the project requires, a module that needs all of the package, where it is not called like this
_MODULES = {
    "scikit-fem": "skfem",
    "vtk": "vtkmodules.vtkIOXML",
    "matplotlib": "matplotlib.figure",
    "tomli-w": "tomli_w",
}
# packages that are not needed, and what is done without them
_FALLBACKS = {"rslab": "finite elements factorise with SciPy's SuperLU instead, slower and in more memory"}


class Finding(NamedTuple):
    """One thing looked at, and what to do where it is not `ok`. What is not `needed` costs a convenience."""

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
            if not finding.ok:
                print(f"      {finding.remedy}")
    return OK if all(finding.ok or not finding.needed for finding in findings) else MACHINE


def examine() -> list[Finding]:
    """Look at Python, shared libraries, packages, cores, memory and the place for results."""
    missing = [name for name in LIBRARIES if not _loads(name)]
    line = f"apt-get install {' '.join(LIBRARIES[name] for name in missing)}"
    required = (text for text in importlib.metadata.requires("vdmbench") or () if "extra ==" not in text)
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    directory = Path()
    free, writable = shutil.disk_usage(directory).free, os.access(directory, os.W_OK)
    told = f"{free / 1e9:.1f} GB free" + ("" if writable else f", {directory.resolve()} is read-only")
    newer, coarser = "vdmbench needs Python 3.11 or newer", "use coarse meshes"
    findings = [
        Finding("python", sys.version_info >= (3, 11), True, sys.version.split()[0], newer),
        Finding("shared libraries", not missing, True, ", ".join(missing) or "all there", line),
        *(_package(text.split(">=")[0]) for text in required),
        Finding("cores", True, False, _cores(), ""),
        Finding("memory", memory > 2e9, False, f"{memory / 1e9:.1f} GB", coarser),
        Finding("disk", writable and free > 200e6, True, told, "free some space, or run in another folder"),
    ]
    return [finding._replace(remedy="") if finding.ok else finding for finding in findings]


def _cores() -> str:
    usable, there = usable_processors(), os.cpu_count() or 1
    return str(there) if usable == there else f"{usable} of {there} may be used"


def _package(name: str) -> Finding:
    remedy = f"pip install --constraint constraints.txt {name}"
    needed = name not in _FALLBACKS
    without = "" if needed else f": {_FALLBACKS[name]}"
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return Finding(name, False, needed, f"not installed{without}", remedy)
    try:
        importlib.import_module(_MODULES.get(name, name))
    except (ImportError, OSError) as error:  # a wheel whose shared library is missing raises OSError
        return Finding(name, False, needed, f"{version}, but it cannot be loaded ({error}){without}", remedy)
    return Finding(name, True, needed, version, "")


def _loads(library: str) -> bool:
    import ctypes  # no other verb needs it

    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
