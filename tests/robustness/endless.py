"""The command with nodes that never end."""

from __future__ import annotations

from vdmbench.cli.main import main
from vdmbench.work import local

from .processes import endless

if __name__ == "__main__":
    local.run_node = endless
    main()
