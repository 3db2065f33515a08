"""The command line: one file a verb, and one place where errors become a line and a code."""

from __future__ import annotations

import difflib
import importlib
import importlib.metadata
import importlib.util
import math
import os
import re
import sys
import warnings
from pathlib import Path
from typing import Any

from vidphys.cli.falls import fallen
from vidphys.errors import is_utf8
from vidphys.runs.ending import Ending

VERBS = {
    "ladder": ("LadderConfig", "run the grounding ladder and write its report"),
    "plan": ("PlanConfig", "say what a ladder or tables will cost, before they are run"),
    "reproduce": ("ReproduceConfig", "regenerate the study's tables, with their verdicts"),
    "diagnose": ("DiagnoseConfig", "find which terms a scene requires, from tracks or a clip"),
    "view": ("ViewConfig", "look at a run's recordings in the rerun viewer"),
    "play": ("PlayConfig", "change a law under your hand on a page, and see it rolled at once"),
    "report": ("ReportConfig", "make a run's report anew, or compare several runs"),
    "render": ("RenderConfig", "render clips of a scene, with the truth beside them"),
    "film": ("FilmConfig", "film scenes as a phone sees them, with the truth beside each clip"),
    "extract": ("ExtractConfig", "run a frozen encoder over clips into a feature store"),
    "atlas": ("AtlasConfig", "map what each layer of encoders knows, beside controls"),
    "train": ("TrainConfig", "train readouts and dynamics on clips, over a frozen encoder"),
    "fit": ("FitConfig", "train exactly the model that a diagnosis asks for, on its tracks"),
    "rollout": ("RolloutConfig", "read a clip with a trained pipeline and roll it on"),
    "export": ("ExportConfig", "write rollouts or features as Parquet, LeRobot or WebDataset"),
    "trade": ("TradeConfig", "measure speed against accuracy here, and choose from it"),
    "stress": ("StressConfig", "run the extremes: each sound, warned of or refused"),
    "weights": ("WeightsConfig", "list, check or fetch weights of frozen encoders"),
    "store": ("StoreConfig", "list, pack or check a feature store, or take an encoder out of it"),
    "parts": ("PartsConfig", "list every part by name, also those of installed packages"),
    "doctor": ("DoctorConfig", "say what this machine has"),
    "completion": ("CompletionConfig", "print what a shell needs to complete verbs and options"),
}
# numpy's matrices here are small; its threads only wait for each other, and where something else
# runs on the machine a diagnosis takes twenty times as long. Torch's are its own.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
SHOWING = ("view", "play")  # they have nothing that could go on
OK, WRONG_INPUT = 0, 2
URL = re.compile(r"[a-z][a-z0-9+.-]+:/")  # as a path has it: one slash, for two are one there
STAGES = ("dynamics", "renderers", "encoders", "binders", "readouts", "viz", "loops", "registry")


def main(arguments: list[str] | None = None, ending: Ending | None = None) -> int:
    """Run one verb; returns the exit code.

    0: done. 1: a run failed. 2: the input was wrong, said in one line. 130: interrupted, with
    the work so far kept. 141: nobody reads the output any more.

    Args:
        arguments: the verb and its options; those of the process if none are given.
        ending: under which signals are heeded already.
    """
    if ending is None:
        with Ending() as heeded:
            return main(arguments, heeded)
    arguments = sys.argv[1:] if arguments is None else arguments
    if len(arguments) > 1 and arguments[0] == "help":
        arguments = [arguments[1], "--help"]
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(_usage())
        return OK if arguments else WRONG_INPUT
    if arguments[0] in ("-V", "--version"):
        print(f"vidphys {importlib.metadata.version('vidphys')}")
        return OK
    verb, rest = arguments[0], arguments[1:]
    if verb not in VERBS:
        near = difflib.get_close_matches(verb, VERBS, n=1)
        guess = f"did you mean {near[0]}? " if near else ""
        return _error(f"vidphys {verb}: no such verb; {guess}use one of {', '.join(VERBS)}")
    stranger = _stranger()
    if stranger:
        return _error(stranger)
    # The viewer's library reports usage by default; nothing here does unless asked.
    os.environ.setdefault("RERUN_ANALYTICS", "0")
    os.environ.setdefault("HF_HUB_DISABLE_TELEMETRY", "1")
    if verb != "weights":  # which fetches where it is told to
        os.environ.setdefault("HF_HUB_OFFLINE", "1")
    if verb in SHOWING:
        ending.said = "ended"
    try:
        ending.working = True
        code = _run(verb, rest)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        return ending.interrupted()
    except Exception as error:  # the one place where whatever is left becomes a line
        return ending.interrupted() if ending.asked else fallen(verb, error)


