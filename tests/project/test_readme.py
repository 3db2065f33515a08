"""What README and docs name is there; their blocks are run by ``test_pages``."""

import re

import pytest

from tests.project.pages import PAGES, ROOT
from vidphys.cli import main

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


def test_the_front_door_is_short():
    assert len(TEXTS[ROOT / "README.md"].splitlines()) <= 130
