"""What the server of workers does before it forks them: the slow imports, out of the garbage collector's sight.

The collector looks at all that is loaded again and again, which takes a fifth of the time of the imports; and where
it looks in a worker, the pages that the workers share are copied (see the documentation of `gc.freeze`).
"""

from __future__ import annotations

import gc
from importlib import import_module

# what every case needs, and no case should be timed with
_MODULES = ("studies.worker", "vdm.model", "fem_reference.linear", "scipy.spatial")

gc.disable()
try:
    for _name in _MODULES:
        import_module(_name)
    gc.freeze()
finally:  # the server goes on without what it could not load, and its workers say what is missing
    gc.enable()
