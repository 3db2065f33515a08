"""README and docs as a reader would type them: each block of a page, what it needs, how it is run.

Commands run as they are printed, but for two tables: ``SMALLER`` shortens what takes minutes, and
``ELSEWHERE`` says, with the reason, what this machine cannot be asked. ``SLOW`` pages are run by
``make docs-run``; else their commands only go through their own parsers.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import re
import shlex
import stat
import subprocess
import sys
import tomllib
import urllib.request
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import tyro

from tests.shared.serial import serially
from tests.shared.small_clips import write_clip
from tests.shared.small_studies import TINY, with_short_lyapunov_times
from vidphys import presets
from vidphys.cli import VERBS, main
from vidphys.cli.parts import REGISTRIES
from vidphys.data.rendered import write_video
from vidphys.experiments.core import oracle, scoring
from vidphys.pretraining.__main__ import PretrainConfig
from vidphys.pretraining.__main__ import main as pretraining
from vidphys.runs import pool

ROOT = Path(__file__).parents[2]
TUTORIAL = ROOT / "docs" / "tutorial.md"  # test_docs.py runs it as it stands, nothing shortened
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
WHOLE = os.environ.get("VIDPHYS_DOCS") == "whole"
SLOW = {  # minutes, by a page's name
    *("README.md", "choose.md", "diagnose.md", "ladder.md"),
    *("play.md", "probing.md", "scale.md", "train.md", "model-cards.md"),
}
AND = "&&"
LONG_STEPS = 2000  # of a ladder's longest rollout, in place of 10,000

# By verb, the options that make a command small, in place of those that are printed.
SMALLER = {
    "render": {"--clips": ["6"], "--frames": ["12"], "--image": ["32"]},
    "film": {"--clips": ["1"]},
    "train": {
        "--steps": ["4"],
        "--head-steps": ["2"],
        "--shift": ["1"],
        "--readout": ["attention"],
    },
    "fit": {"--steps": ["4"]},
    "atlas": {"--targets": ["position"], "--folds": ["2"], "--workers": ["1"]},
    "stress": {"--axes": ["foreign"]},
    "trade": {"--fronts": ["pipeline"]},
    "ladder": {"--cells": ["oracle/factored", "oracle/unstructured"], "--seeds": ["1"]},
    "reproduce": {"--cells": ["truth"], "--seeds": ["1"]},
}
# What a page names and this machine has not: the words, those in their place, and why.
ELSEWHERE = [
    ("--device cuda", "--device cpu", "a card"),
    ("DEVICE=cuda", "DEVICE=cpu", "a card"),
    ("--engine ray", "--engine local", "a cluster"),
    ("--engine submitit", "--engine local", "a cluster"),
    ("--address HEAD:6379", "", "a cluster"),
    ("s3://", "file://", "the network"),
    ("--encoder dinov2-small", "--encoder dino-tiny", "its weights"),
    ("/data/", "data/", "that folder"),
]
# Targets of make whose recipes are told, and not run: each runs a suite of tests, such as this one.
SUITES = {"test", "test-all", "test-gpu"}
PROGRAMS = {  # what Slurm's and Ray's programs do, as far as a script sees it
    "scontrol": "echo HEAD",
    "sleep": "exit 0",
    "ray": "exit 0",
    "srun": 'while [[ $1 == --* ]]; do shift; done; exec "$@"',
    "vidphys": 'printf "%s\\n" "$*" >> asked',
}
SLURM = {"SLURM_JOB_NODELIST": "HEAD", "SLURM_NNODES": "4", "SLURM_CPUS_PER_TASK": "16"}


@dataclass(frozen=True)
class Block:
    """What stands between two fences."""

    page: Path
    language: str
    body: str


def blocks_of(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    return [Block(page, *found) for found in re.findall(r"^```(\w+)\n(.*?)^```", text, re.S | re.M)]


def lines_of(block: Block) -> list[str]:
    """The commands of a shell's block, without the words that explain them."""
    lines = (shlex.split(line, comments=True) for line in block.body.splitlines())
    typed = (" ".join(x if x == AND else shlex.quote(x) for x in line) for line in lines)
    return [part for line in typed for part in line.split(f" {AND} ") if part]


