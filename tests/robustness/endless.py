"""The command with tasks that never end."""

from vdmbench.cli.main import main
from vdmbench.work import pool

from .processes import endless

if __name__ == "__main__":
    pool.do_task = endless
    main()
