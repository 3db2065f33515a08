"""Every block of README and docs is run, a page by one reader in one folder."""

import pytest

from tests.project.pages import (
    GIVEN,
    PAGES,
    ROOT,
    SLOW,
    TUTORIAL,
    WHOLE,
    Reader,
    blocks_of,
)

BLOCKS = {page: blocks_of(page) for page in PAGES}
TO_RUN = [page for page, blocks in BLOCKS.items() if blocks and page != TUTORIAL]


@pytest.mark.timeout(3600 if WHOLE else 1200)  # whole, on a machine that others use as well
@pytest.mark.parametrize("page", TO_RUN, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_reader_can_follow_the_page(page, tmp_path, monkeypatch, capsys):
    reader = Reader(tmp_path, monkeypatch, only_parsing=page.name in SLOW and not WHOLE)
    for name in GIVEN.get(str(page.relative_to(ROOT)), ()):
        reader.lay(name)
    for block in BLOCKS[page]:
        reader.follow(block)
    assert "False" not in capsys.readouterr().out
