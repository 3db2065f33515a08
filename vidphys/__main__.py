"""``vidphys`` and ``python -m vidphys``: signals are heeded before anything else is loaded."""

import sys

from vidphys.runs.ending import Ending


def main() -> int:
    """Run one verb as this process; returns the exit code, see :func:`vidphys.cli.main`."""
    ending = Ending(working=False).__enter__()  # never left: what ends the process may take a while
    from vidphys.cli import main as run

    try:
        return run(ending=ending)
    finally:
        ending.over = True


if __name__ == "__main__":
    sys.exit(main())
