"""A fixture of the tests of plug-ins."""

from __future__ import annotations

import sys

import pytest

from depthcli.core import registry
from depthcli.evaluation import protocols


@pytest.fixture
def forget_plugins(monkeypatch: pytest.MonkeyPatch):
    """Leave no plug-in behind for other tests."""
    for name in ("_file_plugins", "_plugin_by_class"):
        monkeypatch.setattr(registry, name, {})
    monkeypatch.setenv("DEPTHCLI_PLUGIN_FILES", "")
    registry._installed.cache_clear()
    protocols.load.cache_clear()
    yield
    protocols.load.cache_clear()
    registry._installed.cache_clear()
    for name in [name for name in sys.modules if name.startswith(("depthcli_plugin_", "strange_"))]:
        del sys.modules[name]