def parsed(verb: str, *rest: str) -> None:
    """A command through its own parser."""
    tyro.cli(getattr(importlib.import_module(f"vidphys.cli.{verb}"), VERBS[verb][0]), args=rest)


def in_reach(line: str) -> str:
    for theirs, ours, _why in ELSEWHERE:
        line = line.replace(theirs, ours)
    return line


def small(verb: str, rest: list[str]) -> list[str]:
    """The options of a command, those that make it long replaced."""
    changes = SMALLER.get(verb, {})
    kept, dropped = [], False
    for word in rest:
        if word.startswith("--"):
            dropped = word in changes
        if not dropped:
            kept.append(word)
    return [*kept, *(word for name, values in changes.items() for word in (name, *values))]


class Reader:
    """Somebody who types a page into a folder of their own."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch, only_parsing: bool) -> None:
        self.folder, self.patch, self.only_parsing = folder, patch, only_parsing
        self.ran: list[str] = []
        patch.chdir(folder)
        for name in presets.PRESETS:
            patch.setitem(presets.PRESETS, name, replace(TINY, seeds=1))
        patch.setattr(pool, "run_all", serially)
        with_short_lyapunov_times(patch)
        for module in (scoring, oracle):
            patch.setattr(module, "LONG_STEPS", LONG_STEPS)

    def lay(self, name: str) -> None:
        """Put what a page takes for granted into the folder."""
        made, path = THINGS[name], self.folder / name
        if callable(made):
            path.parent.mkdir(parents=True, exist_ok=True)
            made(path)
            return
        for line in made:
            self.verb(line)

    def follow(self, block: Block) -> None:
        ways: dict[str, Callable[[Block], None]] = {
            "python": self._python,
            "sh": self._shell,
            "bash": self._script,
            "toml": self._entry_points,
        }
        ways[block.language](block)

    def verb(self, line: str) -> None:
        """One command of ours, first parsed as it is printed, then run."""
        _, verb, *rest = shlex.split(line)
        parsed(verb, *rest)
        if self.only_parsing:
            return
        _, verb, *rest = shlex.split(in_reach(line))
        if verb == "view" and not {"--web", "--save", "--movie"} & set(rest):
            rest += ["--save", f"seen-{len(self.ran)}.rrd"]  # there is no display
        if verb == "play":
            self._play(rest)
        else:
            assert main([verb, *small(verb, rest)]) == 0, line
        self.ran.append(line)

    def _python(self, block: Block) -> None:
        exec(compile(block.body, str(block.page), "exec"), {})

    def _shell(self, block: Block) -> None:
        for line in lines_of(block):
            program, *rest = shlex.split(line)
            if program == "vidphys":
                self.verb(line)
            elif program == "make":
                self._make(rest)
            elif program == "python":
                self._module(*rest)
            elif program == "export":
                name, _, value = rest[0].partition("=")
                self.patch.setenv(name, value)
            else:
                raise AssertionError(f"{block.page}: nobody has said how to run: {line}")

    def _make(self, rest: list[str]) -> None:
        """Every verb of a target's recipe."""
        quietly = ["make", "--no-print-directory", "-n", "-o", ".venv/.ready"]  # within make, too
        command = [*quietly, *map(in_reach, rest)]
        told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        recipe = told.replace("\\\n", " ").splitlines()
        if rest[0] in SUITES:
            assert "pytest" in told
            return
        assert recipe
        for line in recipe:
            self.verb(line.removeprefix(".venv/bin/"))

    def _module(self, flag: str, module: str, *rest: str) -> None:
        """Training a tiny encoder is the one thing that is no verb."""
        assert (flag, module) == ("-m", "vidphys.pretraining")
        tyro.cli(PretrainConfig, args=rest)
        if not self.only_parsing:
            self.patch.setattr(sys, "argv", [module, *rest, "--preset", "toy"])
            assert pretraining() == 0

    def _script(self, block: Block) -> None:
        """A script in bash, whose programs stand in for a cluster's; its verbs are then run."""
        programs, asked = self.folder / "programs", self.folder / "asked"
        programs.mkdir()
        for name, body in PROGRAMS.items():
            (programs / name).write_text(f"#!/bin/bash\n{body}\n")
            (programs / name).chmod(stat.S_IRWXU)
        where = {"PATH": f"{programs}:{os.environ['PATH']}", "HOME": str(self.folder)}
        where |= {"PYTHONPATH": str(ROOT), **SLURM}
        command = ["bash", "-euo", "pipefail", "-c", block.body]
        subprocess.run(command, env=os.environ | where, check=True)
        for line in asked.read_text().splitlines() if asked.is_file() else ():
            self.verb(f"vidphys {line}")

    def _entry_points(self, block: Block) -> None:
        for group in tomllib.loads(block.body)["project"]["entry-points"]:
            assert group.removeprefix("vidphys.") in REGISTRIES

    def _play(self, rest: list[str]) -> None:
        """Open the page, read it, and end it as a reader does."""
        pages = []

        def look(address: str) -> None:
            with contextlib.closing(urllib.request.urlopen(address, timeout=60)) as page:
                pages.append(page.read())
            raise KeyboardInterrupt

        with self.patch.context() as patch:
            patch.setattr(webbrowser, "open", look)
            assert main(["play", *rest]) == 130
        assert b"<html" in pages[0]


