"""Peak memory of a stretch of work, against arrays of known size."""

from __future__ import annotations

import numpy as np
import pytest

from studies.memory import peak_bytes_since, reset_peak


@pytest.mark.parametrize("megabytes", [20, 80])
def test_a_peak_that_is_freed_again_counts(megabytes: int) -> None:
    small = [np.ones(1000) for _ in range(1000)]
    del small  # what was freed before must neither count nor hide what comes
    resident = reset_peak()
    array = np.ones(megabytes * 125_000)
    del array
    # the interpreter itself takes and gives back some pages meanwhile
    assert 0.9 * megabytes < peak_bytes_since(resident) / 1e6 < 1.2 * megabytes + 2


def test_an_earlier_peak_does_not_count() -> None:
    array = np.ones(10_000_000)
    del array
    assert peak_bytes_since(reset_peak()) < 2e6
