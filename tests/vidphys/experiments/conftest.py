"""What every test of an experiment runs under."""

from __future__ import annotations

import pytest

from tests.shared.small_studies import with_short_lyapunov_times


@pytest.fixture(autouse=True)
def short_lyapunov_times(monkeypatch: pytest.MonkeyPatch) -> None:
    with_short_lyapunov_times(monkeypatch)
