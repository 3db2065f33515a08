"""Small pieces of work for processes that other tests lose: they leave files and nothing else."""

import os
import signal
import time


def write(folder, name, report):
    """Write a file at one stroke, and count the attempts beside it."""
    with (folder / f"{name}.tries").open("a") as file:
        file.write("x")
    report(name, 1, 1)
    partial = folder / f"{name}.{os.getpid()}"
    partial.write_text(name)
    partial.replace(folder / f"{name}.done")


def fail(folder, name, report):
    raise ValueError(f"{name} cannot be done")


def die_once(folder, name, report):
    """End as by a lack of memory, the first time."""
    if not (folder / f"{name}.tries").exists():
        (folder / f"{name}.tries").write_text("x")
        os.kill(os.getpid(), signal.SIGKILL)
    write(folder, name, report)


def die(folder, name, report):
    os.kill(os.getpid(), signal.SIGKILL)


def slow(folder, name, report):
    time.sleep(1.0)
    write(folder, name, report)


def errand(folder, name, kind, report):
    {"write": write, "fail": fail, "once": die_once, "die": die, "slow": slow}[kind](
        folder, name, report
    )