def _run(verb: str, rest: list[str]) -> int:
    from registry import RegistryError
    from vidphys.errors import InputError

    module = importlib.import_module(f"vidphys.cli.{verb}")
    config_type = getattr(module, VERBS[verb][0])
    if {"-h", "--help"} & set(rest):
        from vidphys.cli.helped import helped

        print(helped(verb, config_type))
        return OK
    from vidphys.cli.parsed import parsed

    warnings.formatwarning = _one_line  # type: ignore[assignment]
    try:
        config = parsed(verb, config_type, rest)
        _require_values(config)
        return getattr(module, verb)(config) or OK
    except (InputError, RegistryError) as error:
        return _error(in_options(str(error), config_type))


def _require_values(config: Any) -> None:
    """Refuse what no verb can use: infinite numbers, names that libraries cannot be told, URLs.

    Raises:
        InputError: of which option.
    """
    from vidphys.errors import InputError

    for option, value in vars(config).items():
        for each in value if isinstance(value, tuple) else (value,):
            if isinstance(each, float) and not math.isfinite(each):
                raise InputError(f"`{option}` {each}: must be a finite number")
            if isinstance(each, str | Path) and not is_utf8(str(each)):
                raise InputError(f"`{option}` {str(each)!a}: the name is not UTF-8; rename it")
            if isinstance(each, Path) and URL.match(str(each)) and not each.exists():
                told = str(each).replace(":/", "://", 1)
                raise InputError(
                    f"`{option}` {told}: a URL; here a file or folder is needed, and a bucket is "
                    "only read and written by vidphys store push and pull --url"
                )


def _one_line(message: Warning | str, category: type[Warning], *_: object) -> str:
    return f"warning: {category.__name__}: {' '.join(str(message).split())}\n"


def in_options(text: str, config: Any) -> str:
    """What the library says of its arguments, `like_this`, in the words of a verb: --like-this."""

    def said(found: re.Match[str]) -> str:
        option = config.__dataclass_fields__.get(found[1])
        if option is None:
            return found[0]
        return found[1] if "Positional" in option.type else f"--{found[1].replace('_', '-')}"

    return re.sub(r"`(\w+)`", said, text)


def _error(text: str) -> int:
    print(f"error: {' '.join(text.split())}", file=sys.stderr)
    return WRONG_INPUT


def _usage() -> str:
    lines = [f"  {verb:<12}{text}" for verb, (_, text) in VERBS.items()]
    return "\n".join(
        [
            "usage: vidphys VERB [options]",
            "",
            *lines,
            "",
            "vidphys help VERB shows its options, and an example.",
        ]
    )


def _stranger() -> str | None:
    """Name a stage package that resolves to somebody else's, if one does."""
    home = Path(__file__).resolve().parents[2]
    for name in STAGES:
        spec = importlib.util.find_spec(name)
        if spec is None or spec.origin is None or Path(spec.origin).resolve().parents[1] != home:
            found = spec.origin if spec else "nothing"
            return (
                f"import {name}: found {found}, not vidphys' own package; remove the other one "
                "from the path"
            )
    from vidphys.cli.owners import changed, others

    taken = changed(STAGES)
    if not taken:
        return None
    who = ", ".join(sorted({o for found in others(STAGES).values() for o in found}))
    return (
        f"{taken[0]} is not the file that was installed with vidphys; "
        + (f"uninstall {who}, which has taken its name, and " if who else "")
        + "install vidphys again"
    )
