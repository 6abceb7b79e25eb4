"""Where results and the cache are kept."""

from __future__ import annotations

import os
from pathlib import Path


def results_directory() -> Path:
    """Where runs, the cache and baselines are kept unless the command line says otherwise."""
    return Path(os.environ.get("VDMBENCH_RESULTS") or "results")


def cache_directory() -> Path:
    """Where meshes and answers are kept unless the command line says otherwise."""
    return Path(os.environ.get("VDMBENCH_CACHE") or results_directory() / "cache")
