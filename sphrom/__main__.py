"""`sphrom` and `python -m sphrom`."""

from __future__ import annotations

import os
import sys

# Threads are the kernels' business: a BLAS that shares small systems out over threads of its own
# is many times slower where cores are busy, and its results depend on their number.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Nothing plugs into pydantic here, and to look for plugins takes a tenth of a short command.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")


def main() -> None:
    """Run the command line."""
    try:
        from sphrom.cli.app import app

        app(prog_name="sphrom")
    except KeyboardInterrupt:  # before a command has begun
        sys.exit(130)


if __name__ == "__main__":
    main()