def _table(path: Path) -> None:
    t = np.arange(90) / 30
    places = np.exp(-0.12 * t) * np.stack([np.cos(2.2 * t), 0.6 * np.sin(2.2 * t)])
    places += np.random.default_rng(0).normal(0, 2e-3, places.shape)
    table = np.stack([t, *places], -1)
    np.savetxt(path, table, delimiter=",", header="t,x,y", comments="")


def _clip(path: Path) -> None:
    """Two bodies that swing, one farther than the other."""
    v, u = np.mgrid[:240, :320]
    frames = np.full((60, 240, 320, 3), 110, np.uint8)
    for k, frame in enumerate(frames):
        for where, far, colour in ((90, 60, (230, 30, 40)), (240, 30, (30, 60, 230))):
            frame[np.hypot(u - where - far * np.sin(0.2 * k), v - 120) < 12] = colour
    write_video(path, frames, 25.0)


def _shards(path: Path) -> None:
    for k in range(2):
        write_clip(path / f"clip{k}.avi", 6, phase=k, table=False)


DIAGNOSED = "vidphys diagnose tracks.csv --out {} --quiet"
FITTED = "vidphys fit tracks.csv --specification {}/specification.json --out {} --quiet"
# What lies in a reader's folder before a page is begun: made by a function, or by commands.
THINGS: dict[str, Callable[[Path], None] | list[str]] = {
    "tracks.csv": _table,
    "clip.mp4": _clip,
    "data/shards": _shards,
    "runs/clips": [
        "vidphys render --out clips --clips 6 --world rgb --quiet",
        "vidphys train clips --out runs/clips --quiet",
    ],
    "runs/ladder": ["vidphys ladder --out runs/ladder --quiet"],
    "runs/before": ["vidphys ladder --out runs/before --quiet"],
    "runs/after": ["vidphys ladder --out runs/after --seed 1 --quiet"],
    "runs/tables": ["vidphys reproduce inversion --out runs/tables --quiet"],
    "runs/diagnosis": [DIAGNOSED.format("runs/diagnosis")],
    "runs/fitted": [
        DIAGNOSED.format("runs/diagnosed"),
        FITTED.format("runs/diagnosed", "runs/fitted"),
    ],
}
GIVEN = {
    "README.md": ["tracks.csv", "runs/before", "runs/after"],
    "docs/how-to/diagnose.md": ["tracks.csv", "clip.mp4"],
    "docs/how-to/play.md": [
        *("tracks.csv", "clip.mp4", "runs/ladder", "runs/fitted", "runs/diagnosis", "runs/clips"),
    ],
    "docs/scale.md": ["data/shards", "runs/tables"],
}
