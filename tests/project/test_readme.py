"""What README and docs name is there; their blocks are run by ``test_pages``."""

import importlib
import re

import pytest

from tests.project.pages import PAGES, ROOT
from vidphys.cli import VERBS, main
from vidphys.cli.helped import options_of

OTHERS = {"--rows", "--draw"}  # of benchmarks
TEXTS = {page: page.read_text(encoding="utf-8") for page in PAGES}


def test_the_weights_are_listed(capsys):
    assert main(["weights", "list"]) == 0
    assert "hiera" in capsys.readouterr().out.lower()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_names_is_there(page):
    for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", TEXTS[page]):
        assert (page.parent / link).exists(), link
    for path in re.findall(r"`([\w/]+\.py)`", TEXTS[page]):
        assert (ROOT / path).exists() or (ROOT / "vidphys" / path).exists(), path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_verbs_and_options_in_the_text_are_there(page):
    prose = re.sub(r"^```.*?^```", "", TEXTS[page], flags=re.S | re.M)
    flags = {verb: flags_of(verb) for verb in VERBS}
    for said in re.findall(r"`([^`]+)`", prose):
        verb = re.match(r"vidphys (\w+)", said)
        if verb and verb[1] != "help":
            assert verb[1] in VERBS, said
        known = flags[verb[1]] if verb and verb[1] != "help" else set().union(*flags.values())
        for flag in re.findall(r"(?<!\S)--[a-z][a-z-]*", said):
            assert flag in known | OTHERS, f"{page.name}: {said}"


def flags_of(verb):
    config = getattr(importlib.import_module(f"vidphys.cli.{verb}"), VERBS[verb][0])
    return {
        word for option in options_of(config) for word in re.findall(r"--[a-z-]+", option.written)
    }


def test_the_front_door_is_short():
    assert len(TEXTS[ROOT / "README.md"].splitlines()) <= 130
